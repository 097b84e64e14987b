"""Parts of a reference view: boxes that hold what is wanted, and results that join."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.frames import RegisteredView
from pipeline.grid import Grid, Sampling
from pipeline.reconstruction.again import Due, fuse_again
from pipeline.reconstruction.boxes import solved_box
from pipeline.reconstruction.fused import FusedTuning, fuse, landing_points
from pipeline.reconstruction.parts import (
    Uncut,
    covering_boxes,
    cut_views,
    landing_in,
    widened,
)
from pipeline.reconstruction.psf import GaussianPsf

SHAPE = (72, 104)
GRID = Grid(magnification_x=2, magnification_y=2, sampling=Sampling.DECIMATION)
PSF = GaussianPsf.of(1.0, 7)


def _view(name, luma, shift, *, is_reference=False):
    x, y = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    position = np.stack([x + shift[0], y + shift[1]], axis=-1).astype(np.float32)
    return RegisteredView(
        view_id=name,
        observed=luma,
        position=position,
        registration_weights=np.zeros(SHAPE, np.float32),
        flags=np.zeros(SHAPE, np.uint8),
        confidence=np.ones(SHAPE, np.float32),
        is_reference=is_reference,
    )


def _views(seed):
    """A scene of smooth waves, seen by three cameras, with the noise of one frame."""
    chance = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(SHAPE[1], dtype=float), np.arange(SHAPE[0], dtype=float))
    views = []
    for number, (u, v) in enumerate([(0, 0), (0.5, 0.2), (-3.3, 0.5)]):
        waves = 120 + 50 * np.sin((x + u) / 1.7) * np.cos((y + v) / 2.3)
        luma = (waves + chance.normal(0, 1, SHAPE)).astype(np.float32)
        views.append(_view(str(number), luma, (u, v), is_reference=number == 0))
    return views


def test_boxes_are_disjoint_hold_all_and_leave_out_what_is_far():
    wanted = np.zeros(SHAPE, bool)
    wanted[3:9, 5:11] = wanted[50:70, 80:104] = True
    wanted[40, 20] = True
    boxes = covering_boxes(wanted)
    times = np.zeros(SHAPE, int)
    for box in boxes:
        times[box] += 1
    assert times.max() == 1
    assert (times[wanted] == 1).all()
    assert times.mean() < 0.4
    assert covering_boxes(np.zeros(SHAPE, bool)) == []


def test_everything_wanted_is_one_box():
    assert covering_boxes(np.ones(SHAPE, bool)) == [(slice(0, 72), slice(0, 104))]


def test_views_are_cut_to_what_lands_in_the_box():
    views = _views(0)
    box = widened((slice(24, 40), slice(32, 48)), SHAPE)
    offsets = [np.full(SHAPE, number, np.float32) for number in range(3)]
    uncut = Uncut(views, offsets)
    cut = cut_views(uncut, landing_in(uncut, [box])[0], [0, 1, 2], box, GRID)
    for view, part, offset in zip(views, cut, offsets, strict=True):
        inside = np.zeros(SHAPE, bool)
        inside[part.place] = True
        x, y = view.position[..., 0], view.position[..., 1]
        lands = (x >= box[1].start) & (x < box[1].stop - 0.5)
        lands &= (y >= box[0].start) & (y < box[0].stop - 0.5)
        assert inside[lands].all()
        np.testing.assert_array_equal(part.observed, (view.observed - offset)[part.place])
        np.testing.assert_array_equal(part.flags, view.flags[part.place])
        for landed, whole, side in zip(
            (part.x, part.y), landing_points(view, GRID), box[::-1], strict=True
        ):
            np.testing.assert_allclose(landed + 2 * side.start, whole[part.place], atol=1e-4)


@pytest.mark.parametrize("noise", [2.0, 0.3])
@pytest.mark.parametrize("some", [[0, 1, 2], [1, 0], [0]])
def test_a_box_is_solved_as_all_of_what_is_cut_is_fused(noise, some):
    """In fewer calls the same, bit for bit; below noise 1 the reference alone comes first."""
    views, (box,) = _views(1), covering_boxes(np.arange(72)[:, None] + np.zeros(SHAPE) > 40)
    box = widened(box, SHAPE)
    uncut = Uncut(views, [np.full(SHAPE, number, np.float32) for number in range(3)])
    (places,) = landing_in(uncut, [box])
    height, width = (side.stop - side.start for side in box)
    start = np.full(GRID.hr_shape((height, width)), 100, np.float32)
    terms = {"noise": noise, "residual_threshold": 9.0, "tuning": FusedTuning(), "most_steps": 3}
    found = solved_box(uncut, places, some, box, GRID, PSF, start=start, most_bands=2, **terms)
    expected = fuse(
        cut_views(uncut, places, some, box, GRID), GRID, (height, width), PSF, start=start,
        judged=False, most_bands=2, **terms,
    )  # fmt: skip
    assert found.views == some
    for one, other in zip(found.solved.weights, expected.weights, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(found.solved.flags, expected.flags, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(found.solved.estimate, expected.estimate)
    np.testing.assert_array_equal(found.solved.density, expected.density)
    assert found.solved.iterations == expected.iterations
    assert found.solved.stop_reason == expected.stop_reason


def test_more_boxes_than_are_told_apart_at_once_hold_what_lands_in_each():
    uncut = Uncut(_views(0))
    boxes = [(slice(row, row + 8), slice(column, column + 13))
             for row in range(0, 72, 8) for column in range(0, 104, 13)]  # fmt: skip
    places = landing_in(uncut, boxes)
    for box, there in zip(boxes, places, strict=True):
        np.testing.assert_array_equal(there, landing_in(uncut, [box])[0])


def test_what_is_due_is_as_if_all_had_been_solved_and_the_rest_is_kept():
    common = {"noise": 1.0, "residual_threshold": 20.0}
    before = fuse(_views(0), GRID, SHAPE, PSF, **common)
    views = _views(1)
    # as many steps for either: a part is at rest sooner or later than the whole
    tuning = FusedTuning(settled=0.0, together=8)
    expected = fuse(views, GRID, SHAPE, PSF, start=before.estimate, tuning=tuning, **common)
    wanted = np.zeros(SHAPE, bool)
    wanted[20:44, 30:60] = True
    found = fuse_again(
        views, GRID, PSF, before, before.estimate,
        [Due(wanted=wanted, noise=1.0, tuning=tuning)], residual_threshold=20.0,
    )  # fmt: skip
    fine = wanted.repeat(2, 0).repeat(2, 1)
    np.testing.assert_array_equal(found.estimate[~fine], before.estimate[~fine])
    away = found.estimate - expected.estimate
    step = expected.estimate - before.estimate
    assert np.abs(away[fine]).mean() < 0.02 * np.abs(step[fine]).mean()
    assert 0 < found.iterations < expected.iterations / 2
