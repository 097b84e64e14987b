"""What a stream's messages are numbered by, from one of its workers to the next."""

from __future__ import annotations

import logging
import mmap
import struct
from pathlib import Path

from service.bus.keys import Output

log = logging.getLogger(__name__)

_PLACES = {which: place for place, which in enumerate(Output, start=1)}
_SIZE = 8 * (1 + len(_PLACES))


class Sequences:
    """Numbers of the messages of each output, from 0, each given once.

    They lie in a file that is mapped into memory, so that those given are known however
    the worker and the service end.

    Parameters
    ----------
    path : Path, optional
        Made if it is not there. Where it cannot be, or without one, numbers begin at 0.
    run : int
        Which worker takes the numbers; kept along with them.
    """

    def __init__(self, path: Path | None = None, *, run: int = 1) -> None:
        self._numbers = _mapped(path)
        self._numbers[0] = run

    def take(self, which: Output) -> int:
        """Return the next number of an output."""
        number = self._numbers[_PLACES[which]]
        self._numbers[_PLACES[which]] = number + 1
        return number

    def last(self, which: Output) -> int:
        """Return the number that was taken last; 0 where there is none."""
        return max(0, self._numbers[_PLACES[which]] - 1)


def last_run(path: Path) -> int:
    """Return which worker took numbers last; 0 where there was none."""
    try:
        return int(struct.unpack_from("Q", path.read_bytes())[0])
    except (OSError, struct.error):
        return 0


def _mapped(path: Path | None) -> memoryview:
    if path is None:
        return memoryview(bytearray(_SIZE)).cast("Q")
    try:
        with path.open("a+b") as file:
            file.write(bytes(max(0, _SIZE - file.tell())))  # a hole would need room later
            file.flush()
            return memoryview(mmap.mmap(file.fileno(), _SIZE)).cast("Q")
    except OSError as error:
        log.warning("the numbers of messages cannot be kept: %s", error)
        return _mapped(None)
