"""The account of a run: what was asked, what was found, what was done, how long it took.

Everything becomes plain JSON values. JSON knows no NaN and no infinity: both
become null. The module reads no clock and opens no file.
"""

from __future__ import annotations

import dataclasses
import json
import math
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from fractions import Fraction
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.frames import MultiViewFrame
from pipeline.job import Job
from pipeline.media.info import SceneInfo
from pipeline.realtime import Account, account_of
from pipeline.sink import OutputPlan

REPORT_FORMAT = "depthsr-report/1"
"""Value of the key ``format``; changes when a key changes its meaning."""

PACKAGES = ("depthsr", "numpy", "opencv-python-headless", "av", "numba")
"""Distributions whose versions a report names."""


def to_plain(value: Any) -> Any:
    """Return the value as dicts, lists, strings, numbers, booleans and None.

    >>> to_plain({"psnr": float("inf"), "rate": Fraction(15), "views": ("a", "b")})
    {'psnr': None, 'rate': '15/1', 'views': ['a', 'b']}
    """
    if value is None or (isinstance(value, (bool, str, int)) and not isinstance(value, Enum)):
        return value
    if isinstance(value, Enum):
        return to_plain(value.value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.generic):
        return to_plain(value.item())
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if isinstance(value, Fraction):
        return f"{value.numerator}/{value.denominator}"
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            item.name: to_plain(getattr(value, item.name)) for item in dataclasses.fields(value)
        }
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, (set, frozenset)):
        return sorted(to_plain(item) for item in value)
    if isinstance(value, range):
        return [value.start, value.stop]
    if isinstance(value, Iterable):
        return [to_plain(item) for item in value]
    raise TypeError(f"no plain form of {type(value).__name__}")


def strict_json(value: Any) -> str:
    """Return the value as JSON text with a final newline; never NaN.

    Bytes of a path that are no text are escaped, as JSON escapes lone surrogates.
    """
    text = json.dumps(to_plain(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    return text.encode(errors="backslashreplace").decode()


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide the result."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def peak_memory_mib() -> float | None:
    """Return the largest resident memory of this process so far, MiB; None where not known."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1 << 20) if sys.platform == "darwin" else size / (1 << 10)


def depth_origin(frame: MultiViewFrame) -> dict[str, str]:
    """Return, by view id, where the depth came from: given, estimated or none."""
    return {
        view.view_id: "none"
        if view.depth_map is None
        else "estimated"
        if view.depth_is_estimated
        else "given"
        for view in frame.views
    }


def unknown_depth(info: SceneInfo, origins: Mapping[str, str]) -> tuple[str, ...]:
    """Return what to say of views whose depth maps hold nothing, by :func:`depth_origin`."""
    return tuple(
        f"view {view_id}: all of its depth is unknown; it is estimated from the neighbours"
        for view_id, is_given in zip(info.view_ids, info.has_depth, strict=True)
        if is_given and origins.get(view_id) == "estimated"
    )


def sum_timings(timings: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the seconds of each stage, added up."""
    total: dict[str, float] = {}
    for record in timings:
        for stage, seconds in record.items():
            total[stage] = total.get(stage, 0.0) + seconds
    return total


def distinct(texts: Iterable[str]) -> list[str]:
    """Return the texts without repetitions, in the order of their first appearance."""
    return list(dict.fromkeys(texts))


def make_report(
    job: Job,
    info: SceneInfo,
    plan: OutputPlan,
    accounts: Sequence[Mapping[str, Any]],
    *,
    run: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the content of report.json: the account of all frames and of the run."""
    frames = [frame for account in accounts for frame in account.get("frames", ())]
    lr_height, lr_width = info.lr_shape
    hr_height, hr_width = plan.hr_shape
    grid_settings = to_plain(job.settings)
    timings = sum_timings([frame["timings"] for frame in frames])
    timings |= sum_timings([account.get("timings", {}) for account in accounts])
    timings["join"] = run["join_seconds"]
    depth: dict[str, Any] = {}
    for frame in frames:
        for view_id, origin in frame["depth"].items():
            depth.setdefault(view_id, []).append(origin)
    realtime = _realtime(job, info, frames)
    return {
        "format": REPORT_FORMAT,
        "versions": versions(),
        "scene": {
            "path": str(job.scene),
            "views": list(info.view_ids),
            "left": info.left,
            "right": info.right,
            "lr_width": lr_width,
            "lr_height": lr_height,
            "frame_numbers": [info.frame_indices.start, info.frame_indices.stop],
            "fps": to_plain(info.fps),
            "bit_depth": info.bit_depth,
            "is_color": info.is_color,
            "primaries": info.colorimetry.names[0],
            "transfer": info.colorimetry.names[1],
            "depth": {view_id: _one_or_mixed(origins) for view_id, origins in depth.items()},
        },
        "settings": grid_settings,
        "input": to_plain(job.input),
        "output": {
            **to_plain(plan.options),
            "targets": list(plan.targets),
            "hr_width": hr_width,
            "hr_height": hr_height,
        },
        "frames": frames,
        **({} if realtime is None else {"realtime": to_plain(realtime)}),
        "timings": timings,
        "run": {
            **{key: value for key, value in run.items() if key != "join_seconds"},
            "peak_memory_mib": peak_memory_mib(),
        },
        "remarks": distinct(
            [
                *([] if realtime is None else [realtime.sentence()]),
                *(
                    f"{target['view_id']}: {target['remark']}"
                    for frame in frames
                    for target in frame["targets"]
                    if target["remark"]
                ),
            ]
        ),
        "warnings": distinct(
            [
                *info.warnings,
                *plan.warnings,
                *(text for frame in frames for text in frame["warnings"]),
            ]
        ),
    }


def _realtime(job: Job, info: SceneInfo, frames: Sequence[Mapping[str, Any]]) -> Account | None:
    """Return what came of holding a rate; None where none was to be held."""
    if not job.settings.realtime:
        return None
    records = [frame["realtime"] for frame in frames]
    return account_of(
        job.settings.rate or float(info.fps),
        ((record["dropped"], record["rung"]) for record in records),
        waited=sum(record["waited"] for record in records),
    )


def _one_or_mixed(values: Sequence[str]) -> str:
    kinds = sorted(set(values))
    return kinds[0] if len(kinds) == 1 else " and ".join(kinds)
