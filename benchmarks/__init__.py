"""What the project measures about itself: each is run as ``python -m benchmarks.NAME``.

* ``python -m benchmarks``: how fast, and how much memory (:mod:`speed`, :mod:`memory`), told in
  the machine's own :mod:`unit`;
* :mod:`quality`: how good, on real and rendered scenes;
* :mod:`video`: a stream against so many stills; :mod:`latency`: of a live frame;
* :mod:`changes`: frames of a chain against cold ones, where pictures change;
* :mod:`service`, :mod:`dscqs`: under load; :mod:`cluster`: on one worker and on two;
* :mod:`soak`: a long run, whose memory and quality must not drift;
* :mod:`learn` makes the learned filters anew.

Speed and quality are judged by the floors of :mod:`floors`. Nothing here is installed.
"""

from pipeline.numba_cache import prepare_numba_cache

prepare_numba_cache()  # before any of them imports numba
