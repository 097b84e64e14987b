"""Warm frames as results: no ghosts of what has gone, and fewer iterations to the same end."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from benchmarks import changes
from pipeline.config import Settings
from pipeline.effort import Effort
from pipeline.metrics import psnr
from pipeline.superresolve import Memory, reconstruct_frame, register_frame
from pipeline.synthetic import SampleScene
from pipeline.worker import Worker
from tests.pipeline.temporal.noisy import noisy

NOISE = 2.0
SCENE = SampleScene(width=128, height=96, num_views=4)
TARGETS = tuple(SCENE.view_ids[number] for number in SCENE.reference_views)
SIDE, STEP = 6, 24
"""Of the small fast thing: its side, and how far it goes from one frame to the next, LR pixels."""


@pytest.fixture(scope="module")
def frames():
    return [SCENE.frame(number, noise_sigma=NOISE) for number in range(4)]


@pytest.fixture(scope="module")
def quiet():
    """The same without noise: what stands still then comes out as it does cold."""
    return [SCENE.frame(number) for number in range(4)]


@pytest.fixture(scope="module")
def larger():
    scene = replace(SCENE, width=160, height=120)
    return scene, scene.frame(0)


def _settings(temporal="warm", **others):
    return Settings(
        psf_sigma=1.0, noise_sigma=NOISE, sampling="decimation", temporal=temporal, **others
    )


def _with_luma(frame, change):
    """Return the frame with every view's picture changed."""
    return replace(
        frame,
        views=tuple(
            replace(view, luma=np.clip(change(view.luma.copy()), 0, 255).astype(np.float32))
            for view in frame.views
        ),
    )


def _observed(scene, still, truth, number):
    """Return a frame in which the views of ``still`` see these HR pictures, with noise."""
    chance = np.random.default_rng(number)
    views = tuple(
        replace(
            view,
            luma=scene.observe(hr_image, noise_sigma=NOISE, noise=chance).astype(np.float32),
        )
        for view, hr_image in zip(still.views, truth, strict=True)
    )
    return replace(still, frame_index=number, views=views)


def _both(frames, number):
    """Return frame ``number`` of a warm chain, and the same one cold."""
    warm = Worker(_settings(), targets=TARGETS)
    for frame in frames[: number + 1]:
        ours = warm.take(frame)
    return ours, Worker(_settings("cold"), targets=TARGETS).take(frames[number])


def _hr_box(left, top, width, height, margin=0):
    """Return the HR pixels of a box of LR pixels, widened by a margin."""
    return (
        slice(max(0, 2 * (top - margin)), 2 * (top + height + margin)),
        slice(max(0, 2 * (left - margin)), 2 * (left + width + margin)),
    )


def test_both_eyes_are_as_good_as_cold_in_every_frame(frames):
    warm, cold = (Worker(_settings(kind), targets=TARGETS) for kind in ("warm", "cold"))
    for number, frame in enumerate(frames):
        ours, other = warm.take(frame), cold.take(frame)
        for target, place in zip(TARGETS, SCENE.reference_views, strict=True):
            picture = SCENE.render_hr(place, number / SCENE.fps)
            truth = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
            scores = [psnr(one.images[target].luma, truth, border=8) for one in (ours, other)]
            assert scores[0] > scores[1] - 0.05


@pytest.mark.parametrize("temporal", ["swift", "warm"])
def test_without_noise_both_eyes_are_as_good_as_cold_in_every_frame(temporal):
    """There is nothing to average: what moves is found as thoroughly as in a cold frame."""
    scene = replace(SCENE, width=192, height=144)
    warm, cold = (
        Worker(replace(_settings(kind), noise_sigma=0.0), targets=TARGETS)
        for kind in (temporal, "cold")
    )
    for number in range(9):
        frame = scene.frame(number)
        ours = warm.take(frame)
        if number < 5:
            continue
        other = cold.take(frame)
        for target, place in zip(TARGETS, scene.reference_views, strict=True):
            picture = scene.render_hr(place, number / scene.fps)
            truth = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
            scores = [psnr(one.images[target].luma, truth, border=8) for one in (ours, other)]
            assert scores[0] > scores[1] - 0.05, number


def test_what_stands_still_is_better_than_cold_and_what_moves_no_worse(frames):
    """The mean of several frames has less noise than one."""
    ours, other = _both(frames, 3)
    still = np.abs(SCENE.frame(3).view(TARGETS[0]).luma - SCENE.frame(2).view(TARGETS[0]).luma)
    moving = cv2.dilate((still > 1).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    moving = moving.repeat(2, 0).repeat(2, 1)
    picture = SCENE.render_hr(SCENE.reference_views[0], 3 / SCENE.fps)
    truth = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    errors = [(one.images[TARGETS[0]].luma - truth) ** 2 for one in (ours, other)]
    gains = [
        10 * np.log10(errors[1][part].mean() / errors[0][part].mean()) for part in (~moving, moving)
    ]
    assert gains[0] > 0.3
    assert gains[1] > -0.15


def test_a_small_fast_thing_leaves_no_ghost_and_is_all_there(quiet):
    """It jumps by four of its sides: nothing of it may stay behind, nothing of it be missing."""

    def places(number):
        return 10 + STEP * number, 40

    def shown(number):
        left, top = places(number)

        def change(luma):
            luma[top : top + SIDE, left : left + SIDE] = 250
            return luma

        return _with_luma(quiet[number], change)

    moving = [shown(number) for number in range(4)]
    ours, other = _both(moving, 3)
    for target in TARGETS:
        difference = np.abs(ours.images[target].luma - other.images[target].luma)
        for number in range(4):
            here = difference[_hr_box(*places(number), SIDE, SIDE, margin=2)]
            assert here.mean() < 2.0, f"where it was in frame {number}"
            assert here.max() < 30.0
        assert psnr(ours.images[target].luma, other.images[target].luma) > 40
    assert all(0.35 < target.start.warm_share < 1 for target in ours.report.targets)


def test_a_flash_in_a_part_of_the_picture_does_not_stay(quiet):
    """A third of the picture flashes in frame 1 and is as before in frame 2."""

    def flash(luma):
        luma[:, 80:] += 70
        return luma

    flashing = [quiet[0], _with_luma(quiet[1], flash), quiet[2]]
    for number in (1, 2):
        ours, other = _both(flashing, number)
        for target in TARGETS:
            difference = ours.images[target].luma - other.images[target].luma
            assert abs(difference[:, 170:].mean()) < 0.3
            assert psnr(ours.images[target].luma, other.images[target].luma) > 40


def test_after_a_cut_nothing_of_the_old_scene_is_seen(quiet):
    """The frame of the cut is the cold one; the next goes on warm from it."""

    def turned(frame):
        return replace(
            frame,
            views=tuple(
                replace(
                    view,
                    luma=np.ascontiguousarray(view.luma[::-1]),
                    depth_map=np.ascontiguousarray(view.depth_map[::-1]),
                )
                for view in frame.views
            ),
        )

    cut = [quiet[0], quiet[1], turned(quiet[2]), turned(quiet[3])]
    ours, other = _both(cut, 2)
    assert all(target.start.is_cut for target in ours.report.targets)
    for target in TARGETS:
        assert np.array_equal(ours.images[target].luma, other.images[target].luma)
    ours, other = _both(cut, 3)
    for target in ours.report.targets:
        assert not target.start.is_cut
        assert target.start.warm_share > 0.35
        assert psnr(ours.images[target.view_id].luma, other.images[target.view_id].luma) > 40


@pytest.mark.parametrize("temporal", ["swift", "warm"])
@pytest.mark.parametrize(
    "changed",
    [
        partial(changes.softer, step=0.15, begin=0.1),
        partial(changes.aside, step=0.1),
        partial(changes.dissolving, frames=16),
    ],
)
def test_what_changes_slowly_all_over_is_no_worse_than_cold(larger, changed, temporal):
    """From frame to frame most of it seems to stand still."""
    scene, still = larger
    pictures = [
        cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
        for picture in scene.render_all(0.0)
    ]
    warm, cold = (Worker(_settings(kind), targets=TARGETS) for kind in (temporal, "cold"))
    for number in range(10):
        truth = [changed(picture, picture[::-1], number) for picture in pictures]
        frame = _observed(scene, still, truth, number)
        ours = warm.take(frame)
        if number < 8:
            continue
        other = cold.take(frame)
        scores = [
            np.mean(
                [
                    psnr(one.images[target].luma, truth[place], border=8)
                    for target, place in zip(TARGETS, scene.reference_views, strict=True)
                ]
            )
            for one in (ours, other)
        ]
        assert scores[0] > scores[1] - 0.05


@pytest.mark.parametrize("temporal", ["swift", "warm"])
@pytest.mark.parametrize(
    ("changed", "width", "last"),
    [
        (partial(changes.softer, step=0.05), 256, 14),
        (partial(changes.half_dissolving, frames=24), 128, 20),
        # so fast that most of it counts as changed
        (partial(changes.half_turning_over, frames=16), 128, 13),
        (partial(changes.half_turning_over, frames=8), 128, 10),
        (partial(changes.nudged, at=5), 128, 5),
        (partial(changes.nudged, at=5), 256, 5),
        (partial(changes.flickering, share=0.03), 128, 5),
        (partial(changes.flickering, share=0.03), 256, 2),
    ],
)
def test_what_changes_slowly_or_in_part_is_no_worse_than_cold(changed, width, last, temporal):
    """Too slowly, or in too few blocks of too small a picture, for all to be seen to change."""
    scene = replace(SCENE, width=width, height=width * 3 // 4)
    still = scene.frame(0)
    pictures, others = (
        [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32) for picture in shown]
        for shown in (scene.render_all(0.0), replace(scene, seed=1).render_all(0.0))
    )
    warm, cold = (Worker(_settings(kind), targets=TARGETS) for kind in (temporal, "cold"))
    for number in range(last + 1):
        truth = [changed(*both, number) for both in zip(pictures, others, strict=True)]
        frame = _observed(scene, still, truth, number)
        ours = warm.take(frame)
        if number < last - 1:
            continue
        other = cold.take(frame)
        for target, place in zip(TARGETS, scene.reference_views, strict=True):
            scores = [
                psnr(one.images[target].luma, truth[place], border=8) for one in (ours, other)
            ]
            assert scores[0] > scores[1] - 0.05, number


def _half_gone(picture, other, number):
    return changes.half_dissolving(picture, other, number + 16, frames=24)


@pytest.mark.parametrize(
    ("changed", "num_frames", "width", "quality", "noise"),
    [
        # the first frames share their noise, so that a mean of them has hardly less, and lags
        (partial(changes.aside, step=0.2), 4, 128, 23, None),
        (partial(changes.aside, step=0.2), 4, 256, 18, None),
        # a picture is left as it was for some frames, and then drawn as it is
        (partial(changes.softer, step=0.1), 6, 128, 28, NOISE),
        # what it leaves in each view by itself hides what changes in all of them
        (partial(changes.softer, step=0.2), 3, 256, 28, NOISE),
        (partial(changes.aside, step=0.1), 14, 128, 23, NOISE),
        (partial(changes.nudged, step=1.0), 12, 128, 23, None),
        (changes.as_it_is, 8, 128, 23, NOISE),
        (_half_gone, 9, 256, 18, None),
        # what has just begun anew is a mean of one frame, and behind the next one's
        (changes.nudged, 11, 256, 28, None),
    ],
)
def test_frames_that_a_codec_has_drawn_are_no_worse_than_cold(
    changed, num_frames, width, quality, noise
):
    scene = replace(SCENE, width=width, height=width * 3 // 4)
    still = scene.frame(0)
    pictures = [
        cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
        for picture in scene.render_all(0.0)
    ]
    shown = [
        [changed(picture, picture[::-1], number) for picture in pictures]
        for number in range(num_frames)
    ]
    films = [
        changes.filmed(noisy(map(scene.observe, film), place), quality)
        for place, film in enumerate(zip(*shown, strict=True))
    ]
    settings = [replace(_settings(kind), noise_sigma=noise) for kind in ("warm", "cold")]
    warm, cold = (Worker(one, targets=TARGETS) for one in settings)
    for number, truth in enumerate(shown):
        views = tuple(
            replace(view, luma=film[number]) for view, film in zip(still.views, films, strict=True)
        )
        frame = replace(still, frame_index=number, views=views)
        ours, other = warm.take(frame), cold.take(frame)
        for target, place in zip(TARGETS, scene.reference_views, strict=True):
            scores = [
                psnr(one.images[target].luma, truth[place], border=8) for one in (ours, other)
            ]
            assert scores[0] > scores[1] - 0.05, number


@pytest.mark.parametrize("temporal", ["swift", "warm"])
def test_frames_that_a_codec_left_better_than_those_before_are_no_worse_than_cold(temporal):
    """Nothing changes, but what was kept of poorer frames is behind their mean."""
    still, last = SCENE.frame(0), 10
    truth = [
        cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
        for picture in SCENE.render_all(0.0)
    ]
    films = [
        changes.filmed(noisy((SCENE.observe(picture) for _ in range(last + 1)), place), 23)
        for place, picture in enumerate(truth)
    ]
    settings = [replace(_settings(kind), noise_sigma=None) for kind in (temporal, "cold")]
    chain, cold = (Worker(one, targets=TARGETS) for one in settings)
    for number in range(last + 1):
        views = tuple(
            replace(view, luma=film[number]) for view, film in zip(still.views, films, strict=True)
        )
        frame = replace(still, frame_index=number, views=views)
        ours = chain.take(frame)
        if number < last - 1:
            continue
        other = cold.take(frame)
        for target, place in zip(TARGETS, SCENE.reference_views, strict=True):
            scores = [
                psnr(one.images[target].luma, truth[place], border=8) for one in (ours, other)
            ]
            assert scores[0] > scores[1] - 0.05, number


def _pursued(frames, solver):
    """Return frame 1, registered, and the memory of frame 0."""
    memory, settings = Memory(), _settings(solver=solver)
    reconstruct_frame(
        register_frame(frames[0], settings, targets=TARGETS, memory=memory), memory=memory
    )
    registered = register_frame(frames[1], settings, targets=TARGETS, memory=memory)
    # its own pixels, not means over both frames, and all of the picture is solved
    alone = register_frame(frames[1], settings, targets=TARGETS)
    registered = replace(registered, frame=alone.frame, registrations=alone.registrations, still={})
    return registered, memory


def test_a_warm_start_is_ahead_of_a_cold_one_at_every_step(frames):
    """The cold start knows the reference alone, the warm one all views of the frame before."""
    registered, memory = _pursued(frames, "fused")
    target, place = TARGETS[0], SCENE.reference_views[0]
    picture = SCENE.render_hr(place, 1 / SCENE.fps)
    truth = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)

    def score(memory, steps):
        limited = replace(registered, effort=Effort(steps=steps))
        result = reconstruct_frame(limited, memory=copy.copy(memory))
        return psnr(result.images[target].luma, truth, border=8)

    for steps in (1, 2, 3):
        assert score(memory, steps) > score(None, steps)
    assert score(memory, 1) > score(None, 2)


def test_a_warm_start_saves_sweeps_of_the_thesis_solver(frames):
    """Thesis: "a decrease in the convergence time"."""
    registered, memory = _pursued(frames, "pocs-simplified")
    cold = reconstruct_frame(registered).report.targets[0]
    warm = reconstruct_frame(registered, memory=memory).report.targets[0]
    goal = cold.residuals[-1]
    sweeps = next(number for number, value in enumerate(warm.residuals, 1) if value <= goal)
    assert sweeps <= len(cold.residuals) * 3 / 4
