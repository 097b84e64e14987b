"""The test of stereo acuity, by an assessor who knows nothing but what is on the screen."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import pytest

from dscqs.displays import profile_from_dict
from tests.service.dscqs_pages.exports import document_of
from tests.support.assessor_page import AssessorPage
from tests.support.stereo import light_of, shift_between

SCREEN = profile_from_dict(
    {"title": "two halves", "mode": "sbs-full", "width_px": 1200, "height_px": 400,
     "distance_heights": 3, "pixel_pitch_mm": 0.25}
)  # fmt: skip
SHOWN, TOO_FINE = [160, 100, 63, 50, 40, 32, 26, 20], [16, 12.5]
"""Seconds of arc: at a distance of 1200 pixels, 20 is 0.12 pixels, and 16 less than 0.1."""

MIDDLES = (120, 300, 480)
"""Columns of one eye where the middles of the three squares are; all are in row 180."""


@dataclass
class Eyes:
    """An assessor who sees depth down to ``finest`` seconds of arc, and guesses below."""

    seat: AssessorPage
    finest: float
    chance: random.Random = field(default_factory=lambda: random.Random(3))
    seen: list[tuple[float, bool]] = field(default_factory=list)
    """Of each picture, how far a square lay in front, and whether the answer was right."""

    def choose(self, angles: list[float]) -> int:
        front = int(np.argmax(angles))
        return front if angles[front] >= 0.9 * self.finest else self.chance.randrange(3)

    def answer_all(self) -> None:
        """Look at one picture after the other, and answer by key or click until it is over."""
        for number in itertools.count():
            self.seat.wait_until_drawn(2 * number + 1)
            angles = self.look()
            chosen = self.choose(angles)
            if number % 2:
                self.seat.page.keyboard.press(str(chosen + 1))
            else:
                self.seat.page.mouse.click(MIDDLES[chosen], 180)
            self.seen.append((max(angles), chosen == int(np.argmax(angles))))
            self.seat.wait_until_drawn(2 * number + 2)
            if not self.seen[-1][1] or len(self.seen) == 3 * len(SHOWN):
                return

    def look(self) -> list[float]:
        """Return how far each square lies in front, in seconds of arc."""
        rows = {"x": 0, "y": 130, "width": SCREEN.width_px, "height": 100}
        taken = self.seat.page.screenshot(clip=rows)
        eyes = np.split(light_of(cv2.imdecode(np.frombuffer(taken, np.uint8), 0)), 2, axis=1)
        inner = [np.s_[:, middle - 50 : middle + 50] for middle in MIDDLES]
        return [angle_of(shift_between(*(eye[square] for eye in eyes))) for square in inner]


class ExchangedEyes(Eyes):
    """What is in front for others is the last that this assessor takes for it."""

    def choose(self, angles: list[float]) -> int:
        return int(np.argmin(angles))


def angle_of(pixels: float) -> float:
    """Return the angle of a disparity on the screen, in seconds of arc."""
    return math.degrees(math.atan(pixels / (SCREEN.distance_heights * SCREEN.height_px))) * 3600


@pytest.fixture
def sit(make_tab, make_test, operator, served, plan):
    """Return what lets an assessor come to the first picture of the test."""
    served.app.state.desks.real.displays.put("halves", SCREEN)
    test = make_test({**plan, "displays": ["halves"], "stages": ["stereo_acuity"]})

    def sit() -> tuple[str, AssessorPage]:
        size = {"width": SCREEN.width_px, "height": SCREEN.height_px}
        seat = make_tab(viewport=size).open(served.url + operator.invite(test, "a1", "halves"))
        seat.wait_for("stereo-acuity")
        return test, seat

    return sit


def stored_of(operator: Any, test: str) -> dict[str, Any]:
    (session,) = document_of(operator, test)["sessions"]
    return session["forms"]["stereo_acuity"]


def test_the_finest_level_seen_is_recorded(sit, operator):
    """Every level was as far in front as it says; below what is seen, chance alone goes on."""
    test, seat = sit()
    seat.press_main()
    assessor = Eyes(seat, finest=100)
    assessor.answer_all()
    passed = (len(assessor.seen) - 1) // 3  # the last answer was wrong
    assert passed >= 2
    for (angle, _), level in zip(assessor.seen, np.repeat(SHOWN, 3), strict=False):
        assert angle == pytest.approx(level, abs=angle_of(0.03))
    assert [is_right for _, is_right in assessor.seen] == [True] * (len(assessor.seen) - 1) + [
        False
    ]
    seat.page.locator("#page").get_by_text(f"down to {SHOWN[passed - 1]} seconds of arc").wait_for()
    seat.press_main()
    seat.wait_for("ready")
    stored = stored_of(operator, test)
    assert (stored["done"], stored["threshold_arcsec"]) == (True, SHOWN[passed - 1])
    assert stored["not_shown"] == TOO_FINE
    assert [(one["arcsec"], one["front"] == one["chosen"]) for one in stored["trials"]] == [
        (level, is_right)
        for (_, is_right), level in zip(assessor.seen, np.repeat(SHOWN, 3), strict=False)
    ]


def test_dots_are_shown_pixel_by_pixel_and_who_sees_no_depth_fails(sit, operator):
    """Angles follow from pixels: what is scaled, or not on the full screen, does not count."""
    test, seat = sit()
    seat.page.set_viewport_size({"width": SCREEN.width_px + 20, "height": SCREEN.height_px})
    seat.press_main()
    seat.wait_for("display")
    seat.page.set_viewport_size({"width": SCREEN.width_px, "height": SCREEN.height_px})
    seat.press_main()
    seat.wait_until_drawn(1)
    seat.page.evaluate("document.exitFullscreen()")
    seat.wait_for("ready")
    seat.page.evaluate("window.drawn = []")
    seat.press_main()
    assessor = ExchangedEyes(seat, finest=math.inf)
    assessor.answer_all()
    seat.page.locator("#page").get_by_text("not seen at the coarsest level").wait_for()
    seat.press_main()
    seat.wait_for("ready")
    stored = stored_of(operator, test)
    assert (stored["done"], stored["threshold_arcsec"]) == (True, None)
    assert len(stored["trials"]) == len(assessor.seen) == 1
