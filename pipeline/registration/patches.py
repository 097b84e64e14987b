"""Cutting a depth map into layers and patches (thesis §2.2, Eq. 1, Figure 2).

Two ways: the thesis' L depth layers × R strips side by side, and ours, small
overlapping windows in both directions, each cut where its depth jumps.
Nearness (proportional to inverse depth) stands for depth throughout.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import INLINED

MAX_PARTS = 3
"""Most surfaces that one window is cut into."""

HISTOGRAM_BINS = 64
"""Of the nearness in one part of a window."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """Windows of the image, each with the range of nearness that belongs to it."""

    windows: npt.NDArray[np.int32]
    """(P, 4): x0, y0, x1, y1, half-open, source pixels."""

    ranges: npt.NDArray[np.float32]
    """(P, 2): a pixel of the window belongs where lo ≤ nearness < hi."""

    planes: npt.NDArray[np.float64]
    """(P, 3): nearness ≈ p0 + p1·X + p2·Y with X, Y in −1…1 about the window's centre."""

    support: npt.NDArray[np.int32]
    """(P,): pixels that belong."""

    def some(self, chosen: npt.NDArray[np.bool_]) -> Patches:
        """Return those chosen, (P,)."""
        return Patches(
            windows=self.windows[chosen], ranges=self.ranges[chosen], planes=self.planes[chosen],
            support=self.support[chosen],
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows(Patches):
    """Patches of overlapping windows, each with a cell in its middle that no other covers."""

    owners: npt.NDArray[np.int32]
    """(H, W): the patch of each pixel, among those of the cell in which it lies."""

    cells: npt.NDArray[np.int32]
    """(P, 4): x0, y0, x1, y1 of each patch's cell, half-open, source pixels."""

    cell: npt.NDArray[np.int32]
    """(P,): number of the cell, row by row; patches are in its order."""

    grid: tuple[int, int]
    """Rows and columns of cells."""

    @property
    def first(self) -> npt.NDArray[np.int32]:
        """(rows · columns + 1,): the first patch of each cell, and the end of the last one's."""
        numbers = np.arange(self.grid[0] * self.grid[1] + 1)
        return np.searchsorted(self.cell, numbers).astype(np.int32)


@njit(**INLINED)
def _plane(values, px, py, count, out):
    """Write a plane through the first ``count`` values; return their spread about the best one."""
    sx = sy = sxx = sxy = syy = sd = sxd = syd = sdd = 0.0
    for k in range(count):
        x, y, d = px[k], py[k], values[k]
        sx += x
        sy += y
        sxx += x * x
        sxy += x * y
        syy += y * y
        sd += d
        sxd += x * d
        syd += y * d
        sdd += d * d
    return _plane_of(float(count), (sx, sy, sxx, sxy, syy), (sd, sxd, syd, sdd), out)


@njit(**INLINED)
def _plane_of_all(values, px, py, columns, rows, out):
    """Do the same for all values of a window, given the places of its columns and rows."""
    sx = sy = sxx = syy = sd = sxd = syd = sdd = 0.0
    for j in range(columns):
        sx += px[j]
        sxx += px[j] * px[j]
    for i in range(rows):
        y = py[i]
        sy += y
        syy += y * y
        row = xd = dd = 0.0
        for j in range(columns):
            d = values[i * columns + j]
            row += d
            xd += px[j] * d
            dd += d * d
        sd += row
        sxd += xd
        syd += y * row
        sdd += dd
    sums = rows * sx, columns * sy, rows * sxx, sx * sy, columns * syy
    return _plane_of(float(rows * columns), sums, (sd, sxd, syd, sdd), out)


@njit(**INLINED)
def _plane_of(n, places, values, out):
    """Write the plane that sums over n values tell; return their spread about the best one.

    The ridge keeps the slope of a narrow part small; the spread (a standard deviation) knows
    nothing of it, or steep planes would seem to be none.

    Parameters
    ----------
    places, values : tuple of float
        Sums of x, y, x², xy, y², and of d, xd, yd, d².
    """
    sx, sy, sxx, sxy, syy = places
    sd, sxd, syd, sdd = values
    mx, my, md = sx / n, sy / n, sd / n
    ridge = 0.02
    cxx = sxx / n - mx * mx
    cxy = sxy / n - mx * my
    cyy = syy / n - my * my
    cxd = sxd / n - mx * md
    cyd = syd / n - my * md
    determinant = (cxx + ridge) * (cyy + ridge) - cxy * cxy
    a = (cxd * (cyy + ridge) - cyd * cxy) / determinant
    b = (cyd * (cxx + ridge) - cxd * cxy) / determinant
    out[0] = md - a * mx - b * my
    out[1] = a
    out[2] = b
    plain = cxx * cyy - cxy * cxy
    if plain > 1e-6:
        explained = (cxd * cxd * cyy - 2 * cxd * cyd * cxy + cyd * cyd * cxx) / plain
    else:  # all in one line
        explained = a * cxd + b * cyd
    variance = sdd / n - md * md - explained
    return np.sqrt(max(variance, 0.0))


@njit(nogil=True, cache=True, error_model="numpy")
def _otsu(values, count, min_support, counts):
    """Return where Otsu's threshold cuts the first ``count`` values; NaN where it leaves too few.

    Parameters
    ----------
    min_support : int
        Fewest values on either side.
    counts : (HISTOGRAM_BINS,) int64
        Scratch.
    """
    lo = values[0]
    hi = values[0]
    for i in range(count):
        lo = min(lo, values[i])
        hi = max(hi, values[i])
    counts[:] = 0
    step = (hi - lo) / HISTOGRAM_BINS + 1e-30
    for i in range(count):
        counts[min(int((values[i] - lo) / step), HISTOGRAM_BINS - 1)] += 1
    total = 0.0
    for b in range(HISTOGRAM_BINS):
        total += b * counts[b]
    below = 0
    sum_below = 0.0
    best = -1.0
    first = 0
    last = 0
    for b in range(HISTOGRAM_BINS - 1):
        below += counts[b]
        sum_below += b * counts[b]
        above = count - below
        if below < min_support or above < min_support:
            continue
        gap = sum_below / below - (total - sum_below) / above
        between = float(below) * float(above) * gap * gap
        if between > best * (1 + 1e-9):
            best = between
            first = b
            last = b
        elif between >= best * (1 - 1e-9):
            last = b
    if best > 0:
        return lo + step * (0.5 * (first + last) + 1)
    return np.nan


@njit(nogil=True, cache=True, error_model="numpy")
def _cut_windows(
    nearness, spacing, half, tolerance, min_support, wanted, windows, ranges, planes, support,
    owners, cells, cell,
):  # fmt: skip
    """Fill the patch tables; return how many patches there are."""
    height, width = nearness.shape
    area = (2 * half + spacing) ** 2
    values = np.empty(area)
    px = np.empty(2 * half + spacing)
    py = np.empty(2 * half + spacing)
    part_values = np.empty(area)
    part_x = np.empty(area)
    part_y = np.empty(area)
    lows = np.empty(MAX_PARTS)
    highs = np.empty(MAX_PARTS)
    counts = np.empty(HISTOGRAM_BINS, np.int64)
    number = 0
    for gy in range((height + spacing - 1) // spacing):
        for gx in range((width + spacing - 1) // spacing):
            if not wanted[gy, gx]:
                continue
            cx = gx * spacing + spacing // 2
            cy = gy * spacing + spacing // 2
            x0, x1 = max(0, cx - half), min(width, cx + half)
            y0, y1 = max(0, cy - half), min(height, cy + half)
            xc = 0.5 * (x0 + x1 - 1)
            yc = 0.5 * (y0 + y1 - 1)
            s = max(0.5 * max(x1 - x0, y1 - y0), 1.0)
            columns, rows = np.int64(x1 - x0), np.int64(y1 - y0)
            count = columns * rows
            for j in range(columns):
                px[j] = (x0 + j - xc) / s
            for i in range(rows):
                py[i] = (y0 + i - yc) / s
                line = np.uint64(y0 + i)
                for j in range(columns):
                    values[i * columns + j] = nearness[line, np.uint64(x0 + j)]
            parts = 1
            lows[0] = -np.inf
            highs[0] = np.inf
            k = 0
            while k < parts:
                n = np.int64(0)  # typed, or what it is handed to is compiled for a literal too
                if parts == 1:
                    n = count
                    spread = _plane_of_all(values, px, py, columns, rows, planes[number])
                else:
                    for i in range(count):
                        if values[i] >= lows[k] and values[i] < highs[k]:
                            part_values[n] = values[i]
                            part_x[n] = px[i % columns]
                            part_y[n] = py[i // columns]
                            n += 1
                    spread = 0.0
                    if n > 0:
                        spread = _plane(part_values, part_x, part_y, n, planes[number])
                if parts < MAX_PARTS and n >= 2 * min_support and spread > tolerance:
                    cut = _otsu(values if parts == 1 else part_values, n, min_support, counts)
                    if not np.isnan(cut):
                        for j in range(parts, k + 1, -1):
                            lows[j] = lows[j - 1]
                            highs[j] = highs[j - 1]
                        lows[k + 1] = cut
                        highs[k + 1] = highs[k]
                        highs[k] = cut
                        parts += 1
                        continue
                windows[number, 0] = x0
                windows[number, 1] = y0
                windows[number, 2] = x1
                windows[number, 3] = y1
                ranges[number, 0] = lows[k]
                ranges[number, 1] = highs[k]
                support[number] = n
                cells[number, 0] = gx * spacing
                cells[number, 1] = gy * spacing
                cells[number, 2] = min((gx + 1) * spacing, width)
                cells[number, 3] = min((gy + 1) * spacing, height)
                cell[number] = gy * ((width + spacing - 1) // spacing) + gx
                number += 1
                k += 1
            for y in range(gy * spacing, min((gy + 1) * spacing, height)):
                for x in range(gx * spacing, min((gx + 1) * spacing, width)):
                    part = 0
                    while part + 1 < parts and nearness[y, x] >= highs[part]:
                        part += 1
                    owners[y, x] = number - parts + part
    return number


def cut_windows(
    nearness: npt.NDArray[np.float32],
    *,
    spacing: int,
    half: int,
    tolerance: float,
    min_support: int,
    wanted: npt.NDArray[np.bool_] | None = None,
) -> Windows:
    """Return overlapping windows, each cut into parts where its depth is no plane.

    Not in the thesis ("more general splits are ours to add").

    Parameters
    ----------
    nearness : (H, W) float32
        Without NaN.
    spacing, half : int
        Distance of the windows' centres and half their side, pixels; windows overlap, so that
        the cell of ``spacing`` pixels around a centre lies in its window.
    tolerance : float
        Standard deviation about a plane above which a window is cut, units of nearness.
    min_support : int
        Fewest pixels of a part.
    wanted : (rows, columns) bool, optional
        Cells whose windows are cut; the pixels of the others have no owner.
    """
    height, width = nearness.shape
    grid = (-(-height // spacing), -(-width // spacing))
    if wanted is None:
        wanted = np.ones(grid, bool)
    most = MAX_PARTS * grid[0] * grid[1]
    windows = np.empty((most, 4), np.int32)
    ranges = np.empty((most, 2), np.float32)
    planes = np.zeros((most, 3))
    support = np.empty(most, np.int32)
    owners = np.full((height, width), -1, np.int32)
    cells = np.empty((most, 4), np.int32)
    cell = np.empty(most, np.int32)
    n = _cut_windows(
        nearness, spacing, half, tolerance, min_support, wanted, windows, ranges, planes, support,
        owners, cells, cell,
    )  # fmt: skip
    return Windows(
        windows=windows[:n].copy(),
        ranges=ranges[:n].copy(),
        planes=planes[:n].copy(),
        support=support[:n].copy(),
        owners=owners,
        cells=cells[:n].copy(),
        cell=cell[:n].copy(),
        grid=grid,
    )


def fill_unknown(depth_map: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the depth map with unknown pixels (NaN) filled from the same row, the farther side.

    What a stereo matcher leaves unknown is mostly background seen by one camera
    only. Rows without any known pixel take the nearest row; a map without any
    known pixel becomes zero everywhere.
    """
    known = np.isfinite(depth_map)
    if known.all():
        return np.array(depth_map, np.float32, order="C")  # a writable one, for one compilation
    if not known.any():
        return np.zeros(depth_map.shape, np.float32)
    filled = np.array(depth_map, np.float32, order="C")
    row_known = known.any(axis=1)
    _fill_rows(filled)
    if not row_known.all():
        good = np.flatnonzero(row_known)
        rows = np.arange(len(filled))
        filled = filled[good[np.argmin(np.abs(rows[:, None] - good[None, :]), axis=1)]]
    return filled


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_rows(depth_map):
    """Fill every gap of every row with the smaller of the values at its two ends, in place."""
    height, width = depth_map.shape
    for row in range(height):
        left = np.float32(np.inf)
        column = 0
        while column < width:
            if np.isfinite(depth_map[row, column]):
                left = depth_map[row, column]
                column += 1
                continue
            end = column
            while end < width and not np.isfinite(depth_map[row, end]):
                end += 1
            right = depth_map[row, end] if end < width else np.float32(np.inf)
            for place in range(column, end):
                depth_map[row, place] = min(left, right)
            column = end


def layer_strips(
    nearness: npt.NDArray[np.float32], thresholds: npt.NDArray[np.float64], num_subregions: int
) -> Patches:
    """Return the thesis' patches: each layer cut into strips side by side along x (Figure 2).

    Parameters
    ----------
    nearness : (H, W) float32
        Without NaN.
    thresholds : (L + 1,) float64
        From :func:`pipeline.registration.layers.layer_thresholds`.
    num_subregions : int
        R; each strip is W / R columns wide.

    Returns
    -------
    Patches
        L · R patches, layer after layer, strip after strip (empty ones included, with
        no support), so that patch l·R + r is strip r of layer l.
    """
    height, width = nearness.shape
    edges = np.linspace(0, width, num_subregions + 1).round().astype(int)
    num_layers = len(thresholds) - 1
    windows, ranges, planes, support = [], [], [], []
    for layer in range(num_layers):
        lo, hi = thresholds[layer], thresholds[layer + 1]
        for x0, x1 in pairwise(edges):
            block = nearness[:, x0:x1]
            inside = (block >= lo) & (block < hi)
            count = int(inside.sum())
            windows.append((x0, 0, x1, height))
            ranges.append((lo, hi))
            planes.append((float(block[inside].mean()) if count else 0.0, 0.0, 0.0))
            support.append(count)
    return Patches(
        windows=np.array(windows, np.int32).reshape(-1, 4),
        ranges=np.array(ranges, np.float32).reshape(-1, 2),
        planes=np.array(planes, float).reshape(-1, 3),
        support=np.array(support, np.int32),
    )
