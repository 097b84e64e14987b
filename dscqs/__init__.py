"""Subjective tests after ITU-R BT.500: how good people find pictures (DSCQS).

Nothing here knows of super-resolution, HTTP or the command line: a stimulus is an id and files.

* a test: :mod:`plan`, from :mod:`templates`, on :mod:`displays`; :mod:`order` of presentations,
  and the :mod:`proof` of it;
* its stimuli: :mod:`stimulus`, :mod:`shelf`, :mod:`pixel_hash`;
* a session: :mod:`session` as a state machine, :mod:`live_session` in memory, :mod:`group` before
  one screen, :mod:`desk` in front of all, :mod:`views` of them; kept by :mod:`store` or
  :mod:`sqlite_store`;
* what comes of it: :mod:`votes`, :mod:`record`; :mod:`dscqs.statistics`, :mod:`dscqs.report`,
  :mod:`dscqs.exchange` with other programs;
* :mod:`simulated` assessors; ``page`` has the pages that assessors and operators see;
* :mod:`errors`: what can go wrong.
"""
