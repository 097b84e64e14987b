"""What moves, made better by another picture: taken from where it is there, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.reconstruction.followed import Trust, put_right
from pipeline.reconstruction.fused import initial_estimate
from pipeline.reconstruction.parts import on_hr_grid
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.reconstruction.restoration import restoration_of
from tests.support.views import PHASES, make_grid, make_truth, observe

LR_SHAPE = 36, 44


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
@pytest.mark.parametrize("box", [np.s_[0:36, 0:44], np.s_[8:20, 9:31]])
def test_it_comes_nearer_to_what_it_was_moved_from_where_that_is_wanted(
    magnification, sampling, box
):
    grid, psf = make_grid(*magnification, sampling), GaussianPsf.of(0.5 * max(magnification))
    shift = 3
    wide = make_truth(grid.hr_shape((LR_SHAPE[0], LR_SHAPE[1] + shift)))
    at = shift * grid.magnification_x
    truth, other = wide[:, at:], np.ascontiguousarray(wide[:, :-at])
    observed = observe(np.ascontiguousarray(truth), grid, LR_SHAPE, (0.0, 0.0), psf)
    flow = np.zeros((*LR_SHAPE, 2), np.float32)
    flow[..., 0] = shift
    wanted = np.zeros(LR_SHAPE, np.bool_)
    wanted[box] = True
    before = initial_estimate(observed, grid)
    estimate, shown = before.copy(), np.clip(before, 0, 255)
    put_right(
        estimate, shown, other, flow, observed, wanted,
        restoration_of(observed, grid, psf, 1.0), grid, psf, 1.0, Trust(),
    )  # fmt: skip
    inside = np.zeros(truth.shape, np.bool_)
    inside[on_hr_grid(box, grid)] = True
    np.testing.assert_array_equal(estimate[~inside], before[~inside])
    np.testing.assert_array_equal(shown[inside], np.clip(estimate, 0, 255)[inside])
    inner = np.s_[4 * magnification[1] : -4 * magnification[1], : -5 * at]
    seen = inside[inner]
    found, start = (picture[inner][seen] - truth[inner][seen] for picture in (estimate, before))
    assert np.mean(found**2) < 0.5 * np.mean(start**2)
