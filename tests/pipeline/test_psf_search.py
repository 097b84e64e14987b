"""Estimating the PSF: the σ of rendered pictures comes back; one view cannot tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.psf_search import search_psf
from pipeline.synthetic import SampleScene

SETTINGS = Settings(sampling="decimation", psf="auto")
WITHIN = 0.3
"""What the estimate is held to here, HR pixels."""


@pytest.fixture(scope="module")
def scene():
    return SampleScene(width=160, height=120, num_views=6)


def frame_of(scene, sigma):
    return scene.frame(0, psf_sigma=sigma, psf_support=9, noise_sigma=1.0, depth="stereo")


@pytest.mark.parametrize("sigma", [1.0, 1.6])
def test_the_blur_of_rendered_pictures_comes_back(scene, sigma):
    curve = search_psf(frame_of(scene, sigma), SETTINGS)[0]
    assert curve.remark == ""
    assert abs(curve.sigma - sigma) < WITHIN
    assert 0 < int(np.argmin(curve.errors)) < len(curve.errors) - 1
    assert curve.support % 2 == 1
    assert curve.support > 5 * curve.sigma


def test_a_wider_blur_gives_a_larger_estimate_and_the_same_one_twice(scene):
    narrow, again, wide = (
        search_psf(frame_of(scene, sigma), SETTINGS)[0].sigma for sigma in (0.9, 0.9, 1.7)
    )
    assert narrow == again
    assert narrow < wide


def test_one_view_says_that_it_cannot_tell(scene):
    frame = frame_of(scene, 1.0)
    alone = replace(frame, views=(frame.view(frame.left),))
    curve = search_psf(alone, SETTINGS)[0]
    assert "one view alone" in curve.remark
    assert curve.sigma == 1.0  # K / 2
    assert all(np.isnan(error) for error in curve.errors)


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
