"""What was understood of a scene, and what was not: as plain values and as text."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from pipeline.frames import MultiViewFrame, View
from pipeline.media.info import SceneInfo
from pipeline.media.sound import sound_codec
from pipeline.media.source import FrameSource

MOSTLY_UNKNOWN = 0.9
"""A map with more than this share of unknown pixels is worth a warning."""


def describe(source: FrameSource) -> dict[str, Any]:
    """Return what is known of a scene; its first frame is read for that.

    Parameters
    ----------
    source : FrameSource
        An open scene.

    Returns
    -------
    dict
        Plain values that JSON can hold. ``views[i].nearness`` is the (lowest, highest) value
        of the first frame: in 1 / scene unit where ``depth.metric``, else in the unit of the
        maps that are given, else pixels of disparity. ``sound`` is the codec of what goes along.
        ``warnings`` lists what was guessed, ignored or looks suspicious.

    Raises
    ------
    SceneError
        If the first frame cannot be read.
    """
    info = source.info
    frame = source.read(info.frame_indices.start)
    given = dict(zip(info.view_ids, info.has_depth, strict=True))
    views = [_view(view, given[view.view_id]) for view in frame.views]
    height, width = info.lr_shape
    return {
        "path": info.path,
        "layout": info.layout,
        "views": views,
        "width": width,
        "height": height,
        "bit_depth": info.bit_depth,
        "color": info.is_color,
        "primaries": info.colorimetry.names[0],
        "transfer": info.colorimetry.names[1],
        "pixel_aspect": str(info.pixel_aspect),
        "input_layout": info.input_layout,
        "frames": {
            "first": info.frame_indices.start,
            "last": info.frame_indices.stop - 1,
            "count": info.num_frames,
        },
        "timecode": info.timecode,
        "sound": None if info.sound is None else sound_codec(info.sound),
        "fps": f"{info.fps.numerator}/{info.fps.denominator}",
        "depth": {
            "kind": info.depth_kind,
            "metric": info.depth_is_metric,
            "range": _depth_range(frame),
        },
        "calibration": info.has_calibration,
        "stereo": {"left": info.left, "right": info.right},
        "warnings": [*info.warnings, *_warnings(info, views)],
    }


def format_description(description: Mapping[str, Any]) -> str:
    """Return the text for a description, a line for each thing, without a last newline."""
    frames, depth = description["frames"], description["depth"]
    colour = "colour" if description["color"] else "grey"
    size = f"{description['width']}×{description['height']}"
    lines = [
        f"{description['path']}: {description['layout']}",
        f"  views        {len(description['views'])}, left to right: "
        + ", ".join(view["id"] for view in description["views"]),
        f"  pictures     {size}, {colour}, {description['bit_depth']} bits",
        f"  colours      {description['primaries']} primaries, {description['transfer']} transfer",
        f"  frames       {frames['count']}: {frames['first']} to {frames['last']}, "
        f"{_rate_text(description['fps'])} a second",
        f"  depth        {_depth_text(depth)}",
        f"  calibration  {'yes' if description['calibration'] else 'no'}",
        f"  stereo pair  {_pair_text(description)}",
    ]
    if description["timecode"]:
        lines.insert(5, f"  time code    {description['timecode']}")
    if description["sound"]:
        lines.insert(5, f"  sound        {description['sound']}, goes along as it is")
    if description["pixel_aspect"] != "1" and not description["input_layout"]:
        lines.insert(3, f"  pixel aspect {description['pixel_aspect']}")
    if description["input_layout"]:
        lines.insert(
            3,
            f"  packing      {description['input_layout']}, "
            f"pixel aspect {description['pixel_aspect']}",
        )
    for view in description["views"]:
        lines.append(f"    {view['id']}: {_view_text(view, _unit(depth))}")
    lines.extend(f"  warning: {warning}" for warning in description["warnings"])
    return "\n".join(lines)


def _view(view: View, given: bool) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "id": view.view_id,
        "depth_given": given,
        "depth_estimated": view.depth_is_estimated,
        "calibration": view.calibration is not None,
        "nearness": None,
        "unknown_fraction": 1.0,
    }
    if view.depth_map is not None:
        known = view.depth_map[np.isfinite(view.depth_map)]
        entry["unknown_fraction"] = 1.0 - known.size / view.depth_map.size
        if known.size:
            entry["nearness"] = [float(known.min()), float(known.max())]
    return entry


def _depth_range(frame: MultiViewFrame) -> list[float] | None:
    """Return (lowest, highest): distance where metric, else nearness; None where unknown."""
    known = [
        view.depth_map[np.isfinite(view.depth_map)]
        for view in frame.views
        if view.depth_map is not None
    ]
    low = min((float(values.min()) for values in known if values.size), default=None)
    high = max((float(values.max()) for values in known if values.size), default=None)
    if low is None or high is None:
        return None
    if frame.depth_is_metric and low > 0:
        return [1.0 / high, 1.0 / low]
    return [low, high]


def _warnings(info: SceneInfo, views: list[dict[str, Any]]) -> list[str]:
    found = []
    first = info.frame_indices.start
    for view in views:
        name = f"view {view['id']!r}, frame {first}"
        if view["depth_given"] and view["depth_estimated"]:
            found.append(f"{name}: every depth value is unknown; it is estimated instead")
        elif view["depth_given"] and view["nearness"] is None:
            found.append(f"{name}: every depth value is unknown")
        elif view["depth_estimated"] and view["nearness"] is None:
            found.append(f"{name}: no depth could be estimated")
        elif view["nearness"] is None:
            found.append(f"{name}: no depth, and no neighbour to estimate it from")
        elif view["nearness"][0] == view["nearness"][1]:
            found.append(f"{name}: constant depth, which is one layer")
        elif view["unknown_fraction"] > MOSTLY_UNKNOWN:
            found.append(f"{name}: {view['unknown_fraction']:.0%} of the depth is unknown")
    return found


def _depth_text(depth: Mapping[str, Any]) -> str:
    kind = "not given" if depth["kind"] is None else str(depth["kind"]).replace("_", " ")
    if depth["range"] is None:
        return f"{kind}, nothing known"
    low, high = depth["range"]
    what, unit = (
        ("distance", "units of the calibration") if depth["metric"] else ("nearness", _unit(depth))
    )
    return f"{kind}, {what} {low:.4g} to {high:.4g} in {unit}"


def _unit(depth: Mapping[str, Any]) -> str:
    """Return what nearness is counted in."""
    if depth["metric"]:
        return "1 / unit of the calibration"
    return "pixels of disparity" if depth["kind"] is None else "the unit of the depth maps"


def _rate_text(fps: str) -> str:
    """Return frames a second to read, a rate that is no decimal number with its fraction.

    >>> _rate_text("25/1"), _rate_text("25/2"), _rate_text("30000/1001")
    ('25', '12.5', '29.97 (30000/1001)')
    """
    rate = Fraction(fps)
    text = f"{float(rate):.2f}".rstrip("0").rstrip(".")
    return text if Fraction(text) == rate else f"{text} ({rate})"


def _pair_text(description: Mapping[str, Any]) -> str:
    read = {view["id"] for view in description["views"]}
    return ", ".join(
        f"{eye} {view_id}{'' if view_id in read else ' (not among the views)'}"
        for eye, view_id in description["stereo"].items()
    )


def _view_text(view: Mapping[str, Any], unit: str) -> str:
    origin = "estimated" if view["depth_estimated"] else "given" if view["depth_given"] else "none"
    if view["nearness"] is None:
        return f"depth {origin}, nothing known"
    low, high = view["nearness"]
    return (
        f"depth {origin}, nearness {low:.4g} to {high:.4g} in {unit}, "
        f"{view['unknown_fraction']:.1%} unknown"
    )
