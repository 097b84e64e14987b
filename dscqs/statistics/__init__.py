"""Statistics of subjective tests: arrays and votes in, numbers out; no files, no clock.

* :mod:`analysis`: all scores of a test, of a :mod:`matrix` of votes for each display;
  :mod:`descriptive` (mean, spread, interval), :mod:`screening` of assessors, :mod:`normalise`,
  :mod:`missing` votes;
* :mod:`details`, what a report says beside the scores: :mod:`likelihood` (the model of P.910),
  :mod:`coherence` of assessors, :mod:`comparisons` of conditions, :mod:`anova`, :mod:`power`;
* written down: :mod:`document` and :mod:`details_document` as JSON, :mod:`text` and
  :mod:`details_text` for the command line.
"""
