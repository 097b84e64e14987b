"""The manifest of a scene, ``scene.json``: read, checked and written."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pipeline.errors import SceneError
from pipeline.frames import Calibration
from pipeline.media.images import IMAGE_SUFFIXES
from pipeline.media.scene import (
    CONVERSION,
    DepthEncoding,
    DepthKind,
    ImageFiles,
    Locator,
    PackedEye,
    RawVideo,
    SceneDescription,
    VideoFile,
    ViewDescription,
    confined,
)
from pipeline.media.ycbcr import YcbcrMatrix
from pipeline.media.yuv import Range, parse_pixel_format

MANIFEST_NAME = "scene.json"
"""Name of a manifest in its folder."""

MANIFEST_FORMAT = "depthsr-scene/1"
"""The only format there is."""

MAX_MANIFEST_BYTES = 16 << 20
"""A manifest longer than this is refused, bytes."""

MAX_FRAMES_PER_SECOND = 1000
"""Rates above are taken for a mistake."""

_RATE = re.compile(r"[0-9]{1,12}(\.[0-9]{1,12}|/[0-9]{1,12})?")
_ID = re.compile(r"[^\x00-\x1f\x7f,/\\\s](?:[^\x00-\x1f\x7f,/\\]*[^\x00-\x1f\x7f,/\\\s])?")


def read_manifest(path: Path) -> SceneDescription:
    """Return the scene that a manifest describes.

    Parameters
    ----------
    path : Path
        The manifest, or the folder that holds ``scene.json``.

    Returns
    -------
    SceneDescription
        Checked as far as it can be without opening a picture.

    Raises
    ------
    SceneError
        If it cannot be read, is not of the format, has unknown keys, or names files outside
        its folder; the message names the file, the view and the key.
    """
    if path.is_dir():
        path = path / MANIFEST_NAME
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_MANIFEST_BYTES + 1)
    except OSError as error:
        raise SceneError(f"cannot be read: {error.strerror}", path=path) from error
    return parse_manifest(read_json(raw, path), path)


def read_json(raw: bytes, path: Path) -> Any:
    """Return the content of a manifest as plain values.

    Raises
    ------
    SceneError
        If it is too long, no JSON, or has a key twice.
    """
    if len(raw) > MAX_MANIFEST_BYTES:
        raise SceneError(f"longer than {MAX_MANIFEST_BYTES >> 20} MiB", path=path)
    try:
        content = json.loads(
            raw.decode("utf-8-sig"),
            object_pairs_hook=_unique_keys,
            parse_constant=_no_constant,
        )
        json.dumps(content, ensure_ascii=False).encode("utf-8")  # no half characters
    except (ValueError, RecursionError) as error:
        raise SceneError(f"not JSON as it should be: {error}", path=path) from error
    return content


def parse_manifest(content: Any, path: Path) -> SceneDescription:
    """Return the scene of a manifest's plain values; ``path`` is where it lies, or its name."""
    return _Parser(path).scene(content)


def write_manifest(description: SceneDescription, path: Path) -> None:
    """Write a scene's manifest.

    Parameters
    ----------
    description : SceneDescription
        A scene of image files, video files or raw video.
    path : Path
        The manifest to be written, or the folder to write ``scene.json`` into. Paths of the
        scene stay as they are, so it should lie in the scene's folder.

    Raises
    ------
    SceneError
        If the manifest cannot say what the scene is (halves of stereo pictures, depth along
        the world's axis).
    """
    if path.is_dir():
        path = path / MANIFEST_NAME
    text = json.dumps(manifest_of(description), indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def manifest_of(description: SceneDescription) -> dict[str, Any]:
    """Return the manifest of a scene as plain values; see :func:`write_manifest`."""
    depth = description.depth
    if depth is not None and depth.is_world_z:
        raise SceneError("a manifest cannot say that depth runs along the world's z axis")
    manifest: dict[str, Any] = {"format": MANIFEST_FORMAT}
    if description.fps is not None:
        manifest["fps"] = f"{description.fps.numerator}/{description.fps.denominator}"
    manifest["first_frame"] = description.first_frame
    if description.frame_count is not None:
        manifest["frame_count"] = description.frame_count
    manifest["views"] = [_view_manifest(view) for view in description.views]
    if depth is not None:
        manifest["depth"] = {
            "kind": depth.kind.value,
            "scale": depth.scale,
            "offset": depth.offset,
            "unknown": depth.unknown,
        }
    manifest["stereo"] = {"left": description.left, "right": description.right}
    return manifest


def _view_manifest(view: ViewDescription) -> dict[str, Any]:
    entry: dict[str, Any] = {"id": view.view_id, "color": _locator_manifest(view.color)}
    if view.depth is not None:
        entry["depth"] = _locator_manifest(view.depth)
    if view.calibration is not None:
        entry["intrinsics"] = view.calibration.intrinsics.tolist()
        entry["world_to_camera"] = view.calibration.world_to_camera.tolist()
    return entry


def _locator_manifest(locator: Locator) -> Any:
    if isinstance(locator, ImageFiles):
        return locator.pattern
    if isinstance(locator, VideoFile):
        return locator.path
    if isinstance(locator, PackedEye):
        raise SceneError("a manifest cannot name one half of a stereo picture", path=locator.path)
    entry: dict[str, Any] = {
        "yuv": locator.path,
        "width": locator.width,
        "height": locator.height,
        "pixel_format": locator.pixel_format,
    }
    if locator.matrix is not None:
        entry["matrix"] = locator.matrix.value
    if locator.range is not None:
        entry["range"] = locator.range.value
    return entry


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = sorted({key for key in keys if keys.count(key) > 1})
        raise ValueError(f"key occurs twice: {', '.join(map(repr, twice))}")
    return found


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


@dataclass(frozen=True)
class _Parser:
    """Checks the values of one manifest; every complaint names the file and the key."""

    path: Path
    root: Path = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", self.path.parent.resolve())

    def fail(self, message: str, view: str | None = None) -> NoReturn:
        raise SceneError(message, path=self.path, view=view)

    def scene(self, content: Any) -> SceneDescription:
        content = self.mapping(content, "the manifest")
        if content.get("format") != MANIFEST_FORMAT:
            self.fail(f"format: must be {MANIFEST_FORMAT!r}, not {content.get('format')!r}")
        self.keys(
            content,
            "the manifest",
            "format fps first_frame frame_count views depth stereo",
            "format views",
        )
        entries = content["views"]
        if not isinstance(entries, list):
            self.fail("views: must be a list")
        views = tuple(self.view(entry, index) for index, entry in enumerate(entries))
        stereo = self.stereo(content.get("stereo"))
        return SceneDescription(
            root=self.root,
            source=self.path,
            views=views,
            depth=self.depth(content.get("depth")),
            fps=self.rate(content.get("fps")),
            first_frame=self.integer(content.get("first_frame", 0), "first_frame", 0),
            frame_count=(
                self.integer(content["frame_count"], "frame_count", 1)
                if content.get("frame_count") is not None
                else None
            ),
            left=stereo.get("left"),
            right=stereo.get("right"),
        )

    def view(self, entry: Any, index: int) -> ViewDescription:
        entry = self.mapping(entry, f"views[{index}]")
        view_id = entry.get("id")
        if not isinstance(view_id, str):
            self.fail(f"views[{index}]: id must be a text")
        if not _ID.fullmatch(view_id) or view_id in (".", ".."):
            self.fail(
                f"views[{index}]: id {view_id!r} must be free of commas, slashes, control "
                "characters and outer blanks, and not empty"
            )
        self.keys(entry, "", "id color depth intrinsics world_to_camera", "id color", view_id)
        depth = entry.get("depth")
        return ViewDescription(
            view_id=view_id,
            color=self.locator(entry["color"], "color", view_id),
            depth=None if depth is None else self.locator(depth, "depth", view_id),
            calibration=self.calibration(entry, view_id),
        )

    def locator(self, entry: Any, key: str, view_id: str) -> Locator:
        if isinstance(entry, str):
            self.confined(entry, key, view_id)
            is_image = Path(entry).suffix.lower() in IMAGE_SUFFIXES
            if not is_image and "%" not in entry:
                return VideoFile(path=entry)
            bare = entry.replace("%%", "")
            if bare.count("%") > 1 or ("%" in bare and not CONVERSION.search(bare)):
                self.fail(
                    f"{key}: bad pattern {entry!r}: one %d or %04d, and %% for a per cent sign",
                    view_id,
                )
            if not is_image:
                self.fail(
                    f"{key}: a pattern must name image files (PNG, JPEG, PGM, PPM, PFM or TIFF), "
                    f"not {entry!r}",
                    view_id,
                )
            return ImageFiles(pattern=entry)
        if not isinstance(entry, dict):
            self.fail(f"{key}: must be a path, or raw video", view_id)
        return self.raw(entry, key, view_id)

    def raw(self, entry: Mapping[str, Any], key: str, view_id: str) -> RawVideo:
        known = "yuv width height pixel_format matrix range"
        self.keys(entry, f"{key}: ", known, "yuv width height pixel_format", view_id)
        path, pixel_format = entry["yuv"], entry["pixel_format"]
        if not isinstance(path, str):
            self.fail(f"{key}: yuv must be a path", view_id)
        self.confined(path, f"{key}: yuv", view_id)
        try:
            parse_pixel_format(pixel_format)
        except ValueError as error:
            self.fail(f"{key}: {error}", view_id)
        matrix, value_range = entry.get("matrix"), entry.get("range")
        if matrix is not None and matrix not in list(YcbcrMatrix):
            self.fail(
                f"{key}: matrix must be one of {', '.join(YcbcrMatrix)}, not {matrix!r}", view_id
            )
        if value_range is not None and value_range not in list(Range):
            self.fail(
                f"{key}: range must be one of {', '.join(Range)}, not {value_range!r}", view_id
            )
        return RawVideo(
            path=path,
            width=self.integer(entry["width"], f"{key}: width", 1, view_id),
            height=self.integer(entry["height"], f"{key}: height", 1, view_id),
            pixel_format=pixel_format,
            matrix=None if matrix is None else YcbcrMatrix(matrix),
            range=None if value_range is None else Range(value_range),
        )

    def confined(self, relative: str, key: str, view_id: str) -> None:
        if not relative or "\x00" in relative:
            self.fail(f"{key}: must be a path", view_id)
        try:
            confined(self.root, relative)
        except SceneError as error:
            self.fail(f"{key}: {error}", view_id)

    def calibration(self, entry: Mapping[str, Any], view_id: str) -> Calibration | None:
        intrinsics, world_to_camera = entry.get("intrinsics"), entry.get("world_to_camera")
        if intrinsics is None and world_to_camera is None:
            return None
        if intrinsics is None or world_to_camera is None:
            missing = "intrinsics" if intrinsics is None else "world_to_camera"
            self.fail(f"{missing}: missing; a calibration is both matrices or neither", view_id)
        camera = self.matrix(intrinsics, "intrinsics", (3, 3), view_id)
        motion = self.matrix(world_to_camera, "world_to_camera", (4, 4), view_id)
        if camera[0, 0] <= 0 or camera[1, 1] <= 0:
            self.fail("intrinsics: focal lengths must be above 0", view_id)
        if not np.allclose(camera[2], (0, 0, 1)) or camera[1, 0] != 0:
            self.fail("intrinsics: must be upper triangular with a last row of 0, 0, 1", view_id)
        if not np.allclose(motion[3], (0, 0, 0, 1)):
            self.fail("world_to_camera: the last row must be 0, 0, 0, 1", view_id)
        rotation = motion[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
            self.fail("world_to_camera: its 3×3 part is not a rotation", view_id)
        if np.linalg.det(rotation) < 0:
            self.fail("world_to_camera: its 3×3 part mirrors", view_id)
        return Calibration(intrinsics=camera, world_to_camera=motion)

    def matrix(self, value: Any, key: str, shape: tuple[int, int], view_id: str) -> np.ndarray:
        rows, columns = shape
        good = isinstance(value, list) and len(value) == rows
        good = good and all(isinstance(row, list) and len(row) == columns for row in value)
        if not good or not all(_is_number(item) for row in value for item in row):
            self.fail(f"{key}: must be {rows} rows of {columns} finite numbers", view_id)
        matrix = np.array(value, dtype=np.float64)
        matrix.flags.writeable = False
        return matrix

    def depth(self, entry: Any) -> DepthEncoding | None:
        if entry is None:
            return None
        entry = self.mapping(entry, "depth")
        self.keys(entry, "depth: ", "kind scale offset unknown", "kind")
        kind = entry["kind"]
        if kind not in list(DepthKind):
            self.fail(f"depth: kind must be one of {', '.join(DepthKind)}, not {kind!r}")
        unknown = entry.get("unknown")
        for key in ("scale", "offset", "unknown"):
            value = entry.get(key)
            if (key in entry and value is None and key != "unknown") or (
                value is not None and not _is_number(value)
            ):
                self.fail(f"depth: {key} must be a finite number, not {value!r}")
        scale = float(entry.get("scale", 1.0))
        if scale == 0:
            self.fail("depth: scale must not be 0")
        return DepthEncoding(
            kind=DepthKind(kind),
            scale=scale,
            offset=float(entry.get("offset", 0.0)),
            unknown=None if unknown is None else float(unknown),
        )

    def stereo(self, entry: Any) -> Mapping[str, str]:
        if entry is None:
            return {}
        entry = self.mapping(entry, "stereo")
        self.keys(entry, "stereo: ", "left right", "left right")
        for key, value in entry.items():
            if not isinstance(value, str):
                self.fail(f"stereo: {key} must be a view's id, not {value!r}")
        return entry

    def rate(self, value: Any) -> Fraction | None:
        if value is None:
            return None
        try:
            if isinstance(value, bool) or not isinstance(value, (str, int, float)):
                raise ValueError
            if not _RATE.fullmatch(text := str(value).strip()):
                raise ValueError
            rate = Fraction(text)
        except (ValueError, ZeroDivisionError):
            self.fail(f"fps: must be frames a second such as 15/1, not {value!r}")
        if not 0 < rate <= MAX_FRAMES_PER_SECOND:
            self.fail(f"fps: must be above 0, up to {MAX_FRAMES_PER_SECOND}, not {value!r}")
        return rate.limit_denominator(1_000_000)

    def integer(self, value: Any, key: str, least: int, view_id: str | None = None) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 1 << 31:
            self.fail(f"{key}: must be a whole number from {least} up, not {value!r}", view_id)
        return value

    def mapping(self, value: Any, name: str) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            self.fail(f"{name}: must be a JSON object")
        return value

    def keys(
        self,
        entry: Mapping[str, Any],
        name: str,
        known: str,
        needed: str,
        view_id: str | None = None,
    ) -> None:
        unknown = sorted(set(entry) - set(known.split()))
        prefix = name if name.endswith(": ") else ""
        if unknown:
            self.fail(
                f"{prefix}unknown key{'s' if len(unknown) > 1 else ''} "
                f"{', '.join(map(repr, unknown))}; known are {', '.join(known.split())}",
                view_id,
            )
        missing = [key for key in needed.split() if entry.get(key) is None]
        if missing:
            self.fail(f"{prefix}missing: {', '.join(missing)}", view_id)


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False
