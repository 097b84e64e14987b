"""Where patches were in another picture: found to a fraction of a pixel, and where asked for."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.temporal.flow import flow_of

HEIGHT, WIDTH = 96, 128


def _texture(seed):
    noise = np.random.default_rng(seed).normal(0, 1, (HEIGHT, WIDTH))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return (128 + 40 * smooth / smooth.std()).astype(np.float32)


def _moved(image, x, y):
    """Return the image whose content has moved by (x, y)."""
    matrix = np.array([[1, 0, x], [0, 1, y]], float)
    size = image.shape[::-1]
    return cv2.warpAffine(
        image, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )  # fmt: skip


ALL = np.ones((HEIGHT, WIDTH), np.bool_)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.4, -0.3), (3.7, 2.2), (-9.5, 6.0)])
def test_motion_is_found_to_a_fraction_of_a_pixel(x, y):
    before = _texture(1)
    noise = np.random.default_rng(2).normal(0, 2, before.shape).astype(np.float32)
    found = flow_of(_moved(before, x, y) + noise, before, ALL)[16:-16, 16:-16]
    away = np.hypot(found[..., 0] + x, found[..., 1] + y)
    assert np.median(away) < 0.1
    assert np.quantile(away, 0.9) < 0.25


def test_it_does_not_matter_how_bright_a_picture_is():
    before = _texture(1)
    now = _moved(before, 2.5, 1.0)
    found, brighter = flow_of(now, before, ALL), flow_of(now + 30, before, ALL)
    np.testing.assert_allclose(found[16:-16, 16:-16], brighter[16:-16, 16:-16], atol=0.2)


def test_two_things_move_each_its_way():
    before, wall = _texture(1), _texture(2)
    wall[20:70, 20:60] = before[20:70, 20:60]
    now = wall.copy()
    now[20:70, 20:60] = _texture(2)[20:70, 20:60]
    now[24:74, 26:66] = before[20:70, 20:60]
    found = flow_of(now, wall, ALL)
    inside, outside = found[34:64, 36:56], found[20:80, 90:120]
    assert np.abs(inside - [-6, -4]).max() < 0.2
    assert np.abs(outside).max() < 0.1


def test_nothing_is_said_of_what_is_not_asked_for():
    before = _texture(1)
    wanted = np.zeros_like(ALL)
    wanted[40:56, 40:56] = True
    found = flow_of(_moved(before, 2.0, 0.0), before, wanted)
    assert np.abs(found[44:52, 44:52] - [-2, 0]).max() < 0.2
    found[30:66, 30:66] = 0
    assert not found.any()
    assert not flow_of(before, before, np.zeros_like(ALL)).any()


@pytest.mark.parametrize("shape", [(1, 1), (7, 40), (8, 8), (9, 31), (17, 33)])
def test_pictures_of_any_size_have_a_flow(shape):
    picture = _texture(1)[: shape[0], : shape[1]].copy()
    found = flow_of(picture, picture, np.ones(shape, np.bool_))
    assert found.shape == (*shape, 2)
    assert np.isfinite(found).all()


def test_what_comes_from_beyond_the_edge_is_looked_for_no_farther_than_that():
    before = _texture(1)
    found = flow_of(_texture(5), before, ALL)
    assert np.isfinite(found).all()
    assert np.abs(found).max() < max(HEIGHT, WIDTH)
