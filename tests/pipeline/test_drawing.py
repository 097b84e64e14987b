"""Text on pictures: alike, whoever wrote before."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline import drawing


def _ink(size: int) -> float:
    """Return the share of its own height squared that a word blackens."""
    canvas = drawing.blank(80, 320)
    drawing.draw_text(canvas, "HEMd", 5, 60, size=size)
    return float((canvas.astype(float) - 255).sum()) / size**2


@pytest.mark.parametrize(("size", "before"), [(51, 900), (52, 200)])
def test_letters_are_as_fat_whoever_wrote_before(size, before):
    wanted = _ink(50)
    face = cv2.FontFace("sans")
    cv2.putText(np.zeros((80, 80, 3), np.uint8), "q", (5, 60), (255,) * 3, face, size, before)
    assert _ink(size) == pytest.approx(wanted, rel=0.08)
