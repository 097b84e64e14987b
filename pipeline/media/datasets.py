"""Folders of known datasets, recognised by the names of their files.

Their conventions of depth:

* MSR 3D video (Zitnick et al. 2004): 8-bit inverse depth between 1 / MinZ (255) and
  1 / MaxZ (0), along the z axis of the *world*; image rows counted from the bottom in the
  calibration, camera numbers from right to left;
* Middlebury 2001: disparity × 8; 2003: × 4 at quarter size; 2005 and 2006: × 3 at third size;
  0 is unknown from 2003 on; 2014: PFM, infinite where unknown, with calibration.
"""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path

import numpy as np

from pipeline.errors import SceneError
from pipeline.frames import Calibration
from pipeline.media.images import ImageHeader, read_header
from pipeline.media.scene import (
    DepthEncoding,
    DepthKind,
    ImageFiles,
    SceneDescription,
    ViewDescription,
)

MSR_FPS = Fraction(15)
"""Rate of the MSR sequences, frames a second."""

MSR_DEPTH_RANGES = {"breakdanc": (44.0, 120.0), "ballet": (42.0, 130.0)}
"""A piece of the scene's name to its MinZ and MaxZ, units of its calibration."""

MIDDLEBURY_2003_SIZES = ((450, 375), (900, 750), (1800, 1500))
"""(width, height) of the 2003 scenes; their older copies are PNM as those of 2001 are."""

# MSR 3D video

_MSR_COLOR = re.compile(r"color-cam(\d+)-f(\d+)\.(jpg|jpeg|png|ppm)", re.IGNORECASE)
_MSR_DEPTH_SUFFIXES = (".png", ".pgm", ".jpg")


def msr_3d_video(folder: Path) -> SceneDescription | None:
    """Return the description of a folder of MSR 3D video, or None."""
    found: dict[int, list[tuple[int, str, int, str]]] = {}
    for path in sorted([*folder.glob("color-cam*"), *folder.glob("cam*/color-cam*")]):
        match = _MSR_COLOR.fullmatch(path.name)
        if match:
            frame, digits = int(match[2]), len(match[2])
            place = (frame, path.parent.relative_to(folder).as_posix(), digits, match[3])
            found.setdefault(int(match[1]), []).append(place)
    if not found:
        return None
    frames = [place[0] for places in found.values() for place in places]
    notes: list[str] = []
    first_camera = found[min(found)][0]
    header = read_header(_msr_path(folder, min(found), first_camera))
    calibrations = _msr_calibrations(folder, header, notes)
    if calibrations:
        lacking = sorted(set(found) - set(calibrations))
        if lacking:
            raise SceneError(
                f"the calibration file has no camera {', '.join(map(str, lacking))}", path=folder
            )
    else:
        notes.append("no calibration file; cameras are taken to run from right to left")
    views = []
    for camera in sorted(found, reverse=True):
        _, parent, digits, suffix = found[camera][0]
        prefix = "" if parent == "." else f"{parent}/"
        number = f"f%0{digits}d" if digits > 1 else "f%d"
        depth = None
        for depth_suffix in _MSR_DEPTH_SUFFIXES:
            name = f"{prefix}depth-cam{camera}-{number}{depth_suffix}"
            if (folder / (name % min(frames))).is_file():
                depth = ImageFiles(pattern=name)
                break
        views.append(
            ViewDescription(
                view_id=f"cam{camera}",
                color=ImageFiles(pattern=f"{prefix}color-cam{camera}-{number}.{suffix}"),
                depth=depth,
                calibration=calibrations.get(camera),
            )
        )
    return SceneDescription(
        root=folder,
        views=tuple(views),
        depth=_msr_depth(folder, bool(calibrations), notes),
        fps=MSR_FPS,
        first_frame=min(frames),
        frame_count=max(frames) - min(frames) + 1,
        layout="msr-3d-video",
        notes=tuple(notes),
        beside=tuple(sorted(path.name for path in folder.glob("*.txt"))),
    )


def _msr_path(folder: Path, camera: int, place: tuple[int, str, int, str]) -> Path:
    frame, parent, digits, suffix = place
    return folder / parent / f"color-cam{camera}-f{frame:0{digits}d}.{suffix}"


def _msr_depth(folder: Path, is_calibrated: bool, notes: list[str]) -> DepthEncoding:
    names = [folder.name, *(path.name for path in folder.glob("*.txt"))]
    for piece, (near, far) in MSR_DEPTH_RANGES.items():
        if any(piece in name.lower() for name in names):
            return DepthEncoding(
                kind=DepthKind.INVERSE_DEPTH,
                scale=(1 / near - 1 / far) / 255,
                offset=1 / far,
                is_world_z=is_calibrated,
            )
    notes.append("neither Breakdancers nor Ballet by name; depth is taken for relative disparity")
    return DepthEncoding(kind=DepthKind.DISPARITY, scale=1 / 255)


def _msr_calibrations(
    folder: Path, header: ImageHeader, notes: list[str]
) -> dict[int, Calibration]:
    files = sorted(path for path in folder.glob("*.txt") if "calib" in path.name.lower())
    if not files:
        return {}
    path = files[0]
    if len(files) > 1:
        notes.append(f"several calibration files; {path.name} is used")
    try:
        numbers = [float(word) for word in path.read_text(encoding="utf-8-sig").split()]
    except (OSError, ValueError) as error:
        raise SceneError(f"not a calibration of numbers: {error}", path=path) from error
    per_camera = 1 + 9 + 2 + 12
    if not numbers or len(numbers) % per_camera or not np.isfinite(numbers).all():
        raise SceneError(
            f"{len(numbers)} numbers, which is not {per_camera} for each camera: its index, "
            "3×3 intrinsics, two of distortion, 3×4 rotation and translation",
            path=path,
        )
    cameras = {}
    for block in np.array(numbers).reshape(-1, per_camera):
        if block[10:12].any():
            notes.append(f"camera {block[0]:.0f}: lens distortion is not corrected")
        cameras[int(block[0])] = _msr_camera(
            block[1:10].reshape(3, 3), block[12:].reshape(3, 4), header.height
        )
    return cameras


def _msr_camera(intrinsics: np.ndarray, motion: np.ndarray, height: int) -> Calibration:
    """Return a camera with y down from MSR's, whose y runs up from the bottom row.

    With F = diag(1, −1, 1) the world and the camera are both mirrored, R' = F R F and
    t' = F t; a row v from the bottom is row H − 1 − v from the top.
    """
    flip = np.diag([1.0, -1.0, 1.0])
    camera = intrinsics.copy()
    camera[0, 1] = -camera[0, 1]
    camera[1, 2] = height - 1 - camera[1, 2]
    left, _, right = np.linalg.svd(motion[:, :3])  # six decimals are not quite a rotation
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = flip @ (left @ right) @ flip
    world_to_camera[:3, 3] = flip @ motion[:, 3]
    return Calibration(intrinsics=camera, world_to_camera=world_to_camera)


# Middlebury stereo


def middlebury_2014(folder: Path) -> SceneDescription | None:
    """Return that of a scene of Middlebury 2014, or None."""
    names = [_first_file(folder, f"im{index}", (".png", ".ppm")) for index in (0, 1)]
    if None in names or not ((folder / "calib.txt").is_file() or any(folder.glob("disp?*.pfm"))):
        return None
    notes: list[str] = []
    depths = [
        _first_file(folder, f"disp{index}", (".pfm",))
        or _first_file(folder, f"disp{index}GT", (".pfm",))
        for index in (0, 1)
    ]
    header = read_header(folder / str(names[0]))
    calibration = _middlebury_calibration(folder / "calib.txt", header, notes)
    encoding = DepthEncoding(kind=DepthKind.DISPARITY)
    cameras: tuple[Calibration | None, ...] = (None, None)
    if calibration is not None:
        first, second, doffs, baseline = calibration
        factor = 1.0 / (baseline * first[0, 0])
        encoding = DepthEncoding(kind=DepthKind.INVERSE_DEPTH, scale=factor, offset=doffs * factor)
        beside = np.eye(4)
        beside[0, 3] = -baseline
        cameras = (
            Calibration(intrinsics=first, world_to_camera=np.eye(4)),
            Calibration(intrinsics=second, world_to_camera=beside),
        )
    views = tuple(
        ViewDescription(
            view_id=f"im{index}",
            color=ImageFiles(pattern=str(names[index])),
            depth=None if depths[index] is None else ImageFiles(pattern=str(depths[index])),
            calibration=cameras[index],
        )
        for index in (0, 1)
    )
    return SceneDescription(
        root=folder, views=views, depth=encoding, layout="middlebury-2014", notes=tuple(notes),
        beside=("calib.txt",) if (folder / "calib.txt").is_file() else (),
    )  # fmt: skip


def _middlebury_calibration(
    path: Path, header: ImageHeader, notes: list[str]
) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """Return (K₀, K₁, doffs, baseline), or None where there is none to use."""
    if not path.is_file():
        notes.append("no calib.txt; disparities are used without calibration")
        return None
    entries = {}
    for line in path.read_text(encoding="utf-8-sig", errors="replace").splitlines():
        key, _, value = line.partition("=")
        entries[key.strip()] = value.strip()
    try:
        cameras = []
        for key in ("cam0", "cam1"):
            rows = [row.split() for row in entries[key].strip("[]").split(";")]
            cameras.append(np.array(rows, dtype=np.float64).reshape(3, 3))
        baseline, focal = float(entries["baseline"]), cameras[0][0, 0]
        doffs = float(entries.get("doffs", cameras[1][0, 2] - cameras[0][0, 2]))
        size = (int(entries["width"]), int(entries["height"])) if "width" in entries else None
    except (KeyError, ValueError) as error:
        raise SceneError(
            f"not a Middlebury calibration (cam0, cam1, doffs, baseline): {error}", path=path
        ) from error
    numbers = [*cameras[0].flat, *cameras[1].flat, doffs, baseline]
    if not np.isfinite(numbers).all() or baseline <= 0 or focal <= 0:
        raise SceneError("focal length or baseline out of range", path=path)
    if size is not None and size != (header.width, header.height):
        notes.append("calib.txt is of another image size; disparities are used without it")
        return None
    return cameras[0], cameras[1], doffs, baseline


def middlebury_2005(folder: Path) -> SceneDescription | None:
    """Return that of a scene of Middlebury 2005 or 2006, or None."""
    colors = _numbered(folder, "view", (".png",))
    depths = _numbered(folder, "disp", (".png",))
    if len(colors) < 2 or not set(colors) & set(depths):
        return None
    width = _width(folder, colors)
    scale = Fraction(1, 3) if width <= 520 else Fraction(1, 2) if width <= 800 else Fraction(1)
    note = f"{width} pixels wide: taken for the 2005 or 2006 set, disparity × {1 / scale}"
    encoding = DepthEncoding(kind=DepthKind.DISPARITY, scale=float(scale), unknown=0.0)
    return _middlebury_still(folder, "view", colors, depths, encoding, "middlebury-2005", note)


def middlebury_2001_or_2003(folder: Path) -> SceneDescription | None:
    """Return that of a scene of Middlebury 2001 or 2003, or None."""
    colors = _numbered(folder, "im", (".png", ".ppm"))
    depths = _numbered(folder, "disp", (".png", ".pgm"))
    if len(colors) < 2 or not set(colors) & set(depths):
        return None
    header = read_header(folder / next(iter(colors.values())))
    size = (header.width, header.height)
    is_pnm = any(name.endswith(".ppm") for name in colors.values())
    if is_pnm and size not in MIDDLEBURY_2003_SIZES:
        encoding = DepthEncoding(kind=DepthKind.DISPARITY, scale=1 / 8)
        note = "PPM files: taken for the 2001 set, disparity × 8"
        return _middlebury_still(folder, "im", colors, depths, encoding, "middlebury-2001", note)
    width = header.width
    scale = Fraction(1, 4) if width <= 600 else Fraction(1, 2) if width <= 1200 else Fraction(1)
    note = f"{width} pixels wide: taken for the 2003 set, disparity × {1 / scale}"
    encoding = DepthEncoding(kind=DepthKind.DISPARITY, scale=float(scale), unknown=0.0)
    return _middlebury_still(folder, "im", colors, depths, encoding, "middlebury-2003", note)


def _middlebury_still(
    folder: Path,
    prefix: str,
    colors: dict[int, str],
    depths: dict[int, str],
    encoding: DepthEncoding,
    layout: str,
    note: str,
) -> SceneDescription:
    views = tuple(
        ViewDescription(
            view_id=f"{prefix}{number}",
            color=ImageFiles(pattern=name),
            depth=ImageFiles(pattern=depths[number]) if number in depths else None,
        )
        for number, name in colors.items()
    )
    pair = [f"{prefix}{number}" for number in colors if number in depths]
    return SceneDescription(
        root=folder,
        views=views,
        depth=encoding,
        left=pair[0] if len(pair) >= 2 else None,
        right=pair[1] if len(pair) >= 2 else None,
        layout=layout,
        notes=(note,),
    )


def _numbered(folder: Path, prefix: str, suffixes: tuple[str, ...]) -> dict[int, str]:
    """Return number → file name of the files ``prefixN.suffix``, by number."""
    found: dict[int, str] = {}
    for suffix in reversed(suffixes):
        for path in folder.glob(f"{prefix}*{suffix}"):
            number = path.name[len(prefix) : -len(suffix)]
            if number.isdecimal() and str(int(number)) == number and path.is_file():
                found[int(number)] = path.name
    return dict(sorted(found.items()))


def _width(folder: Path, names: dict[int, str]) -> int:
    return read_header(folder / next(iter(names.values()))).width


def _first_file(folder: Path, stem: str, suffixes: tuple[str, ...]) -> str | None:
    for suffix in suffixes:
        if (folder / f"{stem}{suffix}").is_file():
            return f"{stem}{suffix}"
    return None
