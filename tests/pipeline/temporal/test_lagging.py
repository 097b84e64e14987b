"""What changes little by little is noticed where it does, and not mistaken for noise or motion."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.changes import filmed
from pipeline.noise import estimate_noise
from pipeline.temporal.lagging import TILE, has_few_tiles, much_lags, tile_pixels, tiles_of
from pipeline.temporal.still import first_seen, seen_again
from tests.pipeline.temporal.noisy import noisy

HEIGHT, WIDTH = 200, 300
PART = 100
"""Width of what changes."""


def _picture(seed, height=HEIGHT, width=WIDTH):
    coarse = np.random.default_rng(seed).uniform(40, 210, (height, width)).astype(np.float32)
    return cv2.GaussianBlur(coarse, (0, 0), 1.5)


GROUND, OTHER = _picture(0), _picture(1)


def _seen(shown, count, noise):
    """Yield what is known of a picture after each frame but the first."""
    chance, still = np.random.default_rng(2), None
    for number in range(count):
        luma = (shown(number) + chance.normal(0, noise, GROUND.shape)).astype(np.float32)
        still = first_seen(luma) if still is None else seen_again(luma, still, noise)
        if number:
            yield still


def _dissolved_in_part(number):
    part = np.arange(WIDTH) < PART
    return GROUND + (OTHER - GROUND) * part * np.float32(number / 60)


@pytest.mark.parametrize("noise", [0.0, 1.0, 2.0, 5.0])
def test_where_nothing_or_light_alone_changes_nothing_lags(noise):
    for shown in (lambda number: GROUND, lambda number: GROUND + np.float32(0.1 * number)):
        assert not any(still.lagging.any() for still in _seen(shown, 16, noise))


@pytest.mark.parametrize("noise", [0.0, 0.5, 1.0, 2.0])
def test_what_lags_is_noticed_where_it_does_and_begins_anew(noise):
    seen = np.zeros(tiles_of(GROUND.shape), bool)
    for still in _seen(_dissolved_in_part, 12, noise):
        seen |= still.lagging
        assert still.changed[still.begun].all()
        assert (still.count[still.begun] == 1).all()
    inside = PART // TILE
    assert seen[:, :inside].mean() > 0.8
    assert not seen[:, inside + 1 :].any()


def test_a_mean_that_begins_anew_stays_near_what_is_shown():
    """Of what dissolves, the mean of four frames alone would lag by three frames' change."""
    for still in _seen(_dissolved_in_part, 16, 2.0):
        last = still
    away = cv2.GaussianBlur(last.mean - _dissolved_in_part(15), (0, 0), 0.7)
    assert np.square(away[:, :PART]).mean() < np.square(away[:, PART:]).mean() + 0.4


@pytest.mark.parametrize("noise", [0.0, 1.0, 2.0])
def test_what_has_lagged_is_asked_a_frame_sooner(noise):
    """What goes on dissolving begins anew in every second frame; once it stands still it is."""
    stop = 14

    def shown(number):
        part = np.arange(WIDTH) < PART
        return GROUND + (OTHER - GROUND) * part * np.float32(min(number, stop) / 20)

    inside = PART // TILE
    lagged = np.array([still.lagging[:, :inside] for still in _seen(shown, 26, noise)])
    again = lagged[4 : stop - 2] & lagged[6:stop] & ~lagged[5 : stop - 1]
    assert again.any(axis=0).mean() > 0.8
    assert not lagged[stop + 4 :].any()


def test_a_slow_pull_of_the_focus_lags_all_over():
    def shown(number):
        return cv2.GaussianBlur(GROUND, (0, 0), 0.4 + 0.06 * number)

    found = list(_seen(shown, 12, 2.0))
    assert any(still.lagging.all() for still in found)
    first = next(place for place, still in enumerate(found) if still.lagging.any())
    assert any(still.begins_to_lag for still in found[: first + 1])


def test_what_moves_before_something_does_not_lag():
    """Only what seems to stand still is asked."""

    def shown(number):
        picture = GROUND.copy()
        left = 20 + 3 * number
        picture[60:120, left : left + 50] = OTHER[60:120, :50]
        return picture

    assert not any(still.lagging.any() for still in _seen(shown, 16, 2.0))


def test_a_small_picture_of_which_much_lags_keeps_its_means():
    """They tell in the next frame whether it still changes."""
    assert has_few_tiles((96, 128))
    assert not has_few_tiles((192, 256))
    ground, other = _picture(0, 96, 128), _picture(1, 96, 128)
    chance, still, lagged = np.random.default_rng(3), None, []
    for number in range(24):
        share = np.float32(min(number, 12) / 80)
        luma = (ground + (other - ground) * share + chance.normal(0, 2.0, ground.shape)).astype(
            np.float32
        )
        still = first_seen(luma) if still is None else seen_again(luma, still, 2.0)
        lagged.append(much_lags(still.lagging))
        if number > 3:
            assert still.count.mean() > 3
    assert all(lagged[7:13])
    assert not any(lagged[18:])


def test_every_pixel_lies_in_a_tile():
    """Those at the ends are larger; a picture smaller than a tile is one."""
    tiles = np.zeros(tiles_of((70, 100)), bool)
    assert tiles.shape == (2, 3)
    tiles[1, 2] = True
    pixels = tile_pixels(tiles, (70, 100))
    assert pixels[32:, 64:].all()
    assert pixels.sum() == (70 - 32) * (100 - 64)
    assert tiles_of((20, 30)) == (1, 1)


@pytest.mark.parametrize("quality", [8, 18, 23])
def test_what_a_codec_leaves_of_noise_does_not_lag(quality):
    """It stays from frame to frame, where what is coded stands still."""
    still = None
    for luma in filmed(noisy(GROUND for _ in range(16)), quality):
        noise = estimate_noise(luma)
        still = first_seen(luma) if still is None else seen_again(luma, still, noise)
        assert not still.lagging.any()
        assert not still.begins_to_lag


@pytest.mark.parametrize("quality", [18, 23])
def test_what_lags_is_noticed_through_a_codec(quality):
    still, seen = None, np.zeros(tiles_of(GROUND.shape), bool)
    shown = noisy(_dissolved_in_part(number) for number in range(12))
    for luma in filmed(shown, quality):
        noise = estimate_noise(luma)
        still = first_seen(luma) if still is None else seen_again(luma, still, noise)
        seen |= still.lagging
    inside = PART // TILE
    assert seen[:, :inside].mean() > 0.5
    assert not seen[:, inside + 1 :].any()


def test_noise_hides_no_lag_from_a_mean_of_which_old_frames_fade():
    """A new frame that joins such a mean takes its own noise with it into the next difference."""

    def shown(number):
        return GROUND + (OTHER - GROUND) * np.float32(max(0, number - 8) / 150)

    found = list(_seen(shown, 24, 2.0))
    assert not any(still.lagging.any() for still in found[:8])
    assert any(still.lagging.all() for still in found[8:])
