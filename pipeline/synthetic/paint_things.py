"""Painters of the smaller things: tin, stick, globe, ball, card, block."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.synthetic.patterns import (
    Canvas,
    Picture,
    around,
    blended,
    coordinates,
    letter,
    noise,
    ramp,
    shaded,
    step,
    wood,
)

PAPER = (236, 229, 212)


def can(canvas: Canvas, number: int) -> Picture:
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


def lid(canvas: Canvas, number: int) -> Picture:
    """A lid of turned brass."""
    x, y = coordinates(canvas.shape)
    radius, angle = np.hypot(x - 0.5, y - 0.5) * 2, np.arctan2(y - 0.5, x - 0.5)
    turned_ = noise((1, 2048), 40.0, (*canvas.seed, 1), gain=0.95)[0]
    groove = turned_[np.clip(radius * 1200, 0, 2047).astype(int)]
    sheen = 0.5 * np.cos(2 * angle + 0.7) + 0.3 * np.cos(4 * angle)
    rim = -1.6 * step(-np.abs(radius - 0.86), -0.03, 0.012) + 1.0 * step(radius, 0.9, 0.02)
    value = (0.30 * groove + 0.5 * sheen + rim).astype(np.float32)
    return ramp(
        value,
        ((-2, (70, 48, 22)), (-0.3, (166, 128, 66)), (0.8, (230, 200, 130)), (2, (255, 246, 214))),
    )


def rod(canvas: Canvas, number: int) -> Picture:
    """A stick with a spiral band."""
    x, y = coordinates(canvas.shape)
    turns = x + y * 26
    band = step(np.abs(turns % 1 - 0.5), 0.25, 0.03)
    grain = canvas.noise((0.01, 0.1), 1, gain=0.85)
    red = ramp(grain, ((-3, (140, 24, 26)), (3, (204, 54, 44))))
    white = ramp(grain, ((-3, (206, 198, 182)), (3, (248, 244, 232))))
    return blended(red, white, np.ascontiguousarray(np.broadcast_to(band, canvas.shape)))


def globe(canvas: Canvas, number: int) -> Picture:
    """Continents, seas, a net of degrees, names."""
    height, width = canvas.shape
    _, y = coordinates(canvas.shape)
    land = around(canvas.noise(0.85, 7, gain=0.58)) + 0 * y
    level = 0.8 * land - 0.06 + 0.25 * np.abs(y - 0.5)
    relief = around(canvas.noise(0.10, 8, gain=0.85))
    sea = ramp(
        level + 0.05 * relief,
        (
            (-2.2, (18, 52, 104)),
            (-0.5, (38, 92, 146)),
            (-0.08, (92, 156, 186)),
            (0, (176, 210, 206)),
        ),
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
        dot = (round(spot[0] - 0.012 * canvas.density), round(spot[1] - size / 4))
        radius = max(1, round(0.006 * canvas.density))
        cv2.circle(picture, dot, radius, (180, 40, 36), -1, cv2.LINE_AA)
    cap = step(np.abs(y - 0.5), 0.425, 0.01)
    rings = 0.5 + 0.5 * np.cos(np.abs(y - 0.5) * 260)
    picture = blended(
        picture, (236, 238, 240), np.ascontiguousarray(np.broadcast_to(cap, canvas.shape))
    )
    return shaded(
        picture,
        np.ascontiguousarray(np.broadcast_to(1 - 0.12 * cap * rings, canvas.shape), np.float32),
    )


def stand(canvas: Canvas, number: int) -> Picture:
    """Turned wood, dark."""
    _, y = coordinates(canvas.shape)
    gain = (0.8 + 0.4 * np.abs(np.sin(y * 9))).astype(np.float32)
    turned_wood = wood(canvas, (50, 28, 18), (122, 74, 44))
    return shaded(turned_wood, np.ascontiguousarray(np.broadcast_to(gain, canvas.shape)))


def standtop(canvas: Canvas, number: int) -> Picture:
    """Wood like that of the stand's side."""
    return wood(canvas, (58, 34, 22), (132, 82, 50))


def ball(canvas: Canvas, number: int) -> Picture:
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


def card(canvas: Canvas, number: int) -> Picture:
    """A printed card: guilloche, rosette, a large figure."""
    height, width = canvas.shape
    x, y = coordinates(canvas.shape)
    px, py = (x - 0.5) * 2 * width / height, (y - 0.5) * 2
    radius, angle = np.hypot(px, py), np.arctan2(py, px)
    paper = np.ascontiguousarray(np.broadcast_to(y + 0.3 * x, canvas.shape), np.float32)
    picture = ramp(paper, ((0, (250, 232, 196)), (0.6, (244, 206, 178)), (1.3, (206, 190, 222))))
    for waves, turns, colour in ((9, 46, (44, 96, 120)), (-7, 40, (166, 60, 84))):
        line = np.sin(turns * radius + 1.9 * np.sin(waves * angle) * (0.3 + radius))
        width_ = 0.32 * np.clip(turns / height * 4, 0.15, 1)
        picture = blended(
            picture,
            colour,
            (0.62 * step(line, 0.72, width_) * step(radius, 0.40, 0.01)).astype(np.float32),
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


def string(canvas: Canvas, number: int) -> Picture:
    """Twine."""
    x, y = coordinates(canvas.shape)
    twist = np.ascontiguousarray(np.broadcast_to(np.sin(2 * np.pi * (x + 40 * y)), canvas.shape))
    return ramp(twist.astype(np.float32), ((-1, (120, 92, 58)), (1, (212, 184, 136))))


def cube(canvas: Canvas, number: int) -> Picture:
    """A toy block with a letter."""
    height, width = canvas.shape
    x, y = coordinates(canvas.shape)
    tone = ((206, 60, 48), (52, 112, 176), (236, 176, 56), (64, 140, 84), (150, 84, 160))[number]
    block = ramp(
        canvas.noise((0.25, 0.006), 1, gain=0.85),
        ((-3, (186, 146, 96)), (0, (226, 192, 140)), (3, (248, 226, 184))),
    )
    edge = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y))
    block[edge < 0.10] = (np.array(tone) * 0.94).astype(np.uint8)
    block[(edge > 0.125) & (edge < 0.145)] = tone
    letter(block, "DEPTH"[number], (0.5 * width, 0.5 * height + 0.076 * canvas.density),
           0.215 * canvas.density, tone, weight=900, centred=True)  # fmt: skip
    for corner_x in (0.2, 0.8):
        for corner_y in (0.2, 0.8):
            spot = np.hypot(x - corner_x, y - corner_y)
            block[np.abs(spot - 0.03) < 0.008] = tone
    grain = canvas.noise((0.25, 0.004), 2, gain=0.9)
    rounded = 0.72 + 0.28 * step(edge.astype(np.float32), 0.015, 0.015)
    return shaded(block, np.clip(rounded * (1 + 0.05 * grain), 0.4, 1.3).astype(np.float32))
