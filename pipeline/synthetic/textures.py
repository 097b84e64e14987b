"""What the surfaces of the sample scene look like: one painter for each, all procedural.

A mixture as in photographs: smooth shades, marble and wood, print in many
sizes, ornament, and detail down to single texels. A painter takes a
:class:`Canvas` and a number and returns a picture; sizes in painters are metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.synthetic import paint_print, paint_room, paint_things
from pipeline.synthetic.patterns import Canvas, Picture, plain


def unpainted(canvas: Canvas, number: int) -> Picture:
    """One grey, 128: for surfaces whose texture does not matter."""
    return plain(canvas.shape, (128, 128, 128))


PAINTERS: dict[str, Callable[[Canvas, int], Picture]] = {
    "plain": unpainted,
    "wall": paint_room.wall,
    "floor": paint_room.floor,
    "rug": paint_room.rug,
    "column": paint_room.column,
    "plinth": paint_room.plinth,
    "plinth_top": paint_room.plinthtop,
    "shelf": paint_print.shelf,
    "painting": paint_print.painting,
    "page": paint_print.page,
    "chart": paint_print.chart,
    "can": paint_things.can,
    "lid": paint_things.lid,
    "rod": paint_things.rod,
    "globe": paint_things.globe,
    "stand": paint_things.stand,
    "stand_top": paint_things.standtop,
    "ball": paint_things.ball,
    "card": paint_things.card,
    "string": paint_things.string,
    "cube": paint_things.cube,
}


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
