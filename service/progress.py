"""What a person at a terminal sees of a running job.

On a terminal a bar that rewrites its line, with rate and time left; elsewhere a
plain line now and then. All of it goes to stderr: stdout is for results.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable
from typing import TextIO

from pipeline.events import (
    Compiling,
    Event,
    FrameFinished,
    JobFinished,
    JobStarted,
    Joining,
    Warned,
)

PLAIN_INTERVAL = 10.0
"""Seconds between two plain lines."""

REDRAW_INTERVAL = 0.1
"""Seconds between two drawings of the bar."""

BAR_WIDTH = 30
"""Characters."""


class Progress:
    """Shows the events of a job.

    Parameters
    ----------
    stream : text stream
        Usually stderr.
    quiet : bool
        Show nothing but warnings.
    clock : callable
        Seconds, monotonic.
    """

    def __init__(
        self,
        stream: TextIO | None = None,
        *,
        quiet: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._clock = clock
        self._terminal = self._stream.isatty()
        self._begin = clock()
        self._first = 0
        self._shown = float("-inf")
        self._line = ""
        self._lock = threading.Lock()

    def __call__(self, event: Event) -> None:
        """Show one event; any thread may call."""
        with self._lock:
            self._show(event)

    def _show(self, event: Event) -> None:
        match event:
            case Warned(text=text):
                self._say(f"depthsr: warning: {text}")
            case _ if self._quiet:
                return
            case JobStarted():
                self._begin, self._first = self._clock(), event.frames_done
                self._shown = self._begin
                self._say(_beginning(event))
            case Compiling():
                self._say(
                    "depthsr: compiling (only now: what is compiled is kept for the next run)"
                )
            case FrameFinished():
                self._frame(event)
            case Joining(segments=count) if count > 1:
                self._draw(f"joining {count} segments")
            case JobFinished():
                self._erase()
            case _:
                pass

    def note(self, text: str) -> None:
        """Show a passing remark; on a terminal the next one takes its place."""
        if not self._quiet:
            with self._lock:
                self._draw(text) if self._terminal else self._say(f"depthsr: {text}")

    def close(self) -> None:
        """Leave the terminal clean."""
        self._erase()

    def _frame(self, event: FrameFinished) -> None:
        now = self._clock()
        last = event.done == event.total
        interval = REDRAW_INTERVAL if self._terminal else PLAIN_INTERVAL
        if now - self._shown < interval and not last:
            return
        self._shown = now
        text = progress_text(event.done, event.total, event.done - self._first, now - self._begin)
        if self._terminal:
            filled = round(BAR_WIDTH * event.done / event.total)
            self._draw(f"[{'#' * filled}{'.' * (BAR_WIDTH - filled)}] {text}")
        else:
            self._say(f"depthsr: {text}")

    def _draw(self, line: str) -> None:
        if not self._terminal:
            return
        line = line[: shutil.get_terminal_size().columns - 1]
        self._stream.write("\r" + line + " " * max(0, len(self._line) - len(line)))
        self._stream.flush()
        self._line = line

    def _erase(self) -> None:
        if self._line:
            self._stream.write("\r" + " " * len(self._line) + "\r")
            self._stream.flush()
            self._line = ""

    def _say(self, text: str) -> None:
        line = self._line
        self._erase()
        self._stream.write(text + "\n")
        self._stream.flush()
        if line:
            self._draw(line)


def progress_text(done: int, total: int, counted: int, seconds: float) -> str:
    """Return how far it is, how fast it goes and how long it will take.

    >>> progress_text(6, 24, 4, 8.0)
    'frame 6 of 24, 2.00 s a frame, 0:36 left'
    """
    text = f"frame {done} of {total}"
    if counted <= 0 or seconds <= 0:
        return text
    each = seconds / counted
    rate = f"{each:.2f} s a frame" if each >= 0.1 else f"{1 / each:.1f} frames a second"
    left = f", {duration(each * (total - done))} left" if done < total else ""
    return f"{text}, {rate}{left}"


def duration(seconds: float) -> str:
    """Return a time span to read: minutes and seconds, with hours where there are any.

    >>> duration(36), duration(3725)
    ('0:36', '1:02:05')
    """
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    minutes, rest = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def _beginning(event: JobStarted) -> str:
    lr_height, lr_width = event.lr_shape
    hr_height, hr_width = event.hr_shape
    frames = "1 frame" if event.frames_total == 1 else f"{event.frames_total} frames"
    views = "1 view" if event.num_views == 1 else f"{event.num_views} views"
    text = (
        f"depthsr: {views} of {lr_width}×{lr_height} → {' and '.join(event.targets)} "
        f"of {hr_width}×{hr_height}, {frames}"
    )
    if event.frames_done:
        text += f", {event.frames_done} of them done before"
    return text
