"""Sound beside the pictures of a video: found, and copied to another one as it is."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import av

from pipeline.errors import OutputError
from pipeline.media.info import Sound


def sound_codec(path: Path) -> str | None:
    """Return how the first sound of a video file, which was opened before, is coded, if any."""
    with av.open(str(path), metadata_errors="replace") as container:
        if not container.streams.audio:
            return None
        context = container.streams.audio[0].codec_context
        return None if context is None else context.codec.canonical_name


def holds_sound(muxer: str, options: dict[str, str], path: Path) -> bool:
    """Tell whether a kind of file takes a file's sound as it is.

    Parameters
    ----------
    muxer : str
        FFmpeg's name of the kind of file.
    options : dict
        Of the muxer.
    path : Path
        A video file with sound.
    """
    with av.open(str(path), metadata_errors="replace") as source:
        # what only some versions of a muxer take is known when the head is written
        try:
            with av.open(io.BytesIO(), "w", format=muxer, options=options) as trial:
                trial.add_stream_from_template(source.streams.audio[0])
                trial.start_encoding()
        except (ValueError, av.error.FFmpegError):
            return False
    return True


class SoundCopy:
    """Copies a stretch of sound into a container, packet by packet; a context manager.

    Parameters
    ----------
    sound : Sound
        Its beginning becomes time 0. Packets that begin before it are left out, so that nothing
        is earlier than the first picture.
    output : av.container.OutputContainer
        Of a kind that takes it; its head is not written yet.

    Raises
    ------
    OutputError
        If the sound cannot be read; of all methods.
    """

    def __init__(self, sound: Sound, output: Any) -> None:
        self._sound = sound
        self._output = output
        with self._errors():
            self._source = av.open(str(sound.path), metadata_errors="replace")
        picture = self._source.streams.video[0]
        started = Fraction((picture.start_time or 0) * (picture.time_base or 1))
        self._zero = started + sound.begin
        self._stream = output.add_stream_from_template(self._source.streams.audio[0])
        self._packets = self._read()
        self._next: Any = None

    def up_to(self, seconds: Fraction) -> None:
        """Copy what begins before a time, seconds from the first picture written."""
        while self._next is not None and self._time(self._next) < seconds:
            packet = self._next
            shift = round(self._zero / packet.time_base)
            packet.pts -= shift
            packet.dts = packet.pts
            packet.stream = self._stream
            self._output.mux(packet)
            self._next = next(self._packets, None)

    def to_end(self) -> None:
        """Copy what is left."""
        self.up_to(self._sound.end - self._sound.begin)

    def _read(self) -> Iterator[Any]:
        with self._errors():
            if self._sound.begin > 0:
                self._source.seek(int(self._zero * av.time_base))
            for packet in self._source.demux(self._source.streams.audio[0]):
                if packet.size and packet.pts is not None and self._time(packet) >= 0:
                    yield packet

    def _time(self, packet: Any) -> Fraction:
        return packet.pts * packet.time_base - self._zero

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except (av.error.FFmpegError, OSError) as error:
            raise OutputError(
                f"{self._sound.path}: its sound cannot be read: {error}; --sound none leaves it out"
            ) from error

    def __enter__(self) -> SoundCopy:
        try:
            self._next = next(self._packets, None)
        except BaseException:
            self._source.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._source.close()
