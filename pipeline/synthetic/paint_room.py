"""Painters of the room: wall, floor, rug, column."""

from __future__ import annotations

import math

import cv2
import numpy as np

from pipeline.synthetic.patterns import (
    Canvas,
    Colour,
    Picture,
    around,
    coordinates,
    ramp,
    shaded,
    step,
)


def wall(canvas: Canvas, number: int) -> Picture:
    """Wallpaper with a woven ornament over a skirting board."""
    height, width = canvas.shape
    pitch = 0.36 * canvas.density
    x = np.arange(math.ceil(pitch), dtype=np.float32)[None, :] / pitch - 0.5
    y = np.arange(math.ceil(2 * pitch), dtype=np.float32)[:, None] / pitch
    ornament = np.zeros((y.size, x.size), np.float32)
    for shift in (0.0, 1.0, 2.0):
        for side in (-0.5, 0.0, 0.5):
            dx, dy = x - side, y - shift - (0.0 if side == 0 else 0.5)
            radius, angle = np.hypot(dx * 1.25, dy), np.arctan2(dx, dy)
            petals = 0.27 + 0.075 * np.cos(6 * angle) + 0.03 * np.cos(12 * angle)
            ring = np.abs(radius - 0.36 - 0.03 * np.cos(4 * angle))
            ornament += step(petals - radius, 0.0, 0.012) * (
                1 - 0.75 * step(np.cos(26 * radius / 0.3 - 4 * np.cos(6 * angle)), 0.45, 0.25)
            )
            ornament += 0.8 * step(-ring, -0.016, 0.01) + step(-radius, -0.05, 0.01)
    ornament = np.clip(ornament, 0, 1)
    grid_x = (np.arange(width, dtype=np.float32) % pitch).astype(np.float32)
    grid_y = (np.arange(height, dtype=np.float32) % (2 * pitch)).astype(np.float32)
    print_ = cv2.remap(
        ornament, np.repeat(grid_x[None], height, 0), np.repeat(grid_y[:, None], width, 1),
        cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    worn = canvas.noise(0.5, 1, gain=0.7)
    print_ *= np.clip(0.88 + 0.16 * worn, 0, 1)
    weave = canvas.noise((0.05, 0.012), 2, gain=0.95)
    value = print_ + 0.085 * weave + 0.05 * worn
    picture = ramp(
        value,
        ((-0.45, (70, 100, 104)), (0.0, (104, 138, 136)), (0.5, (158, 158, 132)),
         (1.0, (198, 180, 138)), (1.4, (224, 206, 166))),
    )  # fmt: skip
    # the floor is at 0.4 m above the lower edge of the wall
    board = round(height - 0.4 * canvas.density)
    top = board - round(0.2 * canvas.density)
    if 0 < top < board:
        slab = Canvas(shape=(height - top, width), density=canvas.density, seed=canvas.seed)
        wood = ramp(
            slab.noise((0.5, 0.012), 3, gain=0.8),
            ((-3, (150, 138, 118)), (0, (206, 196, 174)), (3, (236, 228, 208))),
        )
        profile = np.ones((height - top, 1), np.float32)
        for place, gain in ((0.0, 1.12), (0.025, 0.62), (0.045, 0.86), (0.06, 1.08)):
            profile[round(place * canvas.density) :] = gain
        picture[top:] = shaded(wood, np.ascontiguousarray(np.broadcast_to(profile, wood.shape[:2])))
    return picture


def floor(canvas: Canvas, number: int) -> Picture:
    """Boards that run away from the viewer."""
    width = canvas.shape[1]
    chance = np.random.default_rng([canvas.seed[0], 77, number])
    board = 0.15 * canvas.density
    # boards are laid from the middle, so that rows of boards meet
    index = np.floor((np.arange(width) - width / 2) / board).astype(int)
    shift = chance.uniform(-1, 1, 400)[index + 200].astype(np.float32)
    grain = canvas.noise((0.016, 0.5), 1, gain=0.86)
    rings = canvas.noise((0.09, 0.9), 2, gain=0.45, octaves=4)
    streak = np.sin(rings * 9 + shift[None, :] * 40).astype(np.float32)
    value = 0.52 * shift[None, :] + 0.36 * grain + 0.28 * streak
    picture = ramp(
        value,
        (
            (-1.6, (74, 46, 30)),
            (-0.5, (124, 82, 52)),
            (0.3, (164, 114, 72)),
            (1.5, (206, 160, 108)),
        ),
    )
    inside = np.abs((np.arange(width) - width / 2) / board - index - 0.5) * 0.15
    gap = step(inside.astype(np.float32), 0.0725, 0.0012)[None, :]
    end = step(np.abs(coordinates(canvas.shape)[1] - 0.5), 0.5 - 0.002 * 2, 0.001)
    gap = np.maximum(gap, end * 0.8)
    return shaded(picture, np.ascontiguousarray(1 - 0.72 * np.broadcast_to(gap, canvas.shape)))


def rug(canvas: Canvas, number: int) -> Picture:
    """A knotted rug: borders, lozenges, fringes."""
    shape = canvas.shape
    x, y = coordinates(shape)
    metres_x, metres_y = shape[1] / canvas.density, shape[0] / canvas.density
    edge = np.minimum(
        np.minimum(x, 1 - x) * metres_x, np.minimum(y, 1 - y) * metres_y
    ).astype(np.float32)  # fmt: skip
    px, py = (x - 0.5) * metres_x / 0.31, (y - 0.5) * metres_y / 0.31
    lozenge = np.abs((px + 0.5) % 1 - 0.5) + np.abs((py + 0.5) % 1 - 0.5)
    rings = (lozenge * 8).astype(int) % 4
    number_of = (np.floor(px + 0.5) + np.floor(py + 0.5)).astype(int) % 3
    reds = np.array([[150, 48, 48], [52, 66, 104], [188, 156, 112], [112, 36, 42]], np.uint8)
    blues = np.array([[48, 70, 112], [172, 136, 92], [134, 46, 52], [200, 172, 132]], np.uint8)
    greens = np.array([[62, 96, 84], [196, 168, 126], [156, 58, 52], [44, 58, 88]], np.uint8)
    picture = np.stack((reds, blues, greens))[number_of, rings]
    for outer, inner, colour in (
        (0.155, 0.145, (226, 206, 166)), (0.145, 0.135, (30, 40, 70)),
        (0.055, 0.045, (222, 200, 158)), (0.045, 0.0, (118, 30, 40)),
    ):  # fmt: skip
        picture[(edge < outer) & (edge >= inner)] = colour
    band = (edge < 0.135) & (edge >= 0.055)
    along = np.where(np.minimum(x, 1 - x) * metres_x < np.minimum(y, 1 - y) * metres_y, py, px)
    wave = np.sin(along * 0.31 / 0.05 * np.pi) * 0.022
    vine = np.abs(edge - 0.095 - wave) < 0.009
    flower = np.hypot(((along * 0.31 / 0.1) % 1 - 0.5) * 0.1, edge - 0.095) < 0.02
    picture[band] = (40, 58, 88)
    picture[band & vine] = (196, 170, 116)
    picture[band & flower] = (190, 92, 74)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.004 * canvas.density)
    knots = canvas.noise(0.006, 1, gain=0.95)
    wear = canvas.noise(0.4, 2, gain=0.75)
    return shaded(picture, np.clip(0.98 + 0.09 * knots + 0.07 * wear, 0.4, 1.5))


def marble(canvas: Canvas, tones: tuple[Colour, Colour, Colour], vein: float) -> Picture:
    """Veined stone that meets itself around a cylinder; tones: clouds, ground, veins."""
    bend = canvas.noise(0.35, 1, gain=0.6)
    field = canvas.noise(0.3, 2, gain=0.62) + 0.8 * bend
    veins = np.exp(-np.abs(around(field)) * 9).astype(np.float32)
    fine = np.exp(-np.abs(around(canvas.noise(0.12, 3, gain=0.7))) * 14).astype(np.float32)
    grain = canvas.noise(0.02, 4, gain=0.95)
    value = vein * (veins + 0.45 * fine) + 0.05 * grain - 0.08 * bend
    return ramp(value, ((-0.3, tones[0]), (0.2, tones[1]), (1.1, tones[2])))


def column(canvas: Canvas, number: int) -> Picture:
    """A fluted column of pale marble."""
    picture = marble(canvas, ((244, 238, 226), (224, 214, 198), (120, 110, 104)), 0.85)
    x, _ = coordinates(canvas.shape)
    flute = np.cos(2 * np.pi * 22 * x)
    gain = 0.94 + 0.13 * flute - 0.22 * step(-flute, 0.82, 0.12)
    return shaded(picture, np.ascontiguousarray(np.broadcast_to(gain, canvas.shape), np.float32))


def plinth(canvas: Canvas, number: int) -> Picture:
    """Dark green marble, profiled."""
    picture = marble(canvas, ((44, 66, 60), (66, 92, 80), (196, 206, 190)), 0.8)
    _, y = coordinates(canvas.shape)
    gain = 1 + 0.3 * np.sin(y * 14) * (y < 0.45) + 0.1 * (y > 0.45)
    return shaded(picture, np.ascontiguousarray(np.broadcast_to(gain, canvas.shape), np.float32))


def plinthtop(canvas: Canvas, number: int) -> Picture:
    """Marble like that of the plinth's side, lighter."""
    return marble(canvas, ((58, 84, 76), (82, 110, 96), (206, 214, 198)), 0.8)
