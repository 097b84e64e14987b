"""What the project measures about itself.

* ``python -m benchmarks``: how fast, and how much memory (:mod:`speed`, :mod:`memory`);
* ``python -m benchmarks.quality``: how good (:mod:`set1`, :mod:`rendered`).

Both judge what they found by the floors of :mod:`floors`. Nothing here is installed.
"""

from pipeline.numba_cache import prepare_numba_cache

prepare_numba_cache()  # before any of them imports numba
