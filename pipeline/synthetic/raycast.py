"""Ray casting against rectangles, spheres and cylinders: compiled, one view at a time.

Rays are not normalised: the camera's z component of a direction is one, so
that the ray parameter of a hit *is* its depth. Knows nothing of the scene's
content, of files or of low resolution.

A scene is a (M, 18) float64 array with one row an object; the columns are
named by the constants below. Every object has a frame of its own with its
axes as rows of the rotation:

* rectangle: axes 0 and 1 span it, axis 2 is its normal;
* sphere and cylinder: axis 1 is the polar axis, the texture's middle sits at minus axis 2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

RECTANGLE, SPHERE, CYLINDER = 0, 1, 2

KIND, ROTATION, CENTRE, SIZE, REACH, GLOW = 0, 1, 10, 13, 16, 17
"""Columns: kind, rotation (9), centre (3), size (3: half width, half height, corner radius;
radius; radius, half height), radius of the enclosing sphere, share of its light that
does not depend on the lamp."""

NUM_COLUMNS = 18

NOTHING: Any = np.int64(-1)
"""Number of no object; typed, so that nothing is compiled twice for a literal."""

NEVER = np.bool_(False)
"""The same for a condition."""

NEAREST = 1e-9
FARTHEST = 1e30

_FAST = {"nogil": True, "cache": True, "fastmath": True, "error_model": "numpy"}
_EXACT = {"nogil": True, "cache": True, "error_model": "numpy"}
"""Functions that are called for every ray take scalars only: an array handed to a function costs
two atomic operations of its reference count, more than the intersection itself."""


@njit(**_FAST)
def hit(kind, width, height, corner, px, py, pz, lx, ly, lz):
    """Return the depth at which a ray meets an object, FARTHEST where it does not.

    Origin ``(px, py, pz)`` and direction ``(lx, ly, lz)`` are in the object's
    frame; width, height and corner are the three columns at ``SIZE``.
    """
    if kind == RECTANGLE:
        if lz == 0.0:
            return FARTHEST
        t = -pz / lz
        if not t > NEAREST:
            return FARTHEST
        across = abs(px + t * lx)
        along = abs(py + t * ly)
        if across > width or along > height:
            return FARTHEST
        over_x, over_y = across - (width - corner), along - (height - corner)
        if over_x > 0.0 and over_y > 0.0 and over_x * over_x + over_y * over_y > corner * corner:
            return FARTHEST
        return t
    a = lx * lx + lz * lz
    b = lx * px + lz * pz
    c = px * px + pz * pz - width * width
    if kind == SPHERE:
        a, b, c = a + ly * ly, b + ly * py, c + py * py
    under_root = b * b - a * c
    if under_root <= 0.0 or a == 0.0:
        return FARTHEST
    root = np.sqrt(under_root)
    t = (-b - root) / a
    if kind == SPHERE:
        return t if t > NEAREST else FARTHEST
    if t > NEAREST and abs(py + t * ly) <= height:
        return t
    t = (-b + root) / a  # the inner wall, seen through the open end
    if t > NEAREST and abs(py + t * ly) <= height:
        return t
    return FARTHEST


@njit(**_FAST)
def trace(objects, origins, axes, boxes, offset, step, wanted, depth, found):
    """Fill depth and object number at every wanted pixel centre, in place; −1 where nothing is.

    Parameters
    ----------
    origins : (M, 3) float64
        The camera centre in the frame of every object.
    axes : (M, 3, 3) float64
        From homogeneous pixels of ``boxes``' grid to directions of unit camera z, in
        the frame of every object.
    boxes : (M, 4) float64
        Where on the image an object may be seen: x0, y0, x1, y1, with a pixel to spare.
    offset, step : (2,) float64
        Pixel (i, j) of the output sits at ``offset + step·(i, j)`` of that grid.
    wanted : (H, W) uint8
        Pixels to fill, 0: leave.
    depth : (H, W) float64
    found : (H, W) int16
    """
    for j in range(depth.shape[0]):
        y = offset[1] + step[1] * j
        for i in range(depth.shape[1]):
            if wanted[j, i] == 0:
                continue
            x = offset[0] + step[0] * i
            nearest, number = FARTHEST, NOTHING
            for n in range(objects.shape[0]):
                if x < boxes[n, 0] or y < boxes[n, 1] or x > boxes[n, 2] or y > boxes[n, 3]:
                    continue
                t = hit(
                    objects[n, KIND], objects[n, SIZE], objects[n, SIZE + 1], objects[n, SIZE + 2],
                    origins[n, 0], origins[n, 1], origins[n, 2],
                    axes[n, 0, 0] * x + axes[n, 0, 1] * y + axes[n, 0, 2],
                    axes[n, 1, 0] * x + axes[n, 1, 1] * y + axes[n, 1, 2],
                    axes[n, 2, 0] * x + axes[n, 2, 1] * y + axes[n, 2, 2],
                )  # fmt: skip
                if t < nearest:
                    nearest, number = t, n
            found[j, i] = number
            depth[j, i] = nearest


@njit(**_EXACT)
def unblocked(objects, origins, axes, boxes, centre, points, pixels, tolerance, out):
    """Fill True where nothing stands between a camera centre and a world point, in place.

    ``axes`` (M, 3, 3) are the objects' own; ``points`` (P, 3) world, ``pixels``
    (P, 2) their projections on the boxes' grid, ``out`` (P,) bool. The ray's
    parameter is 1 at the point.
    """
    for p in range(points.shape[0]):
        out[p] = np.isfinite(points[p, 0])
        if not out[p]:
            continue
        x, y = pixels[p, 0], pixels[p, 1]
        dx, dy = points[p, 0] - centre[0], points[p, 1] - centre[1]
        dz = points[p, 2] - centre[2]
        for n in range(objects.shape[0]):
            if x < boxes[n, 0] or y < boxes[n, 1] or x > boxes[n, 2] or y > boxes[n, 3]:
                continue
            t = hit(
                objects[n, KIND], objects[n, SIZE], objects[n, SIZE + 1], objects[n, SIZE + 2],
                origins[n, 0], origins[n, 1], origins[n, 2],
                axes[n, 0, 0] * dx + axes[n, 0, 1] * dy + axes[n, 0, 2] * dz,
                axes[n, 1, 0] * dx + axes[n, 1, 1] * dy + axes[n, 1, 2] * dz,
                axes[n, 2, 0] * dx + axes[n, 2, 1] * dy + axes[n, 2, 2] * dz,
            )  # fmt: skip
            if t < 1.0 - tolerance:
                out[p] = False
                break


@njit(**_FAST)
def _texture_point(kind, width, height, px, py, pz):
    """Return where on its texture a point of an object's frame is: u and v in 0..1."""
    if kind == RECTANGLE:
        return 0.5 + 0.5 * px / width, 0.5 + 0.5 * py / height
    u = 0.5 + np.arctan2(px, -pz) / (2 * np.pi)
    if kind == SPHERE:
        return u, 0.5 + np.arcsin(min(max(py / width, -1.0), 1.0)) / np.pi
    return u, 0.5 + 0.5 * py / height


@njit(**_FAST)
def _neighbours(place, count, wraps):
    """Return the two texels beside a place along one axis, and the share of the second."""
    first = int(np.floor(place))
    share = np.float32(place - first)
    second = first + 1
    if wraps:
        first = first + count if first < 0 else first
        second = second - count if second >= count else second
        return first, second, share
    return min(max(first, 0), count - 1), min(max(second, 0), count - 1), share


@njit(**_FAST)
def _clearance(kind, width, height, corner, cx, cy, cz, px, py, pz, along):
    """Return (distance by which a ray passes an object, how far along the ray); negative inside.

    Centre of the object ``(cx, cy, cz)`` as seen from the ray's start, unit
    direction of the ray ``(px, py, pz)``: both in the object's frame; ``along`` is
    their product.
    """
    if kind == RECTANGLE:
        at = cz / pz if pz != 0.0 else -1.0
        beside_x = abs(at * px - cx) - width + corner
        beside_y = abs(at * py - cy) - height + corner
        outside = np.sqrt(max(beside_x, 0.0) ** 2 + max(beside_y, 0.0) ** 2)
        return outside + min(max(beside_x, beside_y), 0.0) - corner, at
    best = 0.0
    if kind == CYLINDER:
        best = (py * along - cy) / max(1.0 - py * py, 1e-9)
        best = min(max(best, -height), height)
    at = along + py * best
    ax, ay, az = at * px - cx, at * py - cy - best, at * pz - cz
    return np.sqrt(ax * ax + ay * ay + az * az) - width, at


@njit(**_FAST)
def _light(objects, blockers, number, px, py, pz, lx, ly, lz, lamp_x, lamp_y, lamp_z, softness):
    """Return how bright a surface is by ambient and by direct light.

    Point and ray direction are in the object's frame, the lamp is in the world.
    """
    r00, r01, r02 = objects[number, 1], objects[number, 2], objects[number, 3]
    r10, r11, r12 = objects[number, 4], objects[number, 5], objects[number, 6]
    r20, r21, r22 = objects[number, 7], objects[number, 8], objects[number, 9]
    kind, radius = objects[number, KIND], objects[number, SIZE]
    nx, ny, nz = 0.0, 0.0, 1.0
    if kind != RECTANGLE:
        nx, ny, nz = px / radius, py / radius if kind == SPHERE else 0.0, pz / radius
    if nx * lx + ny * ly + nz * lz > 0.0:
        nx, ny, nz = -nx, -ny, -nz
    x = r00 * px + r10 * py + r20 * pz + objects[number, CENTRE]
    y = r01 * px + r11 * py + r21 * pz + objects[number, CENTRE + 1]
    z = r02 * px + r12 * py + r22 * pz + objects[number, CENTRE + 2]
    up, back = r01 * nx + r11 * ny + r21 * nz, r02 * nx + r12 * ny + r22 * nz
    sx, sy, sz = lamp_x - x, lamp_y - y, lamp_z - z
    reach = np.sqrt(sx * sx + sy * sy + sz * sz)
    sx, sy, sz = sx / reach, sy / reach, sz / reach
    direct = (r00 * nx + r10 * ny + r20 * nz) * sx + up * sy + back * sz
    direct = max(direct, 0.0) / (1.0 + 0.022 * reach * reach)
    for k in range(blockers.shape[1]):
        n = blockers[number, k]
        if n < 0 or direct == 0.0:
            break
        cx, cy, cz = objects[n, CENTRE] - x, objects[n, CENTRE + 1] - y, objects[n, CENTRE + 2] - z
        along = cx * sx + cy * sy + cz * sz
        margin = objects[n, REACH] + 0.01 + softness * max(along, 0.0)
        apart = cx * cx + cy * cy + cz * cz - along * along
        if apart > margin * margin or along < -margin or along > reach:
            continue
        a, b, c = objects[n, 1], objects[n, 2], objects[n, 3]
        d, e, f = objects[n, 4], objects[n, 5], objects[n, 6]
        g, h, i = objects[n, 7], objects[n, 8], objects[n, 9]
        distance, at = _clearance(
            objects[n, KIND], objects[n, SIZE], objects[n, SIZE + 1], objects[n, SIZE + 2],
            a * cx + b * cy + c * cz, d * cx + e * cy + f * cz, g * cx + h * cy + i * cz,
            a * sx + b * sy + c * sz, d * sx + e * sy + f * sz, g * sx + h * sy + i * sz, along,
        )  # fmt: skip
        half = 0.01 + softness * max(at, 0.0)
        if at > 0.0 and distance < half:
            step = max((distance + half) / (2 * half), 0.0)
            direct *= step * step * (3 - 2 * step)
    glow = objects[number, GLOW]
    return (1 - glow) * (0.81 - 0.133 * up - 0.057 * back), (1 - glow) * direct


@njit(**_FAST)
def paint(objects, origins, axes, boxes, blockers, lamp, textures, layout, wanted, middle, out):
    """Fill the wanted HR pixels of an image that is twice as fine, in place.

    Parameters
    ----------
    origins, axes, boxes : arrays
        As for :func:`trace`, on the HR grid with its margin.
    blockers : (M, M) int16
        In each object's row, the objects that may stand between it and the lamp, then −1.
    lamp : (11,) float64
        Position, strength, softness of shadows, ambient colour, direct colour.
    textures, layout : (T,) uint8 and (M, 3) int64
        All texels, and for each object where its texture starts, its height and width.
    wanted : (H, W) uint8
        HR pixels to fill, 0: leave.
    middle : (H, W) int16
        The object at the centre of every wanted pixel and its neighbours, from :func:`trace`.
    out : (2H, 2W, 3) float32
        Modified in place. Sample (2j + b, 2i + a) sits at HR pixel (i, j) ∓ ¼.

    Notes
    -----
    A pixel whose neighbours show the same object is taken to show nothing
    else: four rays. Elsewhere each of the four samples is the mean of four
    rays. Light varies slowly within a surface, so it is taken once an HR pixel
    and surface.
    """
    near = np.empty(boxes.shape[0], np.int64)
    lit = np.empty((boxes.shape[0], 3), np.float32)
    lit_at = np.full(boxes.shape[0], -1, np.int64)
    height, width = wanted.shape
    for j in range(height):
        for i in range(width):
            if wanted[j, i] == 0:
                continue
            own = middle[j, i]
            inner = 0 < i < width - 1 and 0 < j < height - 1 and own >= 0
            if inner:
                for b in range(-1, 2):
                    for a in range(-1, 2):
                        inner = inner and middle[j + b, i + a] == own
            doubled = 0 if inner else 1
            weight = np.float32(1.0 if inner else 0.25)
            pitch = 0.5 if inner else 0.25
            count = 0
            if inner:
                near[0], count = own, 1
            else:
                for n in range(boxes.shape[0]):
                    if (
                        i >= boxes[n, 0] and j >= boxes[n, 1]
                        and i <= boxes[n, 2] and j <= boxes[n, 3]
                    ):  # fmt: skip
                        near[count] = n
                        count += 1
            for b in range(2):
                for a in range(2):
                    out[2 * j + b, 2 * i + a, 0] = 0.0
                    out[2 * j + b, 2 * i + a, 1] = 0.0
                    out[2 * j + b, 2 * i + a, 2] = 0.0
            for part in range(4 if inner else 16):
                row = part >> (1 + doubled)
                column = part - (row << (1 + doubled))
                x, y = i - 0.5 + pitch * (column + 0.5), j - 0.5 + pitch * (row + 0.5)
                nearest, number = FARTHEST, NOTHING
                for k in range(count):
                    n = near[k]
                    t = hit(
                        objects[n, KIND],
                        objects[n, SIZE], objects[n, SIZE + 1], objects[n, SIZE + 2],
                        origins[n, 0], origins[n, 1], origins[n, 2],
                        axes[n, 0, 0] * x + axes[n, 0, 1] * y + axes[n, 0, 2],
                        axes[n, 1, 0] * x + axes[n, 1, 1] * y + axes[n, 1, 2],
                        axes[n, 2, 0] * x + axes[n, 2, 1] * y + axes[n, 2, 2],
                    )  # fmt: skip
                    if t < nearest:
                        nearest, number = t, n
                if number < 0:
                    continue
                n = number
                lx = axes[n, 0, 0] * x + axes[n, 0, 1] * y + axes[n, 0, 2]
                ly = axes[n, 1, 0] * x + axes[n, 1, 1] * y + axes[n, 1, 2]
                lz = axes[n, 2, 0] * x + axes[n, 2, 1] * y + axes[n, 2, 2]
                px = origins[n, 0] + nearest * lx
                py = origins[n, 1] + nearest * ly
                pz = origins[n, 2] + nearest * lz
                if lit_at[n] != j * width + i:
                    lit_at[n] = j * width + i
                    ambient, direct = _light(
                        objects, blockers, n, px, py, pz, lx, ly, lz,
                        lamp[0], lamp[1], lamp[2], lamp[4],
                    )  # fmt: skip
                    for channel in range(3):
                        lit[n, channel] = (
                            objects[n, GLOW]
                            + ambient * lamp[5 + channel]
                            + direct * lamp[3] * lamp[8 + channel]
                        )
                kind = objects[n, KIND]
                u, v = _texture_point(kind, objects[n, SIZE], objects[n, SIZE + 1], px, py, pz)
                start, rows, columns = layout[n, 0], layout[n, 1], layout[n, 2]
                x0, x1, f = _neighbours(u * columns - 0.5, columns, kind != RECTANGLE)
                y0, y1, g = _neighbours(v * rows - 0.5, rows, NEVER)
                w11 = f * g
                w10, w01 = f - w11, g - w11
                w00 = np.float32(1.0) - f - w01
                p00, p10 = start + 3 * (columns * y0 + x0), start + 3 * (columns * y0 + x1)
                p01, p11 = start + 3 * (columns * y1 + x0), start + 3 * (columns * y1 + x1)
                at_y, at_x = 2 * j + (row >> doubled), 2 * i + (column >> doubled)
                for channel in range(3):
                    texel = (
                        w00 * np.float32(textures[p00 + channel])
                        + w10 * np.float32(textures[p10 + channel])
                        + w01 * np.float32(textures[p01 + channel])
                        + w11 * np.float32(textures[p11 + channel])
                    )
                    out[at_y, at_x, channel] += weight * lit[n, channel] * texel


@njit(**_FAST)
def gather(fine, wanted, taps, out):
    """Filter the fine samples onto the wanted HR pixels and round them to 8 bit, in place.

    ``fine`` has a margin of two HR pixels on every side; ``taps`` (8,) are the
    filter at −7/4, −5/4 … 7/4 HR pixels; ``out`` (H, W, 3) uint8.
    """
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            if wanted[j, i] == 0:
                continue
            red = green = blue = np.float32(0.0)
            for b in range(8):
                line_red = line_green = line_blue = np.float32(0.0)
                for a in range(8):
                    line_red += taps[a] * fine[2 * j + 1 + b, 2 * i + 1 + a, 0]
                    line_green += taps[a] * fine[2 * j + 1 + b, 2 * i + 1 + a, 1]
                    line_blue += taps[a] * fine[2 * j + 1 + b, 2 * i + 1 + a, 2]
                red += taps[b] * line_red
                green += taps[b] * line_green
                blue += taps[b] * line_blue
            out[j, i, 0] = np.uint8(
                max(np.float32(0.0), min(red + np.float32(0.5), np.float32(255.0)))
            )
            out[j, i, 1] = np.uint8(
                max(np.float32(0.0), min(green + np.float32(0.5), np.float32(255.0)))
            )
            out[j, i, 2] = np.uint8(
                max(np.float32(0.0), min(blue + np.float32(0.5), np.float32(255.0)))
            )


def compile_ahead() -> None:
    """Compile what is not compiled yet, so that it can be done beside other work."""
    none, origins, axes, boxes = (
        np.zeros((0, NUM_COLUMNS)),
        np.zeros((0, 3)),
        np.zeros((0, 3, 3)),
        np.zeros((0, 4)),
    )
    pixel, number = np.ones((1, 1), np.uint8), np.zeros((1, 1), np.int16)
    trace(none, origins, axes, boxes, np.zeros(2), np.ones(2), pixel, np.zeros((1, 1)), number)
    unblocked(
        none, origins, axes, boxes, np.zeros(3), np.zeros((1, 3)), np.zeros((1, 2)), 0.0,
        np.zeros(1, np.bool_),
    )  # fmt: skip
    paint(
        none, origins, axes, boxes, np.zeros((0, 0), np.int16), np.zeros(11),
        np.zeros(0, np.uint8), np.zeros((0, 3), np.int64), pixel, number,
        np.zeros((2, 2, 3), np.float32),
    )  # fmt: skip
    gather(
        np.zeros((10, 10, 3), np.float32), pixel, np.zeros(8, np.float32),
        np.zeros((1, 1, 3), np.uint8),
    )  # fmt: skip
