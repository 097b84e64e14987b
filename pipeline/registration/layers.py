"""Depth layers (thesis §2.2, Eq. 1): thresholds on the depth map, one layer for every pixel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

HISTOGRAM_BINS = 256


def layer_thresholds(
    nearness: npt.NDArray[np.float32], num_layers: int, *, min_support: int = 1
) -> npt.NDArray[np.float64]:
    """Return the thresholds that cut a depth map into layers.

    Thesis §2.2: thresholds "are set considering abrupt depth changes at the object
    boundaries and the number of required pixels for stable registration". Starting
    from layers of equal count, each threshold moves to the emptiest place of the
    (smoothed) histogram between its neighbours' middles; layers that would have too
    few pixels are merged.

    Parameters
    ----------
    nearness : (H, W) float32
        Nearness without NaN, any unit.
    num_layers : int
        L, the most layers; fewer come out where the map has fewer values.
    min_support : int
        Fewest pixels of a layer.

    Returns
    -------
    (layers + 1,) float64
        Increasing; first −∞, last ∞. Layer l holds T_l ≤ nearness < T_{l+1}
        (*Deviation*: Eq. 1 closes both ends, which puts a pixel into two layers).
    """
    values = np.sort(nearness, axis=None)
    low, high = float(values[0]), float(values[-1])
    if num_layers <= 1 or not high > low:
        return np.array([-np.inf, np.inf])
    counts, edges = np.histogram(values, bins=HISTOGRAM_BINS, range=(low, high))
    smooth = np.convolve(counts, [0.25, 0.5, 0.25], mode="same")
    quantiles = np.interp(
        np.arange(1, num_layers) / num_layers * values.size,
        np.concatenate([[0], np.cumsum(counts)]),
        np.arange(HISTOGRAM_BINS + 1),
    )
    bounds = np.concatenate([[0.0], quantiles, [HISTOGRAM_BINS]])
    thresholds = []
    for index in range(1, num_layers):
        first = int(np.ceil(0.5 * (bounds[index - 1] + bounds[index])))
        last = int(np.floor(0.5 * (bounds[index] + bounds[index + 1])))
        places = np.arange(max(first, 1), min(last, HISTOGRAM_BINS - 1) + 1)
        if places.size:
            thresholds.append(edges[places[_emptiest(smooth[places - 1] + smooth[places])]])
    kept = [-np.inf]
    for threshold in sorted(set(thresholds)):
        below = np.searchsorted(values, threshold) - np.searchsorted(values, kept[-1])
        above = values.size - np.searchsorted(values, threshold)
        if below >= min_support and above >= min_support:
            kept.append(threshold)
    return np.array([*kept, np.inf])


def _emptiest(counts: npt.NDArray[np.float64]) -> int:
    """Return the middle of the longest run of smallest counts: the widest gap, not its rim."""
    smallest = np.concatenate([[False], counts == counts.min(), [False]])
    begins, ends = np.flatnonzero(np.diff(smallest.astype(np.int8))).reshape(-1, 2).T
    longest = int(np.argmax(ends - begins))
    return int(begins[longest] + ends[longest]) // 2


def layer_labels(
    nearness: npt.NDArray[np.float32], thresholds: npt.NDArray[np.float64]
) -> npt.NDArray[np.int32]:
    """Return the layer number of every pixel, 0 the farthest — Eq. (1) with half-open intervals."""
    inner = thresholds[1:-1]
    return np.searchsorted(inner, nearness, side="right").astype(np.int32)
