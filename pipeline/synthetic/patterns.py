"""Tools for painting textures: noise, colour ramps, lettering. Pictures are (H, W, 3) uint8 RGB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.uint8]
Field = npt.NDArray[np.float32]
Colour = tuple[float, float, float]

FINEST_CELL = 1.7
"""Noise has no cells smaller than this, texels."""


def noise(
    shape: tuple[int, int],
    cell: float | tuple[float, float],
    seed: Sequence[int],
    *,
    gain: float = 0.75,
    octaves: int = 12,
) -> Field:
    """Return noise of zero mean and unit variance, octave by octave down to single texels.

    Parameters
    ----------
    shape : (int, int)
        Height and width, texels.
    cell : float or (float, float)
        Size of the coarsest cells, texels, or along x and y.
    seed : sequence of int
        The same seed at another density gives the same picture with more or less detail.
    gain : float
        Amplitude of an octave over that of the next coarser one.
    octaves : int
        At most so many.
    """
    height, width = shape
    cell_x, cell_y = cell if isinstance(cell, tuple) else (cell, cell)
    total = np.zeros(shape, np.float32)
    amplitude, energy = 1.0, 0.0
    for octave in range(octaves):
        if octave > 0 and min(cell_x, cell_y) < FINEST_CELL:
            break
        columns = max(3, round(width / max(cell_x, FINEST_CELL)) + 1)
        rows = max(3, round(height / max(cell_y, FINEST_CELL)) + 1)
        lattice = np.random.default_rng([*seed, octave]).standard_normal((rows, columns))
        layer = cv2.resize(
            lattice.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC
        )
        total += np.float32(amplitude) * layer
        energy += 0.5 * amplitude**2
        amplitude *= gain
        cell_x, cell_y = cell_x / 2, cell_y / 2
    total *= np.float32(1 / np.sqrt(energy))
    return total


def around(field: Field) -> Field:
    """Return a field whose left and right ends meet, by fading the last tenth into the first."""
    width = field.shape[1]
    span = max(1, width // 10)
    share = np.linspace(0, 1, span, dtype=np.float32)
    out = field.copy()
    mirror = field[:, :span][:, ::-1]
    out[:, width - span :] = field[:, width - span :] * (1 - share) + mirror * share
    return out


def ramp(field: Field, stops: Sequence[tuple[float, Colour]]) -> Picture:
    """Return the picture that gives each value its colour; stops are (value, colour), rising."""
    low, high = stops[0][0], stops[-1][0]
    places = np.linspace(low, high, 256)
    table = np.stack(
        [np.interp(places, [s[0] for s in stops], [s[1][c] for s in stops]) for c in range(3)],
        axis=-1,
    )
    index = np.clip((field - low) * (255 / (high - low)) + 0.5, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(cv2.merge([index] * 3), np.rint(table)[None].astype(np.uint8)))


def plain(shape: tuple[int, int], colour: Colour) -> Picture:
    """Return a picture of one colour."""
    return np.full((*shape, 3), colour, dtype=np.uint8)


def shaded(picture: Picture, gain: Field) -> Picture:
    """Return the picture with its brightness multiplied by a field."""
    return np.asarray(cv2.multiply(picture, cv2.merge([gain] * 3), dtype=cv2.CV_8U))


def blended(picture: Picture, other: Picture | Colour, share: Field) -> Picture:
    """Return the picture with another laid over it, where and as far as the share says."""
    if isinstance(other, tuple):
        other = plain(picture.shape[:2], other)
    return np.asarray(
        cv2.blendLinear(
            picture, other, np.float32(1) - share, np.ascontiguousarray(share, np.float32)
        )
    )


def step(field: Field, edge: float, softness: float) -> Field:
    """Return 0 below the edge and 1 above it, rising smoothly over ± softness."""
    t = np.clip((field - (edge - softness)) / (2 * softness), 0, 1)
    return (t * t * (3 - 2 * t)).astype(np.float32)


def coordinates(shape: tuple[int, int]) -> tuple[Field, Field]:
    """Return (x, y) from 0 to 1 across and down the picture, as a row and a column."""
    height, width = shape
    x = (np.arange(width) + 0.5) / width
    y = (np.arange(height) + 0.5) / height
    return x[None, :].astype(np.float32), y[:, None].astype(np.float32)


def letter(
    picture: Picture,
    text: str,
    place: tuple[float, float],
    size: float,
    colour: Colour,
    *,
    weight: int = 400,
    font: str = "sans",
    centred: bool = False,
) -> None:
    """Write text into a picture, in place; place is the start (or middle) of the base line.

    Place and size (height of a line) are in texels; text too small to draw is left out.
    """
    pixels = round(size)
    if pixels < 3:
        return
    face = cv2.FontFace(font)
    x, y = round(place[0]), round(place[1])
    if centred:
        box = cv2.getTextSize((10_000, 10_000), text, (0, 0), face, pixels, weight)
        x -= box[2] // 2
    cv2.putText(picture, text, (x, y), colour, face, pixels, weight)


def turned(picture: Picture) -> Picture:
    """Return the picture turned a quarter clockwise."""
    return np.ascontiguousarray(np.rot90(picture, -1))


@dataclass(frozen=True, kw_only=True)
class Canvas:
    """What a painter gets: how large, how fine, and which chance."""

    shape: tuple[int, int]
    """Height and width, texels."""
    density: float
    """Texels a metre."""
    seed: tuple[int, ...]

    def noise(
        self,
        cell: float | tuple[float, float],
        layer: int = 0,
        *,
        gain: float = 0.75,
        octaves: int = 12,
    ) -> Field:
        """Return noise whose coarsest cells have that size in metres."""
        across, down = cell if isinstance(cell, tuple) else (cell, cell)
        return noise(
            self.shape, (across * self.density, down * self.density), (*self.seed, layer),
            gain=gain, octaves=octaves,
        )  # fmt: skip

    def chance(self, layer: int = 0) -> np.random.Generator:
        """Return a generator of its own for a layer."""
        return np.random.default_rng([*self.seed, 1000 + layer])

    def part(self, height: float, width: float, layer: int) -> Canvas:
        """Return a smaller canvas of that size in metres."""
        shape = (max(8, round(height * self.density)), max(8, round(width * self.density)))
        return Canvas(shape=shape, density=self.density, seed=(*self.seed, 50 + layer))


def wood(canvas: Canvas, dark: Colour, light: Colour, layer: int = 0) -> Picture:
    """Return planks with their grain along x, between two colours."""
    grain = canvas.noise((0.3, 0.01), 20 + layer, gain=0.85)
    return ramp(grain, ((-2.6, dark), (2.6, light)))
