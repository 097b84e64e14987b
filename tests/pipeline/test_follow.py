"""What moves is followed where each eye is made alone: it gains, and leaves no ghost."""

from __future__ import annotations

import functools

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.effort import Effort
from pipeline.frames import MultiViewFrame, View
from pipeline.metrics import psnr
from pipeline.superresolve.follow import leaders_of
from pipeline.synthetic.observation import blur_and_sample
from pipeline.worker import Worker

HEIGHT, WIDTH = 144, 192
"""Of the HR pictures."""
EYES = ("left", "right")
DISPARITY, NEAR = -3, -7
"""Of the wall and of what moves before it, HR pixels."""
WHOLE, LAST = 2, 9
"""Frames made of all views, and the last one."""


@functools.cache
def _texture(seed, contrast=25.0):
    noise = np.random.default_rng(seed).normal(0, 1, (HEIGHT, WIDTH))
    smooth = sum(
        size * cv2.GaussianBlur(noise, (0, 0), size) * share
        for size, share in ((1.2, 0.5), (3.0, 1.0), (8.0, 1.5))
    )
    return np.clip(128 + contrast * smooth / smooth.std(), 5, 250)


def _moved(picture, x, y=0.0):
    matrix, size = np.array([[1, 0, x], [0, 1, y]], float), (WIDTH, HEIGHT)
    return cv2.warpAffine(
        picture, matrix, size, flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT
    )  # fmt: skip


def _glides(wall, number, beside):
    thing, inside = _texture(2, 35.0), np.zeros((HEIGHT, WIDTH))
    inside[40:100, 50:110] = 1
    at = 1.7 * number + beside, 0.9 * number
    share = np.clip(_moved(inside, *at), 0, 1)
    return wall * (1 - share) + _moved(thing, *at) * share


def _is_cut(wall, number, beside):
    return wall if number < 5 else 255 - wall


def _is_partly_cut(wall, number, beside):
    if number >= 5:
        wall[40:100, 40:100] = _moved(_texture(2), beside)[40:100, 40:100]
    return wall


def _flashes(wall, number, beside):
    if number == 5:
        wall[:, : WIDTH // 3] = np.clip(1.4 * wall[:, : WIDTH // 3] + 10, 0, 255)
    return wall


def _flies(wall, number, beside):
    column = 20 + 15 * number + beside
    wall[70:78, column : column + 8] = 240
    return wall


def _flies_darkly(wall, number, beside):
    column = 20 + 11 * number + beside
    wall[70:82, column : column + 12] = 20
    return wall


def _jumps(wall, number, beside):
    row, column = np.random.default_rng(number).integers(25, HEIGHT - 40, 2)
    wall[row : row + 9, column + beside : column + beside + 9] = 235
    return wall


def _uncovers(wall, number, beside):
    column = 20 + 10 * number + beside
    wall[40:100, column : column + 40] = 90
    return wall


def _shades(wall, number, beside):
    shadow = np.zeros((HEIGHT, WIDTH))
    shadow[40:100, 30 + 6 * number : 80 + 6 * number] = 1
    return wall * (1 - 0.35 * cv2.GaussianBlur(shadow, (0, 0), 4))


HAPPENINGS = (
    _glides, _is_cut, _is_partly_cut, _flashes, _flies, _jumps, _uncovers, _shades,
)  # fmt: skip


def _truth(happens, number, eye):
    wall = _moved(_texture(1), DISPARITY * eye)
    picture = happens(wall, number, (NEAR if happens is not _shades else DISPARITY) * eye)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _frame(happens, number, settings):
    views = []
    for eye, name in enumerate(EYES):
        picture = blur_and_sample(_truth(happens, number, eye), settings.grid, 1.0, 7)
        noise = np.random.default_rng([number, eye]).normal(0, 2, picture.shape)
        luma = np.clip(np.rint(picture + noise), 0, 255).astype(np.float32)
        views.append(View(view_id=name, luma=luma))
    return MultiViewFrame(frame_index=number, views=tuple(views), left=EYES[0], right=EYES[1])


def _pictures(happens, follow, settings, targets=EYES):
    """Return the frames made alone, each a mapping of eyes to pictures."""
    worker = Worker(settings, targets=targets)
    effort = Effort(alone=True, refresh_every=None, follow=follow)
    found = []
    for number in range(LAST + 1):
        frame = _frame(happens, number, settings)
        result = worker.take(frame, effort=effort if number > WHOLE else Effort())
        found.append({name: result.images[name].luma for name in targets})
    return found[WHOLE + 1 :]


def _gains(happens, sampling="decimation", targets=EYES, magnification="2"):
    """Return what following gains, dB, (frames, eyes)."""
    settings = Settings(
        psf_sigma=1.0, noise_sigma=2.0, sampling=sampling, temporal="warm",
        magnification=magnification,
    )  # fmt: skip
    runs = [_pictures(happens, follow, settings, targets) for follow in (True, False)]
    return np.array(
        [
            [
                psnr(first[name], truth, border=12) - psnr(second[name], truth, border=12)
                for name in targets
                for truth in [_truth(happens, number, EYES.index(name)).astype(np.float32)]
            ]
            for number, (first, second) in enumerate(zip(*runs, strict=True), WHOLE + 1)
        ]
    )


@pytest.mark.parametrize(
    ("happens", "sampling"),
    [(happens, "decimation") for happens in HAPPENINGS] + [(_flies, "area"), (_uncovers, "area")],
)
def test_no_frame_is_worse_for_it(happens, sampling):
    assert _gains(happens, sampling).min() > -0.05


@pytest.mark.parametrize(
    ("sampling", "magnification"),
    [("decimation", "2"), ("decimation", "2x1"), ("area", "2x1"), ("area", "1x2")],
)
def test_no_frame_is_worse_where_an_edge_is_found_beside_its_place(sampling, magnification):
    gains = _gains(_flies_darkly, sampling, magnification=magnification)
    assert gains.min() > -0.05
    assert gains.mean() > 0.1


@pytest.mark.parametrize("happens", [_flies, _uncovers, _flashes])
def test_no_frame_of_squeezed_eyes_is_worse_for_it(happens):
    assert _gains(happens, "area", magnification="2x1").min() > -0.05


def test_what_glides_gains_in_squeezed_eyes():
    assert _gains(_glides, magnification="2x1").mean() > 0.25


def test_what_glides_gains_in_both_eyes_and_in_one_alone():
    both, one = _gains(_glides), _gains(_glides, targets=EYES[:1])
    assert both.min() > 0.2
    assert both.mean() > 0.45
    assert one.min() > 0.15


def test_a_cut_is_not_followed():
    settings = Settings(psf_sigma=1.0, noise_sigma=2.0, sampling="decimation", temporal="warm")
    first, second = (
        _pictures(_is_cut, follow, settings)[5 - WHOLE - 1] for follow in (True, False)
    )
    for name in EYES:
        np.testing.assert_array_equal(first[name], second[name])


def test_threads_change_nothing():
    found = [
        _pictures(
            _glides, True,
            Settings(
                psf_sigma=1.0, noise_sigma=2.0, sampling="decimation", temporal="warm",
                threads=threads,
            ),
        )[-1]
        for threads in (1, 3)
    ]  # fmt: skip
    for name in EYES:
        np.testing.assert_array_equal(found[0][name], found[1][name])


def test_each_eye_has_its_turn_to_lead():
    assert leaders_of(("a", "b"), 0) == {"a": None, "b": "a"}
    assert leaders_of(("a", "b"), 1) == {"a": "b", "b": None}
    assert leaders_of(("a",), 1) == {"a": None}
    assert leaders_of(("a", "b", "c"), 0) == {"a": None, "b": "a", "c": None}
