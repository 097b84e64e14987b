"""A live video into a file as it comes: access units put into Matroska or MP4, nothing re-coded."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av

from pipeline.errors import OutputError
from pipeline.media.files import atomic_path

CONTAINERS = {".mkv": "matroska", ".mp4": "mp4"}


class LiveFile:
    """Writes the access units of one H.264 stream; see :func:`live_file`."""

    def __init__(self, path: Path, final: Path, fps: Fraction) -> None:
        self._final, self._fps = final, fps
        self._container: Any = av.open(str(path), "w", format=CONTAINERS[final.suffix.lower()])
        self._stream: Any = None
        self._first = 0
        self._held: tuple[int, bytes, bool] | None = None
        self.frames = 0
        """Access units written."""

    def add(self, unit: bytes, position: int, *, is_key: bool) -> None:
        """Take an access unit (Annex B), shown at position / fps; the first must be a key frame.

        Raises
        ------
        OutputError
            If the first is no key frame, or the position does not grow.
        """
        if self._stream is None:
            if not is_key:
                raise OutputError(f"{self._final}: must begin with a key frame")
            self._begin(unit)
            self._first = position
        if self._held is not None:
            if position <= self._held[0]:
                raise OutputError(f"{self._final}: frame {position} comes after {self._held[0]}")
            self._write(until=position)
        self._held = (position, unit, is_key)

    def close(self) -> None:
        """Write the last one and the end of the file."""
        if self._held is not None:
            self._write(until=self._held[0] + 1)
            self._held = None
        container, self._container = self._container, None
        if container is not None:
            container.close()

    def _begin(self, unit: bytes) -> None:
        with av.open(io.BytesIO(unit), format="h264") as probe:
            template = probe.streams.video[0]
            self._stream = self._container.add_stream_from_template(template)
        self._stream.time_base = 1 / self._fps
        if self._final.suffix.lower() == ".mkv":
            self._stream.metadata["stereo_mode"] = "left_right"

    def _write(self, until: int) -> None:
        assert self._held is not None
        position, unit, is_key = self._held
        packet: Any = av.Packet(unit)
        packet.stream = self._stream
        packet.time_base = 1 / self._fps
        packet.pts = packet.dts = position - self._first
        packet.duration = until - position
        packet.is_keyframe = is_key
        self._container.mux(packet)
        self.frames += 1


@contextlib.contextmanager
def live_file(path: Path, fps: Fraction) -> Iterator[LiveFile]:
    """Give what writes a live video; the file is there when all went well.

    Parameters
    ----------
    path : Path
        Ends with .mkv or .mp4; an existing file is replaced.
    fps : Fraction
        Frames a second, > 0.

    Raises
    ------
    OutputError
        If the name ends otherwise, nothing was written, or it cannot be written.
    """
    if path.suffix.lower() not in CONTAINERS:
        raise OutputError(f"{path}: must end with {' or '.join(CONTAINERS)}")
    with atomic_path(path) as unfinished:
        try:
            file = LiveFile(unfinished, path, fps)
            try:
                yield file
            finally:
                file.close()
        except av.error.FFmpegError as error:
            raise OutputError(f"{path}: {error.strerror or error}") from error
        if not file.frames:
            raise OutputError(f"{path}: nothing came, so nothing is written")
