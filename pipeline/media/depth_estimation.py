"""Depth for views that have none, from the views beside them.

Neighbouring views are matched in pairs: rectified where both are calibrated, which gives
metric nearness; else with the assumption that rows correspond, which gives disparities. The
units of different pairs are brought together by what they say of the view they share, so that
all maps of a frame, given and estimated, are on one scale. Not in the thesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pipeline.frames import DepthMap, View
from pipeline.media.rectification import calibrated_disparity_range, match_calibrated_pair
from pipeline.media.stereo_matching import PairMatch, disparity_range, match_pair

MERGE_AGREEMENT = 0.06
"""Estimates from left and right that differ by at most this part of the range are averaged."""

WANTED_SPAN = 12.0
"""Disparities of a pair should span about this much, pixels."""

LARGEST_SHIFT = 0.25
"""Partners whose pictures shift by more than this part of the width are not sought."""

MIN_COMMON = 200
"""Pixels two maps must share before their scales are compared."""

SAMPLE = 20000
"""At most this many pixels, and as many pairs of them, settle a scale."""

MIN_SPREAD = 0.02
"""Least spread of a map, as a part of its largest magnitude, for a slope to be measured."""


def estimate_missing_depth(views: Sequence[View], *, depth_is_metric: bool) -> list[View]:
    """Return the views, each with a depth map as far as one can be had.

    Parameters
    ----------
    views : sequence of View
        One instant, left to right. Views with a depth map are returned as they are.
    depth_is_metric : bool
        True where nearness is 1 / depth in the units of the calibration; then all views are
        calibrated and estimates need no scaling.

    Returns
    -------
    list of View
        Filled views have ``depth_is_estimated`` set; their maps are NaN where nothing was
        found, everywhere if need be. A view alone stays without depth.
    """
    missing = sorted(index for index, view in enumerate(views) if view.depth_map is None)
    if not missing or len(views) < 2:
        return list(views)
    pairs = {
        (left, right): _matched_pair(views[left], views[right])
        for left, right in chosen_pairs(len(views), missing, _step(views))
    }
    if not depth_is_metric:
        pairs = _on_one_scale(views, pairs)
    filled = list(views)
    for index in missing:
        before = [pair for pair in pairs if pair[1] == index]
        after = [pair for pair in pairs if pair[0] == index]
        candidates = [pairs[min(before)].right] if before else []  # the furthest partners
        candidates += [pairs[max(after)].left] if after else []
        filled[index] = replace(views[index], depth_map=merged(candidates), depth_is_estimated=True)
    return filled


def chosen_pairs(num_views: int, missing: Sequence[int], step: int) -> list[tuple[int, int]]:
    """Return which views are matched with which, (left, right), in order.

    With no depth at all, every ``step``-th view is a hub: hubs are matched with the next hub,
    the views between with the hubs at least half a step away, so that all pairs hang together.
    With some depth given, each view without is matched with the views ``step`` to its left and
    right.

    Parameters
    ----------
    num_views : int
        Views in the row, 2 or more.
    missing : sequence of int
        Places of the views without depth.
    step : int
        How many views further the partner should stand, 1 or more.
    """
    last = num_views - 1
    if len(missing) < num_views:
        wanted = {(max(0, index - step), index) for index in missing}
        wanted |= {(index, min(last, index + step)) for index in missing}
        return sorted(pair for pair in wanted if pair[0] < pair[1])
    hubs = list(range(0, last + 1, step))
    if hubs[-1] != last:
        if len(hubs) > 1 and last - hubs[-1] <= step // 2:
            hubs.pop()
        hubs.append(last)
    wanted = set(pairwise(hubs))
    for before, after in pairwise(hubs):
        for index in range(before + 1, after):
            if 2 * (index - before) >= after - before:
                wanted.add((before, index))
            if 2 * (after - index) >= after - before:
                wanted.add((index, after))
    return sorted(wanted)


def _step(views: Sequence[View]) -> int:
    """Return how many views further a partner should stand: more where parallax is tiny.

    Disparities come in sixteenths of a pixel and lock to whole ones; neighbours in a light
    field differ by little more than that, views at its ends by enough.
    """
    if len(views) == 2:
        return 1
    middle = (len(views) - 1) // 2
    left, right = views[middle], views[middle + 1]
    if left.calibration is not None and right.calibration is not None:
        span = calibrated_disparity_range(
            left.luma, right.luma, left.calibration, right.calibration
        )
    else:
        span = disparity_range(left.luma, right.luma)
    if span is None:
        return 1
    by_range = WANTED_SPAN / max(span[1] - span[0], 0.25)
    by_overlap = LARGEST_SHIFT * left.luma.shape[1] / max(abs(span[0]), abs(span[1]), 0.25)
    return max(1, min(len(views) - 1, int(min(by_range, by_overlap))))


def merged(candidates: Sequence[DepthMap]) -> DepthMap:
    """Return one map from one or two of a view, on one scale.

    Parameters
    ----------
    candidates : sequence of ndarray of shape (H, W), float32
        Nearness, NaN where unknown.

    Returns
    -------
    ndarray of shape (H, W), float32
        The mean where both are known and agree, the one that is known where only one is, NaN
        where they contradict each other.
    """
    if len(candidates) == 1:
        return candidates[0]
    first, second = candidates
    both = np.isfinite(first) & np.isfinite(second)
    known = np.concatenate([first[np.isfinite(first)], second[np.isfinite(second)]])
    if not known.size:
        return first
    low, high = np.percentile(known[:: max(1, known.size // 20000)], (1, 99))
    result = np.where(np.isfinite(first), first, second)
    with np.errstate(invalid="ignore"):
        agree = np.abs(first - second) <= MERGE_AGREEMENT * (high - low)
    result[both] = np.where(agree, 0.5 * (first + second), np.nan)[both]
    return result.astype(np.float32, copy=False)


def _matched_pair(left: View, right: View) -> PairMatch:
    if left.calibration is not None and right.calibration is not None:
        return match_calibrated_pair(left.luma, right.luma, left.calibration, right.calibration)
    return match_pair(left.luma, right.luma)


@dataclass(frozen=True, kw_only=True)
class Scale:
    """A change of units: wanted = factor · measured + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def applied(self, match: PairMatch) -> PairMatch:
        """Return both maps of a pair in the wanted units."""
        factor, offset = np.float32(self.factor), np.float32(self.offset)
        return PairMatch(left=match.left * factor + offset, right=match.right * factor + offset)


def fitted_scale(measured: DepthMap, wanted: DepthMap) -> Scale | None:
    """Return the change of units that takes one map of a view to another.

    Parameters
    ----------
    measured, wanted : ndarray of shape (H, W), float32
        Two maps of the same view, each growing with nearness, NaN where unknown.

    Returns
    -------
    Scale or None
        Robust line (median of the slopes between pixels of unlike depth, Theil–Sen); a plain
        offset where the scene is too flat for a slope; None where the maps share too little.
    """
    common = np.flatnonzero(np.isfinite(measured).ravel() & np.isfinite(wanted).ravel())
    if common.size < MIN_COMMON:
        return None
    common = common[:: max(1, common.size // SAMPLE)]
    x = measured.ravel()[common].astype(np.float64)
    y = wanted.ravel()[common].astype(np.float64)
    low, high = np.percentile(x, (2, 98))
    if not high - low > MIN_SPREAD * np.abs(x).max():
        return Scale(offset=float(np.median(y - x)))
    rng = np.random.default_rng(0)
    far = rng.choice(np.flatnonzero(x <= low + 0.4 * (high - low)), SAMPLE)
    near = rng.choice(np.flatnonzero(x >= high - 0.4 * (high - low)), SAMPLE)
    factor = float(np.median((y[near] - y[far]) / (x[near] - x[far])))
    if not factor > 0:
        return None
    return Scale(factor=factor, offset=float(np.median(y - factor * x)))


Pairs = dict[tuple[int, int], PairMatch]
"""(left, right) places to what matching found."""


def _on_one_scale(views: Sequence[View], pairs: Pairs) -> Pairs:
    """Return the pairs in the units of the given depth, or else of one of the pairs.

    Units spread from pair to pair: first from views whose depth is given, then from what has
    been settled. Where a link fails, a pair keeps its own units.
    """
    settled: Pairs = {}
    anchors = {
        index: view.depth_map for index, view in enumerate(views) if view.depth_map is not None
    }
    while len(settled) < len(pairs):
        open_pairs = sorted(set(pairs) - set(settled))
        link = next(filter(None, (_link(pair, pairs, anchors) for pair in open_pairs)), None)
        pair, scale = link if link is not None else (open_pairs[0], Scale())
        settled[pair] = scale.applied(pairs[pair])
        anchors.setdefault(pair[0], settled[pair].left)
        anchors.setdefault(pair[1], settled[pair].right)
    return settled


def _link(
    pair: tuple[int, int], pairs: Pairs, anchors: dict[int, DepthMap]
) -> tuple[tuple[int, int], Scale] | None:
    """Return the pair with its change of units, or None where no anchor settles it."""
    for view, measured in zip(pair, (pairs[pair].left, pairs[pair].right), strict=True):
        if view in anchors:
            scale = fitted_scale(measured, anchors[view])
            if scale is not None:
                return pair, scale
    return None
