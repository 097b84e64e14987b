"""Estimating the PSF: the σ of rendered pictures comes back; one view cannot tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.psf_search import search_psf
from pipeline.synthetic import SampleScene

SETTINGS = Settings(sampling="decimation", psf="auto")
WITHIN = 0.15
"""What the estimate is held to here, HR pixels."""


@pytest.fixture(scope="module")
def scene():
    return SampleScene(width=320, height=240, num_views=4)


def frame_of(scene, sigma):
    return scene.frame(0, psf_sigma=sigma, psf_support=11, noise_sigma=1.0, depth="stereo")


@pytest.fixture(scope="module")
def found(scene):
    return {sigma: search_psf(frame_of(scene, sigma), SETTINGS)[0] for sigma in (1.0, 1.6)}


@pytest.mark.parametrize("sigma", [1.0, 1.6])
def test_the_blur_of_rendered_pictures_comes_back(found, sigma):
    curve = found[sigma]
    assert curve.remark == ""
    assert abs(curve.sigma - sigma) < WITHIN
    assert 0 < int(np.argmin(curve.misfits)) < len(curve.misfits) - 1
    assert min(curve.misfits) >= 0
    assert curve.support % 2 == 1
    assert curve.support > 5 * curve.sigma


def test_the_same_estimate_comes_twice_and_a_given_support_is_kept(scene, found):
    again = search_psf(frame_of(scene, 1.0), replace(SETTINGS, psf_support=5))[0]
    assert again.sigma == found[1.0].sigma
    assert again.support == 5


def test_one_view_says_that_it_cannot_tell(scene):
    frame = frame_of(scene, 1.0)
    alone = replace(frame, views=(frame.view(frame.left),))
    curve = search_psf(alone, SETTINGS)[0]
    assert "one view alone" in curve.remark
    assert curve.sigma == 1.0  # K / 2
    assert all(np.isnan(misfit) for misfit in curve.misfits)


def test_views_of_something_else_cannot_tell_either(scene):
    frame = frame_of(scene, 1.0)
    generator = np.random.default_rng(0)
    noise = generator.uniform(0, 255, (len(frame.views), *frame.lr_shape)).astype(np.float32)
    views = tuple(
        view if view.view_id == frame.left else replace(view, luma=picture)
        for view, picture in zip(frame.views, noise, strict=True)
    )
    curve = search_psf(replace(frame, views=views), SETTINGS)[0]
    assert curve.remark != ""


def test_layers_have_curves_of_their_own(scene):
    curves = search_psf(frame_of(scene, 1.0), replace(SETTINGS, psf_per_layer=True, layers=2))
    assert [curve.layer for curve in curves] == [None, 0, 1]
    assert all(curve.remark or abs(curve.sigma - 1.0) < 2 * WITHIN for curve in curves)
