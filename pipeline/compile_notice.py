"""Tells the user when a kernel is being compiled, and only then.

numba announces each compilation that its cache could not spare; the first of
them is passed on, in the thread that compiles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def compile_notice(tell: Callable[[], None]) -> Iterator[None]:
    """Call ``tell`` once, when the first compilation of the body begins."""
    from numba.core import event

    class Once(event.Listener):
        told = False

        def on_start(self, event: object) -> None:
            if not Once.told:
                Once.told = True
                tell()

        def on_end(self, event: object) -> None:
            """Nothing to tell."""

    with event.install_listener("numba:compile", Once()):
        yield
