"""From many small views to a large stereo pair.

Rooms with maps of their own: :mod:`pipeline.registration`, :mod:`pipeline.reconstruction`,
:mod:`pipeline.temporal`, :mod:`pipeline.superresolve`, :mod:`pipeline.media`,
:mod:`pipeline.synthetic`, :mod:`pipeline.evaluation`. Equations and words: ``pipeline/README.md``.

* a job: :mod:`job` is what was asked for, :mod:`plan` what that means for a scene, :mod:`run` the
  order of the work; :mod:`segments` computes it, or :mod:`cluster` on many machines, along the
  :mod:`line` of stages with one :mod:`worker`; :mod:`sink` (or :mod:`tee_sink`) takes the results,
  the :mod:`workfolder` keeps them, under a :mod:`fingerprint`, until the job is done;
* what is told of it: :mod:`events`, :mod:`report`, :mod:`debug_pictures`;
* holding a rate: :mod:`realtime`, by the :mod:`effort` of each frame, after a :mod:`rehearsal`;
* values that cross borders: :mod:`frames`, :mod:`results`, :mod:`config`, :mod:`errors`;
  coordinates: :mod:`grid`;
* arrays in, arrays out: :mod:`noise`, :mod:`colour`, :mod:`stereo`, :mod:`metrics`,
  :mod:`baselines`, :mod:`degradation`;
* :mod:`psf_search`, which measures :mod:`edge_widths`, and its :mod:`psf_curve`;
  :mod:`learned_filters`: those that are shipped;
* :mod:`freeview`, :mod:`view_at`: a view that no camera took; :mod:`export`: other forms of a
  finished video;
* :mod:`evaluate` (Set 1) and :mod:`demo`, drawn by :mod:`drawing`;
* threads and processes: :mod:`threads`, :mod:`channel`, :mod:`fan_out`, :mod:`background`,
  :mod:`stop`, :mod:`machine`;
* compiled loops: :mod:`compiled` has what numba is told, :mod:`vectors` what those are
  written with that work on several pixels at once, :mod:`numba_cache` where they are kept;
  :mod:`compile_ahead`, :mod:`compile_beside`, :mod:`compile_notice`.
"""
