"""What goes on changing all over is told from noise, from light and from what only moves."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.changes import filmed
from pipeline.config import Settings
from pipeline.frames import MultiViewFrame, View
from pipeline.noise import estimate_noise
from pipeline.superresolve.memory import Memory
from pipeline.synthetic import SampleScene
from pipeline.temporal.drift import (
    FIRST,
    KEPT,
    SPAN,
    changed_at_once,
    detail_of,
    goes_on_changing,
    share_noise,
)
from tests.pipeline.temporal.noisy import noisy

NOISE = 2.0
HEIGHT, WIDTH = 120, 160


def _picture(seed, smoothness=1.5):
    coarse = np.random.default_rng(seed).uniform(40, 210, (HEIGHT, WIDTH)).astype(np.float32)
    return cv2.GaussianBlur(coarse, (0, 0), smoothness)


GROUND, OTHER = _picture(0), _picture(1)
FINE = _picture(0, smoothness=0.8)
SEEN = SampleScene(width=WIDTH, height=HEIGHT, num_views=2).frame(0).views[0].luma


def _shifted(pixels, picture=GROUND):
    step = np.array([[1, 0, -pixels], [0, 1, 0]], np.float32)
    return cv2.warpAffine(
        picture, step, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def _details(shown, count, noise=NOISE):
    chance = np.random.default_rng(2)
    return [
        detail_of((shown(number) + chance.normal(0, noise, GROUND.shape)).astype(np.float32))
        for number in range(count)
    ]


DRIFTS = {
    "dissolve": lambda number: GROUND + (OTHER - GROUND) * number / 60,
    "pan": lambda number: _shifted(0.05 * number),
    "focus": lambda number: cv2.GaussianBlur(GROUND, (0, 0), 0.4 + 0.1 * number),
    "fade": lambda number: GROUND * (1 - number / 40),
}


@pytest.mark.parametrize("kind", DRIFTS)
@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_what_changes_all_over_is_noticed(kind, noise):
    assert goes_on_changing(_details(DRIFTS[kind], KEPT + 2, noise), noise)


def _found_through_a_codec(shown, quality):
    """Return frame by frame whether the picture goes on changing."""
    details, found = [], []
    for luma in filmed(noisy(shown(number) for number in range(18)), quality):
        details.append(detail_of(luma))
        found.append(goes_on_changing(details, estimate_noise(luma)))
    return found


@pytest.mark.parametrize("quality", [18, 23])
def test_what_a_codec_leaves_of_noise_is_no_drift(quality):
    """It stays for some frames, and changes as slowly as what drifts: at first it is coarser."""
    found = _found_through_a_codec(lambda _: GROUND, quality)
    assert sum(found[:6]) <= 2
    assert not any(found[6:])


@pytest.mark.parametrize("quality", [18, 23])
def test_a_drift_is_noticed_through_a_codec(quality):
    found = _found_through_a_codec(lambda number: _shifted(0.15 * number), quality)
    assert all(found[5:])


@pytest.mark.parametrize("quality", [18, 23])
@pytest.mark.parametrize(
    "blur", [lambda number: 0.05 * (number + 1), lambda number: 1 - 0.05 * number]
)
def test_a_slow_pull_of_the_focus_is_noticed_through_a_codec(blur, quality):
    """The finest goes on changing with it, as a codec's noise does; contrast tells."""
    found = _found_through_a_codec(
        lambda number: cv2.GaussianBlur(FINE, (0, 0), blur(number)), quality
    )
    assert sum(found[8:]) >= 8


@pytest.mark.parametrize("quality", [18, 23])
@pytest.mark.parametrize(
    "light",
    [
        lambda number: FINE * (1 + 0.003 * number),
        lambda number: FINE * (1 - 0.003 * number),
        lambda number: FINE - 0.3 * number,
    ],
)
def test_slow_light_through_a_codec_is_no_drift(light, quality):
    """A gain changes contrast, too, but as much as light."""
    found = _found_through_a_codec(light, quality)
    assert not any(found[6:])


@pytest.mark.parametrize("pixels", [0.28, 0.4])
def test_what_changes_at_once_is_noticed_in_the_third_frame(pixels):
    """Of three frames two changes share the noise of the second, which is taken into account."""
    details = _details(lambda number: _shifted(pixels * number), 3)
    assert not goes_on_changing(details[:2], NOISE)
    assert goes_on_changing(details, NOISE)


@pytest.mark.parametrize("noise", [0.0, 1.0, NOISE, 5.0])
def test_noise_and_slow_light_are_no_drift(noise):
    """Light that changes slowly as a whole does no harm: what is averaged follows it."""
    details = _details(lambda number: GROUND * (1 + 0.003 * number), 24, noise)
    for last in range(1, len(details) + 1):
        assert not goes_on_changing(details[:last], noise)


def test_what_moves_over_half_of_the_picture_is_no_drift():
    def shown(number):
        return np.where(np.arange(WIDTH) < WIDTH // 2, _shifted(0.3 * number), GROUND)

    details = _details(shown, 16)
    for last in range(1, len(details) + 1):
        assert not goes_on_changing(details[:last], NOISE)


def test_once_it_stands_still_it_is_still_after_the_span():
    details = _details(lambda number: _shifted(0.3 * min(number, 6)), 8 + SPAN)
    assert goes_on_changing(details[:7], NOISE)
    assert not goes_on_changing(details[: 8 + SPAN], NOISE)


def test_of_a_picture_with_few_blocks_nothing_is_said():
    details = [detail_of(_shifted(0.05 * number)[:48, :80]) for number in range(KEPT)]
    assert not goes_on_changing(details, NOISE)
    assert not share_noise(details, NOISE)
    assert not changed_at_once(details, _shifted(0.0)[:48, :80], 1.0, NOISE)


@pytest.mark.parametrize("kind", [*DRIFTS, "nothing"])
@pytest.mark.parametrize("noise", [1.0, NOISE, 5.0])
def test_frames_of_a_camera_have_their_own_noise(kind, noise):
    details = _details(DRIFTS.get(kind, lambda _: GROUND), 4, noise)
    for last in range(1, len(details) + 1):
        assert not share_noise(details[:last], noise)


def _at_once(shown, noise, frames):
    """Return whether a picture has changed at once since the mean of some frames before it."""
    chance = np.random.default_rng(2)
    *before, now = (
        (shown(number) + chance.normal(0, noise, GROUND.shape)).astype(np.float32)
        for number in [0] * frames + [1]
    )
    details = [detail_of(before[-1]), detail_of(now)]
    return changed_at_once(details, np.mean(before, axis=0), frames, noise)


@pytest.mark.parametrize("noise", [0.0, 1.0, NOISE])
@pytest.mark.parametrize(("pixels", "frames"), [(0.4, 1), (0.25, 4)])
def test_what_changes_much_from_one_frame_to_the_next_has_changed_at_once(noise, pixels, frames):
    """A mean of several frames has less noise to hide it."""
    assert _at_once(lambda number: _shifted(pixels * number), noise, frames)


@pytest.mark.parametrize("noise", [0.0, 1.0, NOISE, 5.0])
@pytest.mark.parametrize("frames", [1, 4])
def test_noise_light_and_what_moves_over_half_of_the_picture_are_no_change_at_once(noise, frames):
    half = np.arange(WIDTH) < WIDTH // 2
    for shown in (
        lambda _: GROUND,
        lambda number: GROUND * (1 + 0.003 * number),
        lambda number: np.where(half, _shifted(3 * number), GROUND),
    ):
        assert not _at_once(shown, noise, frames)


def test_frames_without_noise_share_none():
    assert not share_noise(_details(lambda _: GROUND, 2, 0.0), 0.0)


@pytest.mark.parametrize("quality", [18, 23])
@pytest.mark.parametrize("pixels", [0.0, 0.06])
def test_the_first_frames_that_a_codec_leaves_share_their_noise(pixels, quality):
    """Its first one has most bits, and what follows repeats most of it."""
    shown = noisy(_shifted(pixels * number, SEEN) for number in range(FIRST))
    film = filmed(shown, quality)
    details = [detail_of(luma) for luma in film]
    for last in range(2, FIRST + 1):
        assert share_noise(details[:last], estimate_noise(film[last - 1]))


def test_another_size_is_another_picture():
    details = _details(DRIFTS["pan"], KEPT)
    others = [detail_of(GROUND[:100]) for _ in details[1:]]
    assert not goes_on_changing([*others, details[-1]], NOISE)


@pytest.mark.parametrize(("step", "noticed"), [(1, True), (2, False)])
def test_only_frames_that_follow_one_another_tell(step, noticed):
    """Of a stream that lets frames out, changes in unlike times would be compared."""
    memory, found = Memory(), []
    for number in range(0, 10 * step, step):
        luma = _shifted(0.3 * number)
        views = tuple(View(view_id=name, luma=luma) for name in "lr")
        frame = MultiViewFrame(frame_index=number, views=views, left="l", right="r")
        found.append(memory.seen.drifts(frame, ("l", "r"), 0.0))
    assert any(found) == noticed


def _frame(number, noise):
    chance = np.random.default_rng(number)
    views = tuple(
        View(
            view_id=name,
            luma=(_shifted(0.3 * number) + chance.normal(0, level, GROUND.shape)).astype(
                np.float32
            ),
        )
        for name, level in zip("abcd", noise, strict=True)
    )
    return MultiViewFrame(frame_index=number, views=views, left="b", right="c")


def test_where_all_moves_the_noise_is_that_of_the_frame_itself():
    """Of a chain's other frames, one view is looked at in each."""
    memory, settings, names = Memory(), Settings(), ("a", "b", "c", "d")
    seen = memory.seen
    seen.noise(_frame(0, (3.0, 3.0, 3.0, 3.0)), settings, names)
    later = _frame(1, (2.5, 2.5, 2.5, 2.5))
    assert seen.noise(later, settings, names) > 2.7
    memory.move()
    assert seen.noise(later, settings, names) == Memory().seen.noise(later, settings, names)


def _frames_that_begin_apart(noisy_ground, given=None):
    """Return frame by frame whether it is to be computed as if all drifted."""
    seen, settings, found = Memory().seen, Settings(noise_sigma=given), []
    for number in range(6):
        views = tuple(View(view_id=name, luma=noisy_ground(name, number)) for name in "lr")
        frame = MultiViewFrame(frame_index=number, views=views, left="l", right="r")
        noise = seen.noise(frame, settings, ("l", "r"))
        assert not seen.drifts(frame, ("l", "r"), noise)
        found.append(seen.begins_apart(frame, ("l", "r"), noise))
        seen = seen.begun_again() if number == 3 else seen
    return found


@pytest.mark.parametrize("given", [None, NOISE, 2 * NOISE])
def test_of_a_chain_only_the_first_frames_are_taken_to_share_their_noise(given):
    """Once means are of several frames they are better than a frame, whatever noise stays."""
    found = _frames_that_begin_apart(lambda name, _: _noisy_ground(name), given)
    assert found == [False, True, True, False, False, False]


@pytest.mark.parametrize("noise", [0.2, NOISE])
def test_frames_of_less_noise_than_is_given_do_not_share_it(noise):
    found = _frames_that_begin_apart(
        lambda name, number: _noisy_ground(name, noise, number), given=2 * NOISE
    )
    assert not any(found)


def _noisy_ground(name, noise=NOISE, number=0):
    chance = np.random.default_rng([ord(name), number])
    return (GROUND + chance.normal(0, noise, GROUND.shape)).astype(np.float32)
