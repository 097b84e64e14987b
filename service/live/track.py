"""A video in pieces on the disk: written while it is made, watched then and afterwards.

::

    watch/result/
        track.json            what the pictures hold (:class:`TrackInfo`)
        init-0.mp4            what a player needs first
        segment-000000-15.m4s a second of video, from a key frame on: 15 frames
        segment-000000.jpg    its first picture, small

The numbers count from the start of the job, so that pieces that are made again, or in another
order, fall into their places. Every file appears whole. A player gets them as they are.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

from pipeline.media.colorimetry import BT709, Colorimetry
from pipeline.media.files import write_atomic
from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_encode import LiveEncoder
from pipeline.stereo import Picture, StereoLayout
from service.live.fragments import Fragment, Init, Splitter, moved
from service.live.hls import MediaSegment, playlist

STILL_WIDTH = 960
"""Width of the small pictures at most, pixels."""

_PIECE = re.compile(r"segment-(\d{6})-(\d+)\.m4s")


@dataclass(frozen=True, kw_only=True)
class TrackInfo:
    """What the pictures of a track hold."""

    fps: str
    """Frames a second, as ``N/D``."""
    layout: str
    """``sbs`` or, of one eye alone, ``left`` or ``right``."""
    eye_width: int
    """Of one eye, pixels of the track."""
    eye_height: int
    first_frame: int
    """Source frame number of the first picture."""
    pixel_aspect: str = "1"
    """Width over height of a pixel as shown, as ``N/D``."""
    primaries: int = BT709
    transfer: int = BT709
    """What is said of the pictures' RGB: code points of ITU-T H.273."""

    @property
    def rate(self) -> Fraction:
        """Frames a second."""
        return Fraction(self.fps)

    @property
    def group(self) -> int:
        """Frames of a piece that is not cut short by the end of a segment of the job."""
        return max(1, int(self.rate))


class TrackWriter:
    """Writes consecutive pieces of a track.

    Parameters
    ----------
    folder : Path
        Of the track; made if it is not there.
    info : TrackInfo
    number : int
        Of the first piece to write.
    frame : int
        Number of its first frame, from the start of the job.
    crf : int
        Quality of the video: see :class:`pipeline.media.live_encode.LiveEncoder`.
    on_piece : callable
        Told the number of each piece after it is on the disk.
    """

    def __init__(
        self,
        folder: Path,
        info: TrackInfo,
        *,
        number: int,
        frame: int,
        crf: int,
        on_piece: Callable[[int], None] = lambda number: None,
    ) -> None:
        self._folder = folder
        self._info = info
        self._number = number
        self._frame = frame
        self._on_piece = on_piece
        self._encoder = LiveEncoder(
            fps=info.rate, layout=StereoLayout(info.layout), crf=crf,
            colorimetry=Colorimetry.told(info.primaries, info.transfer),
        )  # fmt: skip
        self._splitter = Splitter()
        self._ticks = 0
        self._piece: list[Fragment] = []
        self._stills: list[bytes] = []
        self._added = 0
        folder.mkdir(parents=True, exist_ok=True)

    def add(self, picture: Picture) -> None:
        """Take the next picture, packed as the track's layout says, with even sides."""
        for unit in self._encoder.encode(picture, self._added):
            if unit.is_key:
                self._stills.append(encode_jpeg(picture, max_width=STILL_WIDTH))
        self._added += 1
        self._sort(self._encoder.take_mp4())

    def finish(self) -> None:
        """Write what is still held back."""
        self.close()
        self._sort(self._encoder.take_mp4())
        self._write()

    def close(self) -> None:
        """Let go of the encoder; may be called twice."""
        self._encoder.close()

    def _sort(self, data: bytes) -> None:
        for part in self._splitter.feed(data):
            if isinstance(part, Init):
                self._begin(part)
                continue
            if part.is_key:
                self._write()
            begin = self._frame * self._ticks
            number = (begin + part.start) // self._ticks
            self._piece.append(moved(part, begin, sequence=number + 1))

    def _begin(self, init: Init) -> None:
        ticks = init.timescale / self._info.rate
        assert ticks.denominator == 1  # the muxer takes a multiple of the rate
        self._ticks = int(ticks)
        for name, content in (
            ("init-0.mp4", init.data),
            ("track.json", json.dumps(asdict(self._info)).encode()),
        ):
            path = self._folder / name
            if not path.is_file() or path.read_bytes() != content:
                write_atomic(path, content)

    def _write(self) -> None:
        if not self._piece:
            return
        name = piece_name(self._number, len(self._piece))
        write_atomic(self._folder / f"segment-{self._number:06d}.jpg", self._stills.pop(0))
        write_atomic(self._folder / name, b"".join(part.data for part in self._piece))
        self._piece = []
        self._on_piece(self._number)
        self._number += 1


def piece_name(number: int, num_frames: int) -> str:
    """Return the file name of a piece."""
    return f"segment-{number:06d}-{num_frames}.m4s"


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A piece that is there."""

    number: int
    num_frames: int
    path: Path


class Track:
    """A track as its viewers see it: the pieces from the first on, up to the first gap."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def info(self) -> TrackInfo | None:
        """What it holds; None where nothing has been written yet."""
        try:
            said = json.loads((self._folder / "track.json").read_text(encoding="utf-8"))
            return TrackInfo(**said)
        except (FileNotFoundError, NotADirectoryError):
            return None

    def pieces(self) -> list[Piece]:
        """Return what can be watched."""
        found: dict[int, Piece] = {}
        for path in self._folder.iterdir() if self._folder.is_dir() else ():
            match = _PIECE.fullmatch(path.name)
            if match:
                number, num_frames = int(match[1]), int(match[2])
                found[number] = Piece(number=number, num_frames=num_frames, path=path)
        return [found[number] for number in range(_first_gap(found))]

    def playlist(self, *, ended: bool) -> str:
        """Return the HLS playlist as of now."""
        info = self.info
        assert info is not None
        segments = [
            MediaSegment(number=piece.number, duration=float(piece.num_frames / info.rate))
            for piece in self.pieces()
        ]
        return playlist(segments, ended=ended, growing=True, longest=float(info.group / info.rate))

    def piece(self, number: int) -> Path | None:
        """Return the file of a piece; None where it is not there."""
        return next(self._folder.glob(f"segment-{number:06d}-*.m4s"), None)

    def init(self) -> Path | None:
        """Return the init segment; None where it is not there."""
        path = self._folder / "init-0.mp4"
        return path if path.is_file() else None

    def still(self, number: int) -> Path | None:
        """Return the small picture of a piece; None where it is not there."""
        path = self._folder / f"segment-{number:06d}.jpg"
        return path if path.is_file() else None


def _first_gap(numbers: dict[int, Piece]) -> int:
    gap = 0
    while gap in numbers:
        gap += 1
    return gap
