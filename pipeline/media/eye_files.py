"""Stereo that comes as two: a video, an image or a numbered row of images for each eye.

What belongs together is known by the names, which differ in one word: ``left`` and ``right``,
``l`` and ``r``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import SceneError
from pipeline.media.images import IMAGE_SUFFIXES
from pipeline.media.scene import (
    ImageFiles,
    Locator,
    SceneDescription,
    VideoFile,
    ViewDescription,
)

VIDEO_SUFFIXES = frozenset(
    {
        ".avi", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4", ".mpg", ".mts", ".mxf", ".ts", ".webm",
        ".y4m",
    }
)  # fmt: skip
"""Endings of the videos that are looked at in a folder, lower case."""

LAYOUT = "eye-files"
"""What such a scene is called."""

_OTHER = {"left": "right", "l": "r", "right": "left", "r": "l"}
_NUMBERED = re.compile(r"(.*?)(\d+)(\D*\.\w+)", re.DOTALL)
"""What stands before the last number of a name, the number, and the rest."""
_WORD = r"[^\W\d_]+"
_EYE = re.compile(r"(?<![^\W\d_])(?:left|right|l|r)(?![^\W\d_])", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class _Row:
    """Images that differ in their number alone; or one image."""

    pattern: str
    first: int


def eyes_in(folder: Path) -> SceneDescription | None:
    """Return the description of a folder that holds a pair of eyes; None where it does not.

    A pair is two videos, two images, two rows of numbered images, or two folders of which each
    holds one row.

    Raises
    ------
    SceneError
        If there are several pairs.
    """
    entries = _seen(folder)
    videos = [path.name for path in entries if _is_video(path)]
    pairs = [_of_videos(folder, pair) for pair in _pairs(videos)]
    rows = _rows(path.name for path in entries if _is_image(path))
    for path in entries:
        if path.is_dir() and _other_name(path.name) is not None:
            within = list(_rows(file.name for file in _seen(path) if _is_image(file)).values())
            if len(within) == 1:
                pattern = f"{_escaped(path.name)}/{within[0].pattern}"
                rows[path.name] = _Row(pattern=pattern, first=within[0].first)
    pairs += [_of_rows(folder, pair, rows) for pair in _pairs(rows)]
    if len(pairs) > 1:
        told = [pair.notes[0] for pair in pairs[:2]] + ["…"] * (len(pairs) > 2)
        raise SceneError(
            f"holds {len(pairs)} pairs of eyes ({'; '.join(told)}); name a video of one of them, "
            "or write a scene.json",
            path=folder,
        )
    return pairs[0] if pairs else None


def eyes_beside(path: Path) -> SceneDescription | None:
    """Return the description of one eye's video and the other's beside it, if that is there."""
    other = _other_name(path.name)
    if other is None or not path.with_name(other).is_file():
        return None
    (pair,) = _pairs([path.name, other])
    return _of_videos(path.absolute().parent.resolve(), pair)


def name_of_pair(video: Path, otherwise: str) -> str | None:
    """Return what one eye's video and the other's beside it are called together.

    Parameters
    ----------
    video : Path
        Of either eye.
    otherwise : str
        Their name where that of the eye is all that they are called.

    Returns
    -------
    str or None
        The name without its word for an eye; None: there is no other eye's.
    """
    return None if eyes_beside(video) is None else _without_eye(video.stem) or otherwise


def _without_eye(name: str) -> str:
    """Return a name without its one word for an eye.

    >>> _without_eye("clip_R"), _without_eye("L - shot 3"), _without_eye("a-left_v2")
    ('clip', 'shot 3', 'a_v2')
    """
    before, after = _EYE.split(name, maxsplit=1)
    ends = "".join(set(re.findall(r"[\W_]", name)))
    return before.rstrip(ends) + after if before.strip(ends) else after.lstrip(ends)


def _seen(folder: Path) -> list[Path]:
    """Return what is in a folder but hidden files, such as the ``._NAME`` beside NAME of macOS."""
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()


def _other_name(name: str) -> str | None:
    """Return the name with its one word for an eye turned round; None: it has none, or several.

    >>> _other_name("für 3_L.mov"), _other_name("Left-%04d.png"), _other_name("leftover.mov")
    ('für 3_R.mov', 'Right-%04d.png', None)
    """
    words = re.split(f"({_WORD})", name)
    places = [place for place, word in enumerate(words) if word.lower() in _OTHER]
    if len(places) != 1:
        return None
    word = words[places[0]]
    for cased in (str.upper, str.lower, str.capitalize):
        if word == cased(word):
            words[places[0]] = cased(_OTHER[word.lower()])
            return "".join(words)
    return None


def _is_left(name: str) -> bool:
    words = re.findall(_WORD, name.lower())
    return "left" in words or "l" in words


def _pairs(names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield (left, right) of those names that are there for both eyes."""
    known = set(names)
    for name in sorted(known):
        other = _other_name(name)
        if other in known and _is_left(name):
            yield name, other


def _rows(names: Iterable[str]) -> dict[str, _Row]:
    """Return the rows of images without a gap, by what their names have in common."""
    stills: dict[str, _Row] = {}
    numbers: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        found = _NUMBERED.fullmatch(name)
        if found is None:
            stills[name] = _Row(pattern=_escaped(name), first=0)
        else:
            before, number, suffix = found.groups()
            numbers.setdefault((before, suffix), {})[int(number)] = number
    for (before, suffix), row in numbers.items():
        first, last = min(row), max(row)
        widths = {len(number) for number in row.values()}
        form = f"%0{len(row[first])}d" if row[first].startswith("0") or len(widths) == 1 else "%d"
        if all(row.get(number) == form % number for number in range(first, last + 1)):
            pattern = f"{_escaped(before)}{form}{_escaped(suffix)}"
            stills[f"{before}{suffix}"] = _Row(pattern=pattern, first=first)
    return stills


def _escaped(name: str) -> str:
    return name.replace("%", "%%")


def _of_videos(folder: Path, pair: tuple[str, str]) -> SceneDescription:
    return _described(folder, VideoFile(path=pair[0]), VideoFile(path=pair[1]), pair)


def _of_rows(folder: Path, pair: tuple[str, str], rows: Mapping[str, _Row]) -> SceneDescription:
    left, right = rows[pair[0]], rows[pair[1]]
    if left.first != right.first:
        raise SceneError(
            f"{left.pattern} begins with {left.first}, {right.pattern} with {right.first}; "
            "a scene.json can name what belongs together",
            path=folder,
        )
    return _described(
        folder, ImageFiles(pattern=left.pattern), ImageFiles(pattern=right.pattern),
        (left.pattern, right.pattern), first_frame=left.first,
    )  # fmt: skip


def _described(
    folder: Path, left: Locator, right: Locator, names: tuple[str, str], first_frame: int = 0
) -> SceneDescription:
    return SceneDescription(
        root=folder,
        source=folder,
        views=(
            ViewDescription(view_id="left", color=left),
            ViewDescription(view_id="right", color=right),
        ),
        left="left",
        right="right",
        first_frame=first_frame,
        layout=LAYOUT,
        notes=(f"{names[0]} is read as the left eye, {names[1]} as the right one",),
    )
