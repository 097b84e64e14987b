"""Measuring the pipeline where the truth is known, and telling people what was found.

* what is measured: :mod:`subjects`, one :mod:`methods` entry on one view with its time and memory,
  how much of a scene by :mod:`plan`;
* the bars, and whether they are reached: :mod:`bars`, of :mod:`cells` and :mod:`rendered` scenes,
  held against :mod:`floors`; :mod:`beyond`: other K, PSF and noise than those of Set 1;
* the studies, each one question of an engineer: :mod:`fidelity` (Table 2), :mod:`registrations`
  (Table 1, Figure 12), :mod:`spectra` (Figure 13), :mod:`sensitivity` (Figures 17, 18),
  :mod:`left_out` (Set 2, free view), :mod:`ablations`, :mod:`peers`, and :mod:`home_ground`, where
  those networks are at home;
* peers: :mod:`rivals` enlarge one picture (:mod:`networks`), :mod:`fusing` ones take all views
  (:mod:`vidsr`, :mod:`btv_l1`); :mod:`programs` runs them, :mod:`kept` keeps what they made;
* :mod:`report`: all studies as one page, of :mod:`elements`: :mod:`tables`, :mod:`plots`.

The studies know the pipeline; the pipeline does not know them.
"""
