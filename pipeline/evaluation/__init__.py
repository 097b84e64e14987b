"""Measuring the pipeline where the truth is known, and telling people what was found.

* :mod:`tables`, :mod:`plots`: what reports are made of;
* :mod:`methods`: one method on one view, with its time and memory;
* :mod:`cells`, :mod:`rendered`, :mod:`floors`: the bars, and whether they are reached;
* the studies, each one question of an engineer: :mod:`fidelity` (Table 2), :mod:`registrations`
  (Table 1, Figure 12), :mod:`spectra` (Figure 13), :mod:`sensitivity` (Figures 17, 18),
  :mod:`left_out` (Set 2, free view), :mod:`ablations`, :mod:`peers`;
* :mod:`report`: all of them as one page.

The studies know the pipeline; the pipeline does not know them.
"""
