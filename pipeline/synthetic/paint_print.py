"""Painters of what can be read or looked at: books, painting, newspaper, test chart."""

from __future__ import annotations

import math

import cv2
import numpy as np

from pipeline.synthetic.patterns import (
    Canvas,
    Picture,
    blended,
    coordinates,
    letter,
    noise,
    plain,
    ramp,
    shaded,
    step,
    turned,
    wood,
)

INK = (56, 53, 60)

NEWS = (
    "Eight cameras stand in a row and look at one still life. Each of them sees coarse pixels "
    "only, yet no two see the same: between the pixels of one lie the pixels of another. Who "
    "knows where every pixel belongs may lay them all on a finer grid and read what none of the "
    "cameras could. Depth tells where they belong. The globe turns, the cube dances, a ball "
    "bounces past; the boards, the marble and the books stand still and wait to be sharpened. "
)

TITLES = (
    "OPTICS", "Parallax", "A ROOM IN DEPTH", "Spline Tales", "FOURIER", "The Lens", "NYQUIST",
    "Stereo & Sons", "ON GRIDS", "Moving Pictures", "ATLAS III", "Inverse Problems", "LIGHT",
    "Eight Eyes", "KRIGING", "Half a Pixel", "SEVEN BOXES", "Aliasing", "The Far Wall", "MIRA",
)  # fmt: skip


def shelf(canvas: Canvas, number: int) -> Picture:
    """A case with three rows of books."""
    height, width = canvas.shape
    chance = canvas.chance()
    scale = canvas.density
    picture = wood(canvas, (78, 48, 28), (146, 98, 60))
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
        picture[bottom : bottom + board] = wood(
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


def painting(canvas: Canvas, number: int) -> Picture:
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
        (
            (0.1, (62, 38, 14)),
            (0.5, (156, 112, 44)),
            (0.85, (222, 184, 96)),
            (1.2, (255, 240, 190)),
        ),
    )
    return np.where((edge < 1)[..., None], gilt, picture)


def page(canvas: Canvas, number: int) -> Picture:
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
    scene = painting(photo, 0)
    grey = cv2.cvtColor(scene, cv2.COLOR_RGB2GRAY)
    y0, x0 = round(0.29 * scale), margin
    window = picture[y0 : y0 + grey.shape[0], x0 : x0 + grey.shape[1]]
    window[:] = cv2.merge([grey] * 3)[: window.shape[0], : window.shape[1]]
    columns = 3
    pitch = (width - 2 * margin + 0.02 * scale) / columns
    wide = pitch - 0.02 * scale
    line = 0.0245 * scale
    size = 0.0215 * scale
    words = NEWS.split()
    word = 0
    for column in range(columns):
        x_left = margin + column * pitch
        y = (0.315 if x_left > x0 + grey.shape[1] - 0.3 * wide else 0.572) * scale
        while y < height - 0.03 * scale:
            x = x_left
            while x < x_left + wide - 0.02 * scale:
                text = words[word % len(words)]
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


def chart(canvas: Canvas, number: int) -> Picture:
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
