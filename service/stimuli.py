"""Stimuli of subjective tests: lossless results in, PNG stills and lossless WebM clips out.

What was written is decoded again and compared with what went in; the hash of its pixels is
kept, so that the page of a test can prove what it showed. ``stimuli.json`` beside the files
says what they are; ``depthsr dscqs plan`` reads it.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from dscqs.errors import StimulusError
from dscqs.pixel_hash import PixelHash, hash_frames
from dscqs.stimulus import digest, inspect
from pipeline.baselines import bicubic
from pipeline.colour import to_rgb
from pipeline.config import Settings
from pipeline.frames import MultiViewFrame
from pipeline.grid import Grid
from pipeline.media.files import write_atomic
from pipeline.media.images import read_image
from pipeline.media.lossless import RgbImage, open_lossless, to_8_bits, write_lossless_webm
from pipeline.media.png import encode_png
from pipeline.media.source import open_scene

MANIFEST = "stimuli.json"
FORMAT = "depthsr-stimuli"

_NAME = re.compile(r"[\w.+ -]+", re.ASCII)
_EYES = re.compile(r"left-(\d+)\.png")


@dataclass(frozen=True, kw_only=True)
class Clip:
    """What becomes a stimulus: both eyes side by side, frame by frame."""

    frames: Iterable[RgbImage]
    fps: Fraction | None = None
    """None: it does not say."""


@dataclass(frozen=True, kw_only=True)
class Made:
    """A stimulus that was written and read back."""

    key: str
    file: str
    sha256: str
    pixels: str
    """:func:`dscqs.pixel_hash.hash_frames` of what was decoded."""
    width: int
    height: int
    frames: int
    source: str

    @property
    def content(self) -> str:
        """The content, of ``content/condition``."""
        return self.key.split("/")[0]


def make_stimuli(
    sources: Mapping[str, str],
    out: Path,
    *,
    kind: str = "still",
    frame: int = 0,
    fps: Fraction | None = None,
    grid: Grid | None = None,
    fetch: Callable[[str, Path], Path] | None = None,
    say: Callable[[str], object] = lambda _: None,
) -> list[Made]:
    """Write a stimulus for each source, and the manifest of all.

    Parameters
    ----------
    sources : mapping
        What each ``content/condition`` is made of: a folder of ``left-*.png`` and
        ``right-*.png`` (``--frames-dir``), lossless video, a side-by-side PNG, ``job:ID``, or
        ``bicubic:SCENE``: both eyes of a scene as they were observed, enlarged.
    out : Path
        Folder; made if it is not there. What its manifest has of other stimuli stays.
    kind : str
        ``still`` or ``video``.
    frame : int
        Which frame a still is, counted from 0 within its source.
    fps : Fraction or None
        Frame rate of clips made of pictures.
    grid : Grid or None
        What ``bicubic:SCENE`` is enlarged onto; None: as results are unless told otherwise.
    fetch : callable
        Downloads the lossless result of a job into a folder, and returns where it lies.
    say : callable
        Told a line about each.

    Raises
    ------
    StimulusError
        If a source is no lossless stereo picture, or what was written does not read back.
    """
    for key in sources:
        content, slash, condition = key.partition("/")
        if not slash or not all(_NAME.fullmatch(part) for part in (content, condition)):
            raise StimulusError(f"{key}: must be CONTENT/CONDITION of letters, digits, . _ + -")
    out.mkdir(parents=True, exist_ok=True)
    made = []
    for key, source in sources.items():
        with _opened(source, fetch, grid or Settings().grid) as clip:
            made.append(_make(key, source, clip, out, kind, frame, fps or clip.fps))
        last = made[-1]
        frames = f"{last.frames} frame{'s' * (last.frames != 1)}"
        say(f"{last.file}: {last.width}×{last.height}, {frames}")
    _check_alike(made)
    _write_manifest(out, kind, made)
    return made


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return what ``stimuli.json`` of a folder says.

    Raises
    ------
    StimulusError
        If there is none, or it is another file.
    """
    path = folder / MANIFEST
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StimulusError(f"{path}: cannot be read: {error}") from None
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        raise StimulusError(f"{path}: is no manifest of stimuli (depthsr dscqs stimuli makes one)")
    return said


def _make(
    key: str, source: str, clip: Clip, out: Path, kind: str, frame: int, fps: Fraction | None
) -> Made:
    name = key.replace("/", "--").replace(" ", "_")
    if kind == "still":
        path = out / f"{name}.png"
        picture = next(islice(iter(clip.frames), frame, None), None)
        if picture is None:
            raise StimulusError(f"{key}: {source} has no frame {frame}")
        write_atomic(path, encode_png(picture))
        wanted, count = hash_frames([picture]), 1
        found = hash_frames([to_8_bits(read_image(path).samples)])
    else:
        if fps is None:
            raise StimulusError(f"{key}: {source} does not say its frame rate; give --fps")
        path = out / f"{name}.webm"
        hashes = PixelHash()
        count = write_lossless_webm(path, map(hashes.add, clip.frames), fps)
        wanted, found = hashes.hexdigest(), hash_frames(open_lossless(path).frames())
    if found != wanted:
        raise StimulusError(f"{path}: does not decode to what was written")
    data = path.read_bytes()
    info = inspect(data, str(path))
    return Made(
        key=key, file=path.name, sha256=digest(data), pixels=found, width=info.width,
        height=info.height, frames=count, source=source,
    )  # fmt: skip


@contextmanager
def _opened(source: str, fetch: Callable[[str, Path], Path] | None, grid: Grid) -> Iterator[Clip]:
    if source.startswith("bicubic:"):
        with open_scene(source.removeprefix("bicubic:")) as scene:
            yield Clip(frames=(_enlarged(frame, grid) for frame in scene.frames()),
                       fps=scene.info.fps)  # fmt: skip
    elif source.startswith("job:"):
        if fetch is None:
            raise StimulusError(f"{source}: no service was named")
        with tempfile.TemporaryDirectory() as folder:
            yield _open(fetch(source.removeprefix("job:"), Path(folder)))
    else:
        yield _open(Path(source))


def _open(path: Path) -> Clip:
    if path.is_dir():
        return Clip(frames=_pictures(path))
    if path.suffix.lower() == ".png":
        return Clip(frames=[to_8_bits(read_image(path).samples)])
    if not path.is_file():
        raise StimulusError(f"{path}: is neither a folder nor a file")
    clip = open_lossless(path)
    return Clip(frames=_side_by_side(path, clip.stereo_mode, clip.frames()), fps=clip.fps)


def _enlarged(frame: MultiViewFrame, grid: Grid) -> RgbImage:
    eyes = [frame.view(view_id) for view_id in (frame.left, frame.right)]
    pictures = [
        to_rgb(
            bicubic(eye.luma, grid), None if eye.chroma is None else bicubic(eye.chroma, grid), 8
        )
        for eye in eyes
    ]
    return np.concatenate(pictures, axis=1)


def _pictures(folder: Path) -> Iterator[RgbImage]:
    numbers = sorted(match[1] for path in folder.iterdir() if (match := _EYES.fullmatch(path.name)))
    if not numbers:
        raise StimulusError(f"{folder}: has no left-*.png and right-*.png (--frames-dir)")
    for number in numbers:
        eyes = []
        for eye in ("left", "right"):
            path = folder / f"{eye}-{number}.png"
            if not path.is_file():
                raise StimulusError(f"{path}: is missing")
            eyes.append(to_8_bits(read_image(path).samples))
        if eyes[0].shape != eyes[1].shape:
            raise StimulusError(f"{folder}: the eyes of frame {number} differ in size")
        yield np.concatenate(eyes, axis=1)


def _side_by_side(path: Path, mode: str, frames: Iterator[RgbImage]) -> Iterator[RgbImage]:
    axes = {
        "left_right": (1, 1),
        "right_left": (1, -1),
        "top_bottom": (0, 1),
        "bottom_top": (0, -1),
    }
    if mode not in axes:
        raise StimulusError(f"{path}: does not say how two eyes share its picture (StereoMode)")
    axis, step = axes[mode]
    for frame in frames:
        if frame.shape[axis] % 2:
            raise StimulusError(f"{path}: {frame.shape[axis]} pixels cannot be shared by two eyes")
        yield np.concatenate(np.split(frame, 2, axis=axis)[::step], axis=1)


def _check_alike(made: Iterable[Made]) -> None:
    first: dict[str, Made] = {}
    for one in made:
        other = first.setdefault(one.content, one)
        shapes = [(item.width, item.height, item.frames) for item in (one, other)]
        if shapes[0] != shapes[1]:
            said = [f"{width}×{height} with {count} frames" for width, height, count in shapes]
            raise StimulusError(f"{one.key}: is {said[0]}, but {other.key} is {said[1]}")


def _write_manifest(out: Path, kind: str, made: Iterable[Made]) -> None:
    stimuli: dict[str, Any] = {}
    if (out / MANIFEST).exists():
        before = read_manifest(out)
        if before["kind"] != kind:
            raise StimulusError(f"{out}: holds stimuli of the kind {before['kind']} already")
        stimuli = before["stimuli"]
    for one in made:
        stimuli[one.key] = {
            "file": one.file, "sha256": one.sha256, "pixels": one.pixels, "width": one.width,
            "height": one.height, "frames": one.frames, "source": one.source,
        }  # fmt: skip
    said = {"format": FORMAT, "kind": kind, "layout": "sbs", "stimuli": stimuli}
    write_atomic(out / MANIFEST, (json.dumps(said, indent=1) + "\n").encode())
