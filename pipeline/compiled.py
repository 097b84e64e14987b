"""How the loops are compiled: what all rooms tell numba."""

from __future__ import annotations

OPTIONS = {
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    # not the flags that assume finite numbers: NaN marks what has no value
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
    # said, or a loop that is first called from one of the next would be compiled as that is
    "_nrt": True,
}
"""They are kept on disk, and release the global lock."""

LEAN = {**OPTIONS, "_nrt": False}
"""The same of a loop that makes no array, and need not count who holds one: where that is counted,
cutting parts of rows out of arrays takes as long as the work on a hundred of their pixels."""

EXACT = {**LEAN, "fastmath": False}
"""The same of a loop whose operations each round by themselves, in the order as written."""

INLINED = {**LEAN, "forceinline": True}
"""The same of what another loop calls and sums in: else that one runs one machine code where it was
just compiled and another one where it is loaded from the cache, which rounds in another order."""

PUT_IN_PLACE = {**LEAN, "inline": "always"}
"""The same of what is put where it is called before types are known: it is not compiled by itself,
and so not once more for each literal, or array that is read-only, that it is called with."""
