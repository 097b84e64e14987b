"""What the surfaces of the sample scene look like: one painter for each, all procedural.

A mixture as in photographs: smooth shades, marble and wood, print in many
sizes, ornament, and detail down to single texels. A painter takes a
:class:`Canvas` and returns a picture; sizes in painters are metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.synthetic.patterns import (
    Colour,
    Field,
    Picture,
    around,
    blended,
    coordinates,
    letter,
    noise,
    plain,
    ramp,
    shaded,
    step,
    turned,
)  # fmt: skip

INK = (56, 53, 60)
PAPER = (236, 229, 212)

NEWS = ["Eight", "cameras", "stand", "in", "a", "row", "and", "look", "at", "one", "still", "life.", "Each", "of", "them", "sees", "coarse", "pixels", "only,", "yet", "no", "two", "see", "the", "same:", "between", "the", "pixels", "of", "one", "lie", "the", "pixels", "of", "another.", "Who", "knows", "where", "every", "pixel", "belongs", "may", "lay", "them", "all", "on", "a", "finer", "grid", "and", "read", "what", "none", "of", "the", "cameras", "could.", "Depth", "tells", "where", "they", "belong.", "The", "globe", "turns,", "the", "cube", "dances,", "a", "ball", "bounces", "past;", "the", "boards,", "the", "marble", "and", "the", "books", "stand", "still", "and", "wait", "to", "be", "sharpened."]

TITLES = (
    "OPTICS", "Parallax", "A ROOM IN DEPTH", "Spline Tales", "FOURIER", "The Lens", "NYQUIST",
    "Stereo & Sons", "ON GRIDS", "Moving Pictures", "ATLAS III", "Inverse Problems", "LIGHT",
    "Eight Eyes", "KRIGING", "Half a Pixel", "SEVEN BOXES", "Aliasing", "The Far Wall", "MIRA",
)  # fmt: skip


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


def painted(name: str, extent: tuple[float, float], density: float, seed: int) -> Picture:
    """Return the texture of that name.

    Parameters
    ----------
    extent : (float, float)
        Width and height of the surface, metres.
    density : float
        Texels a metre.
    """
    kind = name.rstrip("0123456789")
    number = int(name[len(kind) :] or 0)
    shape = (max(8, round(extent[1] * density)), max(8, round(extent[0] * density)))
    mark = sum(ord(character) * (place + 3) for place, character in enumerate(name))
    canvas = Canvas(shape=shape, density=density, seed=(seed, mark))
    return np.ascontiguousarray(PAINTERS[kind](canvas, number))


# --- room --------------------------------------------------------------------------------


def _wall(canvas: Canvas, number: int) -> Picture:
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


def _floor(canvas: Canvas, number: int) -> Picture:
    """Boards that run away from the viewer."""
    height, width = canvas.shape
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
        ((-1.6, (74, 46, 30)), (-0.5, (124, 82, 52)), (0.3, (164, 114, 72)), (1.5, (206, 160, 108))),
    )
    inside = np.abs((np.arange(width) - width / 2) / board - index - 0.5) * 0.15
    gap = step(inside.astype(np.float32), 0.0725, 0.0012)[None, :]
    end = step(np.abs(coordinates(canvas.shape)[1] - 0.5), 0.5 - 0.002 * 2, 0.001)
    gap = np.maximum(gap, end * 0.8)
    return shaded(picture, np.ascontiguousarray(1 - 0.72 * np.broadcast_to(gap, canvas.shape)))


def _rug(canvas: Canvas, number: int) -> Picture:
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


def _marble(canvas: Canvas, tones: tuple[Colour, Colour, Colour], vein: float) -> Picture:
    bend = canvas.noise(0.35, 1, gain=0.6)
    field = canvas.noise(0.3, 2, gain=0.62) + 0.8 * bend
    veins = np.exp(-np.abs(around(field)) * 9).astype(np.float32)
    fine = np.exp(-np.abs(around(canvas.noise(0.12, 3, gain=0.7))) * 14).astype(np.float32)
    grain = canvas.noise(0.02, 4, gain=0.95)
    value = vein * (veins + 0.45 * fine) + 0.05 * grain - 0.08 * bend
    return ramp(value, ((-0.3, tones[0]), (0.2, tones[1]), (1.1, tones[2])))


def _column(canvas: Canvas, number: int) -> Picture:
    """A fluted column of pale marble."""
    picture = _marble(canvas, ((244, 238, 226), (224, 214, 198), (120, 110, 104)), 0.85)
    x, _ = coordinates(canvas.shape)
    flute = np.cos(2 * np.pi * 22 * x)
    gain = 0.94 + 0.13 * flute - 0.22 * step(-flute, 0.82, 0.12)
    return shaded(picture, np.ascontiguousarray(np.broadcast_to(gain, canvas.shape), np.float32))


def _plinth(canvas: Canvas, number: int) -> Picture:
    """Dark green marble, profiled."""
    picture = _marble(canvas, ((44, 66, 60), (66, 92, 80), (196, 206, 190)), 0.8)
    _, y = coordinates(canvas.shape)
    gain = 1 + 0.3 * np.sin(y * 14) * (y < 0.45) + 0.1 * (y > 0.45)
    return shaded(picture, np.ascontiguousarray(np.broadcast_to(gain, canvas.shape), np.float32))


def _plinthtop(canvas: Canvas, number: int) -> Picture:
    return _marble(canvas, ((58, 84, 76), (82, 110, 96), (206, 214, 198)), 0.8)


# --- furniture ---------------------------------------------------------------------------


def _wood(canvas: Canvas, dark: Colour, light: Colour, layer: int = 0) -> Picture:
    grain = canvas.noise((0.3, 0.01), 20 + layer, gain=0.85)
    return ramp(grain, ((-2.6, dark), (2.6, light)))


def _shelf(canvas: Canvas, number: int) -> Picture:
    """A case with three rows of books."""
    height, width = canvas.shape
    chance = canvas.chance()
    scale = canvas.density
    picture = _wood(canvas, (78, 48, 28), (146, 98, 60))
    board = round(0.035 * scale)
    rows = 3
    pitch = (height - board) / rows
    inks = ((232, 206, 140), (240, 232, 214), (34, 30, 34), (222, 186, 96))
    clothes = (
        (132, 38, 36), (36, 62, 104), (44, 92, 72), (190, 144, 64), (92, 56, 96), (206, 190, 160),
        (54, 54, 62), (168, 84, 44), (70, 120, 140), (116, 126, 60), (196, 104, 98),
    )  # fmt: skip
    volume = 0
    for row in range(rows):
        top, bottom = round(board + row * pitch), round((row + 1) * pitch)
        picture[top:bottom, board : width - board] //= 4
        x = board + 0.01 * scale
        while x < width - board - 0.05 * scale:
            thick = max(4, round(chance.uniform(0.026, 0.062) * scale))
            tall = round((bottom - top) * chance.uniform(0.70, 0.96))
            x0, x1 = round(x), min(round(x) + thick, width - board)
            if chance.random() < 0.05:
                x += chance.uniform(0.02, 0.06) * scale
                continue
            cloth = np.array(clothes[int(chance.integers(len(clothes)))], float)
            cloth = np.clip(cloth + chance.uniform(-14, 14, 3), 12, 240)
            ink = inks[int(chance.integers(len(inks)))]
            if cloth.mean() > 150:
                ink = inks[2]
            spine = plain((x1 - x0, tall), tuple(cloth))  # lying, to write along it
            for place in (0.06, 0.09, 0.80, 0.90):
                at = round(place * tall)
                spine[:, at : at + max(1, round(0.004 * scale))] = ink
            letter(
                spine, TITLES[volume % len(TITLES)], (0.13 * tall, 0.70 * (x1 - x0)),
                0.58 * (x1 - x0), ink, weight=int(chance.choice([400, 600, 800])),
            )  # fmt: skip
            volume += 1
            spine = turned(spine)
            across = (np.arange(x1 - x0, dtype=np.float32) + 0.5) / (x1 - x0)
            gain = 0.62 + 0.5 * np.sin(np.pi * across) ** 0.7
            spine = shaded(
                spine, np.ascontiguousarray(np.broadcast_to(gain, spine.shape[:2]), np.float32)
            )
            picture[bottom - tall : bottom, x0:x1] = spine
            x = x1 + chance.uniform(0, 0.003) * scale
        picture[bottom : bottom + board] = _wood(
            Canvas(shape=(height - bottom if row == rows - 1 else board, width),
                   density=scale, seed=canvas.seed), (96, 60, 36), (166, 114, 70), row,
        )[: picture[bottom : bottom + board].shape[0]]  # fmt: skip
        shadow = picture[top : top + round(0.05 * scale), board : width - board]
        fade = np.linspace(0.35, 1, shadow.shape[0], dtype=np.float32)[:, None]
        shadow[:] = shaded(
            np.ascontiguousarray(shadow),
            np.ascontiguousarray(np.broadcast_to(fade, shadow.shape[:2])),
        )
    return shaded(picture, np.clip(1 + 0.07 * canvas.noise(0.01, 9, gain=0.9), 0.5, 1.5))


def _painting(canvas: Canvas, number: int) -> Picture:
    """Mountains over a lake, in oil, in a gilded frame."""
    height, width = canvas.shape
    x, y = coordinates(canvas.shape)
    clouds = canvas.noise((0.5, 0.16), 1, gain=0.62)
    sky = 0.9 * y / 0.55 + 0.10 * clouds
    picture = ramp(
        np.ascontiguousarray(np.broadcast_to(sky, canvas.shape), np.float32),
        ((0.0, (74, 116, 176)), (0.5, (166, 190, 206)), (0.85, (240, 214, 170)),
         (1.1, (246, 188, 136))),
    )  # fmt: skip
    sun = np.hypot((x - 0.68) * width / height, y - 0.34).astype(np.float32)
    picture = blended(picture, (255, 244, 206), np.exp(-((sun / 0.11) ** 2)) * np.float32(0.9))
    chance = canvas.chance()
    horizon = 0.60
    for layer, (base, rough, dark, light) in enumerate((
        (0.50, 0.15, (92, 110, 150), (156, 164, 186)),
        (0.56, 0.12, (58, 78, 108), (112, 126, 138)),
        (0.61, 0.07, (32, 52, 48), (74, 96, 66)),
    )):  # fmt: skip
        line = noise((3, width), width / 3, (*canvas.seed, 30 + layer), gain=0.52)[1]
        ridge = base - rough * np.abs(line) + 0.03 * chance.standard_normal()
        depth = (y - ridge[None, :]).astype(np.float32)
        slope = canvas.noise((0.05, 0.09), 10 + layer, gain=0.8)
        rock = ramp(slope - 5 * depth, ((-2.2, dark), (1.6, light)))
        picture = blended(picture, rock, step(depth, 0.0, 0.003))
    top = round(horizon * height)
    mirrored = picture[: top + 1][::-1][: height - top]
    if mirrored.shape[0] < height - top:
        mirrored = cv2.resize(mirrored, (width, height - top))
    ripple = canvas.noise((0.12, 0.006), 20, gain=0.85)[top:]
    shift = np.tile(np.arange(width, dtype=np.float32), (height - top, 1)) + 5 * ripple
    rows = np.repeat(np.arange(height - top, dtype=np.float32)[:, None], width, 1) + 2 * ripple
    lake = cv2.remap(
        np.ascontiguousarray(mirrored), shift, rows, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    picture[top:] = shaded(lake, np.clip(0.82 + 0.09 * ripple, 0.3, 1.2))
    strokes = canvas.noise((0.03, 0.012), 40, gain=0.9)
    picture = shaded(picture, np.clip(1 + 0.07 * strokes, 0.6, 1.4))
    frame = 0.075 * canvas.density
    edge = np.minimum(
        np.minimum(x * width, (1 - x) * width), np.minimum(y * height, (1 - y) * height)
    ) / frame  # fmt: skip
    profile = 0.35 + 0.55 * np.abs(np.sin(edge * 4.2)) + 0.12 * np.sin(edge * 23)
    carve = canvas.noise(0.03, 41, gain=0.8)
    gilt = ramp(
        (profile + 0.1 * carve).astype(np.float32),
        ((0.1, (62, 38, 14)), (0.5, (156, 112, 44)), (0.85, (222, 184, 96)), (1.2, (255, 240, 190))),
    )
    return np.where((edge < 1)[..., None], gilt, picture)


def _page(canvas: Canvas, number: int) -> Picture:
    """The front page of a newspaper."""
    height, width = canvas.shape
    scale = canvas.density
    picture = plain(canvas.shape, (214, 207, 190))
    letter(picture, "The Parallax", (width / 2, 0.115 * scale), 0.105 * scale, INK,
           weight=800, font="italic", centred=True)  # fmt: skip
    margin = round(0.035 * scale)
    rule = max(1, round(0.004 * scale))
    for place in (0.148, 0.19):
        at = round(place * scale)
        picture[at : at + rule, margin : width - margin] = INK
    letter(picture, "No. 8   DEPTH, MOTION & LIGHT   Price K²", (width / 2, 0.181 * scale),
           0.030 * scale, INK, weight=600, centred=True)  # fmt: skip
    letter(picture, "HALF A PIXEL FOUND", (width / 2, 0.256 * scale), 0.060 * scale, INK,
           weight=800, centred=True)  # fmt: skip
    photo = canvas.part(0.25, 0.34, 1)
    scene = _painting(photo, 0)
    grey = cv2.cvtColor(scene, cv2.COLOR_RGB2GRAY)
    y0, x0 = round(0.29 * scale), margin
    window = picture[y0 : y0 + grey.shape[0], x0 : x0 + grey.shape[1]]
    window[:] = cv2.merge([grey] * 3)[: window.shape[0], : window.shape[1]]
    columns = 3
    pitch = (width - 2 * margin + 0.02 * scale) / columns
    wide = pitch - 0.02 * scale
    line = 0.0245 * scale
    size = 0.0215 * scale
    word = 0
    for column in range(columns):
        x_left = margin + column * pitch
        y = (0.315 if x_left > x0 + grey.shape[1] - 0.3 * wide else 0.572) * scale
        while y < height - 0.03 * scale:
            x = x_left
            while x < x_left + wide - 0.02 * scale:
                text = NEWS[word % len(NEWS)]
                length = 0.46 * size * (len(text) + 1)
                if x + length > x_left + wide + 0.012 * scale:
                    break
                letter(picture, text, (x, y), size, INK, weight=500)
                x += length
                word += 1
            y += line
    fold = canvas.noise(0.3, 2, gain=0.6)
    fibre = canvas.noise(0.012, 3, gain=0.95)
    return shaded(picture, np.clip(1 + 0.035 * fold + 0.035 * fibre, 0.6, 1.3))


def _chart(canvas: Canvas, number: int) -> Picture:
    """A test chart: star, wedges, letters that shrink, patches of colour and grey."""
    height, width = canvas.shape
    scale = canvas.density
    picture = plain(canvas.shape, (232, 227, 214))
    column, row = np.meshgrid(np.arange(width) / scale, np.arange(height) / scale)
    column, row = column.astype(np.float32), row.astype(np.float32)
    ink = np.zeros(canvas.shape, np.float32)
    radius, angle = np.hypot(column - 0.27, row - 0.34), np.arctan2(row - 0.34, column - 0.27)
    disc = step(-radius, -0.215, 0.5 / scale)
    soft = np.clip(36 / (2 * np.pi * np.maximum(radius, 1e-3) * scale) * 1.2, 0.02, 4)
    star = np.clip(0.5 + np.sin(36 * angle) / (2 * soft), 0, 1)
    ink = np.maximum(ink, disc * star)
    ink = np.maximum(ink, step(-np.abs(radius - 0.228), -0.004, 0.5 / scale))
    for place, left in ((0.13, 0.55), (0.34, 0.55)):  # wedges of lines that close up
        inside = (column > left) & (column < left + 0.27) & (np.abs(row - place - 0.085) < 0.085)
        share = (column - left) / 0.27
        pitch = (0.030 - 0.022 * share) if place < 0.2 else (0.011 + 0.0 * share)
        wave = np.sin(2 * np.pi * (row - place - 0.085) / pitch)
        if place > 0.2:
            pitch = 0.024 * (0.0065 / 0.024) ** share
            phase = 0.27 / math.log(0.0065 / 0.024) * (1 / pitch - 1 / 0.024)
            wave = np.sin(-2 * np.pi * phase)
        sharp = np.clip(0.5 + wave * np.clip(pitch * scale / 7, 0.4, 6), 0, 1)
        ink = np.where(inside, sharp, ink)
    picture = blended(picture, INK, ink.astype(np.float32))
    letter(picture, "RESOLUTION", (0.43 * scale, 0.088 * scale), 0.085 * scale, INK,
           weight=800, centred=True)  # fmt: skip
    y = 0.60
    for size, text in (
        (0.085, "D E P T H"), (0.062, "S U P E R 3 D"), (0.045, "R E S O L U T I O N"),
        (0.033, "finer than any of its cameras"), (0.025, "half a pixel here, half a pixel there"),
        (0.019, "and soon we are talking about real detail, said the eighth camera"),
    ):  # fmt: skip
        y += size * 0.98
        letter(picture, text, (0.05 * scale, y * scale), size * scale, INK, weight=600)
        y += 0.012
    patches = ((196, 52, 46), (230, 158, 52), (236, 216, 82), (76, 142, 78), (54, 104, 172),
               (112, 70, 140), (40, 40, 40), (110, 110, 110), (180, 180, 180))  # fmt: skip
    for place, colour in enumerate(patches):
        x0 = round((0.05 + place * 0.0856) * scale)
        y0 = round(0.985 * scale)
        picture[y0 : y0 + round(0.05 * scale), x0 : x0 + round(0.074 * scale)] = colour
    border = max(1, round(0.012 * scale))
    picture[:border] = picture[-border:] = (60, 66, 84)
    picture[:, :border] = picture[:, -border:] = (60, 66, 84)
    return shaded(picture, np.clip(1 + 0.022 * canvas.noise(0.02, 1, gain=0.9), 0.7, 1.3))


# --- things ------------------------------------------------------------------------------


def _can(canvas: Canvas, number: int) -> Picture:
    """A tea tin with a printed label."""
    height, width = canvas.shape
    scale = canvas.density
    x, y = coordinates(canvas.shape)
    metal = ramp(
        around(canvas.noise((0.6, 0.004), 1, gain=0.9)) + 0 * y,
        ((-3, (150, 120, 70)), (0, (206, 172, 110)), (3, (244, 222, 170))),
    )
    paper = ramp(
        around(canvas.noise(0.25, 2, gain=0.8)),
        ((-3, (112, 26, 30)), (0, (156, 38, 40)), (3, (186, 62, 54))),
    )
    label = np.broadcast_to((y > 0.12) & (y < 0.88), canvas.shape)
    picture = np.where(label[..., None], paper, metal)
    for place in (0.145, 0.165, 0.835, 0.855):
        at = round(place * height)
        picture[at : at + max(1, round(0.007 * height))] = (226, 190, 112)
    beads = np.abs(((x * 60) % 1) - 0.5) + np.abs((y - 0.2) * height / (width / 60))
    beads2 = np.abs(((x * 60) % 1) - 0.5) + np.abs((y - 0.8) * height / (width / 60))
    picture[np.minimum(beads, beads2) < 0.36] = (232, 204, 140)
    for middle in (0.0, 0.5, 1.0):
        around_x, around_y = (x - middle) * width / scale, (y - 0.5) * height / scale
        oval = np.hypot(around_x / 0.245, around_y / 0.165)
        angle = np.arctan2(around_y / 0.165, around_x / 0.245)
        picture[oval < 1 + 0.02 * np.cos(40 * angle)] = (40, 30, 30)
        picture[oval < 0.95] = (238, 224, 188)
        picture[np.abs(oval - 0.88) < 0.012] = (156, 38, 40)
        rays = (np.sin(48 * angle) > 0) & (oval > 0.64) & (oval < 0.84)
        picture[rays & np.broadcast_to(oval < 2, canvas.shape)] = (214, 186, 128)
        centre = middle * width
        picture[(np.abs(around_x) < 0.2) & (np.abs(around_y) < 0.075)] = (238, 224, 188)
        picture = np.ascontiguousarray(picture)
        for text, rise, size, weight in (
            ("DEPTH", -0.022, 0.075, 800), ("orange pekoe", 0.022, 0.042, 500),
            ("net weight 8 views · sampled at half a pixel", 0.053, 0.0175, 500),
        ):  # fmt: skip
            letter(picture, text, (centre, (0.5 * height) + rise * scale), size * scale,
                   (72, 30, 28), weight=weight, centred=True)  # fmt: skip
    for middle in (0.25, 0.75):
        for place in range(46):  # a bar code
            if (place * place * 7 + place) % 5 < 2:
                x0 = round(middle * width + (place - 23) * 0.0032 * scale)
                picture[round(0.4 * height) : round(0.6 * height), x0 : x0 + 2] = PAPER
    dent = around(canvas.noise(0.02, 3, gain=0.9))
    return shaded(picture, np.clip(1 + 0.04 * dent, 0.6, 1.4))


def _lid(canvas: Canvas, number: int) -> Picture:
    """A lid of turned brass."""
    x, y = coordinates(canvas.shape)
    radius, angle = np.hypot(x - 0.5, y - 0.5) * 2, np.arctan2(y - 0.5, x - 0.5)
    turned_ = noise((1, 2048), 40.0, (*canvas.seed, 1), gain=0.95)[0]
    groove = turned_[np.clip(radius * 1200, 0, 2047).astype(int)]
    sheen = 0.5 * np.cos(2 * angle + 0.7) + 0.3 * np.cos(4 * angle)
    rim = -1.6 * step(-np.abs(radius - 0.86), -0.03, 0.012) + 1.0 * step(radius, 0.9, 0.02)
    value = (0.30 * groove + 0.5 * sheen + rim).astype(np.float32)
    return ramp(
        value, ((-2, (70, 48, 22)), (-0.3, (166, 128, 66)), (0.8, (230, 200, 130)), (2, (255, 246, 214)))
    )


def _rod(canvas: Canvas, number: int) -> Picture:
    """A stick with a spiral band."""
    x, y = coordinates(canvas.shape)
    turns = x + y * 26
    band = step(np.abs(turns % 1 - 0.5), 0.25, 0.03)
    grain = canvas.noise((0.01, 0.1), 1, gain=0.85)
    red = ramp(grain, ((-3, (140, 24, 26)), (3, (204, 54, 44))))
    white = ramp(grain, ((-3, (206, 198, 182)), (3, (248, 244, 232))))
    return blended(red, white, np.ascontiguousarray(np.broadcast_to(band, canvas.shape)))


def _globe(canvas: Canvas, number: int) -> Picture:
    """Continents, seas, a net of degrees, names."""
    height, width = canvas.shape
    x, y = coordinates(canvas.shape)
    land = around(canvas.noise(0.85, 7, gain=0.58)) + 0 * y
    level = 0.8 * land - 0.06 + 0.25 * np.abs(y - 0.5)
    relief = around(canvas.noise(0.10, 8, gain=0.85))
    sea = ramp(
        level + 0.05 * relief,
        ((-2.2, (18, 52, 104)), (-0.5, (38, 92, 146)), (-0.08, (92, 156, 186)), (0, (176, 210, 206))),
    )
    ground = ramp(
        level + 0.17 * relief,
        ((0, (220, 204, 150)), (0.2, (142, 160, 84)), (0.7, (96, 122, 64)), (1.3, (164, 128, 80)),
         (1.9, (198, 164, 116)), (2.6, (240, 234, 224))),
    )  # fmt: skip
    coast = step(level, 0.0, 0.012)
    picture = blended(sea, ground, coast)
    shore = np.exp(-((level / 0.02) ** 2)).astype(np.float32)
    picture = blended(picture, (60, 52, 48), 0.6 * shore)
    for latitude in range(1, 12):
        row = round(height * latitude / 12)
        picture[row : row + max(1, round(height / 420))] = (226, 214, 176)
    thick = max(1, round(width / 1500))
    for longitude in range(24):
        column = round(width * (longitude + 0.5) / 24)
        picture[:, column : column + thick] = (226, 214, 176)
    chance = canvas.chance()
    names = ("AURELIA", "Port Lumen", "MARE PIXELIS", "Nova", "Cape Bayer", "ISLA ALIAS", "Kernel",
             "TERRA FIRMA", "Moiré", "Gulf of Blur", "SPLINIA", "Delta", "Quanta", "Ringing Sea",
             "EDGELAND", "Phase", "Sigma", "Lake Tukey")  # fmt: skip
    for place in range(48):
        size = float(chance.choice([0.026, 0.034, 0.046])) * canvas.density
        row, column = divmod(place, 8)
        spot = (
            (column + 0.5 * (row % 2) + chance.uniform(0.08, 0.2)) / 8.6 * width,
            (0.24 + 0.105 * (row + chance.uniform(-0.3, 0.3))) * height,
        )
        letter(picture, names[(place * 7) % len(names)], spot, size, (34, 30, 40), weight=600)
        cv2.circle(picture, (round(spot[0] - 0.012 * canvas.density), round(spot[1] - size / 4)),
                   max(1, round(0.006 * canvas.density)), (180, 40, 36), -1, cv2.LINE_AA)  # fmt: skip
    cap = step(np.abs(y - 0.5), 0.425, 0.01)
    rings = 0.5 + 0.5 * np.cos(np.abs(y - 0.5) * 260)
    picture = blended(
        picture, (236, 238, 240), np.ascontiguousarray(np.broadcast_to(cap, canvas.shape))
    )
    return shaded(
        picture,
        np.ascontiguousarray(np.broadcast_to(1 - 0.12 * cap * rings, canvas.shape), np.float32),
    )


def _stand(canvas: Canvas, number: int) -> Picture:
    """Turned wood, dark."""
    _, y = coordinates(canvas.shape)
    gain = (0.8 + 0.4 * np.abs(np.sin(y * 9))).astype(np.float32)
    wood = _wood(canvas, (50, 28, 18), (122, 74, 44))
    return shaded(wood, np.ascontiguousarray(np.broadcast_to(gain, canvas.shape)))


def _standtop(canvas: Canvas, number: int) -> Picture:
    return _wood(canvas, (58, 34, 22), (132, 82, 50))


def _ball(canvas: Canvas, number: int) -> Picture:
    """A beach ball in six colours."""
    x, y = coordinates(canvas.shape)
    stripes = np.array(
        [[232, 68, 52], [244, 240, 230], [250, 190, 48], [244, 240, 230], [38, 120, 190],
         [244, 240, 230], [70, 160, 84], [244, 240, 230]], np.uint8,
    )  # fmt: skip
    index = np.broadcast_to((x * 8).astype(int) % 8, canvas.shape)
    picture = stripes[index]
    seam = np.abs((x * 8) % 1 - 0.5) > 0.46
    dots = np.hypot((x * 32) % 1 - 0.5, ((y * 14) % 1 - 0.5)) < 0.26
    picture[np.broadcast_to(seam, canvas.shape)] = (54, 50, 60)
    picture[dots & (np.abs(y - 0.5) < 0.36)] //= 2
    picture[np.broadcast_to(np.abs(y - 0.5) > 0.42, canvas.shape)] = (240, 196, 60)
    return shaded(picture, np.clip(1 + 0.04 * around(canvas.noise(0.01, 1)), 0.6, 1.4))


def _card(canvas: Canvas, number: int) -> Picture:
    """A printed card: guilloche, rosette, a large figure."""
    height, width = canvas.shape
    x, y = coordinates(canvas.shape)
    px, py = (x - 0.5) * 2 * width / height, (y - 0.5) * 2
    radius, angle = np.hypot(px, py), np.arctan2(py, px)
    paper = np.ascontiguousarray(np.broadcast_to(y + 0.3 * x, canvas.shape), np.float32)
    picture = ramp(
        paper, ((0, (250, 232, 196)), (0.6, (244, 206, 178)), (1.3, (206, 190, 222)))
    )
    for waves, turns, colour in ((9, 46, (44, 96, 120)), (-7, 40, (166, 60, 84))):
        line = np.sin(turns * radius + 1.9 * np.sin(waves * angle) * (0.3 + radius))
        width_ = 0.32 * np.clip(turns / height * 4, 0.15, 1)
        picture = blended(
            picture, colour, (0.62 * step(line, 0.72, width_) * step(radius, 0.40, 0.01)).astype(np.float32)
        )
    petals = np.cos(12 * angle) * 0.05 + 0.40
    picture = blended(picture, (36, 52, 92), step(petals - radius, 0.0, 0.012))
    picture = blended(picture, (246, 222, 160), step(petals - 0.05 - radius, 0.0, 0.012))
    letter(picture, "3D", (0.5 * width, 0.5 * height + 0.095 * canvas.density),
           0.27 * canvas.density, (150, 36, 52), weight=900, centred=True)  # fmt: skip
    for place in (0.105, 0.955):
        letter(picture, "SUPER · RESOLUTION", (0.5 * width, place * height), 0.042 * canvas.density,
               (40, 46, 70), weight=700, centred=True)  # fmt: skip
    edge = np.minimum(np.minimum(x, 1 - x) * width, np.minimum(y, 1 - y) * height)
    picture[(edge > 0.012 * canvas.density) & (edge < 0.019 * canvas.density)] = (40, 46, 70)
    return shaded(picture, np.clip(1 + 0.025 * canvas.noise(0.01, 1, gain=0.95), 0.7, 1.3))


def _string(canvas: Canvas, number: int) -> Picture:
    x, y = coordinates(canvas.shape)
    twist = np.ascontiguousarray(np.broadcast_to(np.sin(2 * np.pi * (x + 40 * y)), canvas.shape))
    return ramp(twist.astype(np.float32), ((-1, (120, 92, 58)), (1, (212, 184, 136))))


def _cube(canvas: Canvas, number: int) -> Picture:
    """A toy block with a letter."""
    height, width = canvas.shape
    x, y = coordinates(canvas.shape)
    tone = ((206, 60, 48), (52, 112, 176), (236, 176, 56), (64, 140, 84), (150, 84, 160))[number]
    wood = ramp(
        canvas.noise((0.25, 0.006), 1, gain=0.85),
        ((-3, (186, 146, 96)), (0, (226, 192, 140)), (3, (248, 226, 184))),
    )
    edge = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y))
    wood[edge < 0.10] = (np.array(tone) * 0.94).astype(np.uint8)
    wood[(edge > 0.125) & (edge < 0.145)] = tone
    letter(wood, "DEPTH"[number], (0.5 * width, 0.5 * height + 0.076 * canvas.density),
           0.215 * canvas.density, tone, weight=900, centred=True)  # fmt: skip
    for corner_x in (0.2, 0.8):
        for corner_y in (0.2, 0.8):
            spot = np.hypot(x - corner_x, y - corner_y)
            wood[np.abs(spot - 0.03) < 0.008] = tone
    grain = canvas.noise((0.25, 0.004), 2, gain=0.9)
    rounded = 0.72 + 0.28 * step(edge.astype(np.float32), 0.015, 0.015)
    return shaded(wood, np.clip(rounded * (1 + 0.05 * grain), 0.4, 1.3).astype(np.float32))


PAINTERS: dict[str, Callable[[Canvas, int], Picture]] = {
    "wall": _wall,
    "floor": _floor,
    "rug": _rug,
    "column": _column,
    "plinth": _plinth,
    "plinth_top": _plinthtop,
    "shelf": _shelf,
    "painting": _painting,
    "page": _page,
    "chart": _chart,
    "can": _can,
    "lid": _lid,
    "rod": _rod,
    "globe": _globe,
    "stand": _stand,
    "stand_top": _standtop,
    "ball": _ball,
    "card": _card,
    "string": _string,
    "cube": _cube,
}
