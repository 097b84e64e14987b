from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import MAGNIFICATIONS, Settings, option_name
from pipeline.errors import ConfigurationError
from pipeline.grid import Sampling
from pipeline.job import FrameRange, InputOptions, OutputOptions, describe_difference


@pytest.mark.parametrize("kind", [Settings, InputOptions, OutputOptions])
def test_every_setting_explains_itself(kind):
    for item in dataclasses.fields(kind):
        assert item.metadata["help"], item.name
        assert not item.metadata["help"].endswith(".")
        assert item.default is not dataclasses.MISSING, f"{item.name} has no default"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"magnification": "0"}, "--magnification: '0' is not one of"),
        ({"magnification": "5"}, "--magnification"),
        ({"psf_support": 4}, "--psf-support: must be an odd number"),
        ({"psf_support": 65}, "--psf-support"),
        ({"psf_sigma": 0.0}, "--psf-sigma"),
        ({"psf_sigma": float("nan")}, "--psf-sigma"),
        ({"psf": "auto", "psf_sigma": 1.0}, "--psf-sigma: must be left out with --psf auto"),
        ({"psf": "bicubic", "psf_sigma": 1.0}, "--psf-sigma: must be left out with --psf bicubic"),
        ({"psf": "bicubic", "psf_support": 7}, "--psf-support: must be left out"),
        ({"psf": "bicubic", "solver": "pocs"}, "--solver: must be fused with --psf bicubic"),
        ({"noise_sigma": -1.0}, "--noise-sigma"),
        ({"layers": 0}, "--layers"),
        ({"subregions": 65}, "--subregions"),
        ({"weight_threshold": 0.0}, "--weight-threshold"),
        ({"depth_threshold": 0.0}, "--depth-threshold"),
        ({"residual_threshold": 256.0}, "--residual-threshold"),
        ({"sweeps": 0}, "--sweeps"),
        ({"residual_bound": -0.1}, "--residual-bound"),
        ({"threads": -1}, "--threads"),
        ({"solver": "magic"}, "--solver"),
        ({"registration": "i"}, "--registration"),
    ],
)
def test_settings_out_of_range_are_named(options, said):
    with pytest.raises(ConfigurationError, match=said):
        Settings(**options)


@pytest.mark.parametrize("magnification", MAGNIFICATIONS)
@pytest.mark.parametrize("sampling", list(Sampling))
def test_grid_is_x_then_y(magnification, sampling):
    grid = Settings(magnification=magnification, sampling=sampling.value).grid
    along_x, _, along_y = magnification.partition("x")
    assert grid.hr_shape((3, 5)) == (3 * int(along_y or along_x), 5 * int(along_x))
    assert grid.sampling is sampling


def test_settings_cannot_be_changed():
    settings = Settings()
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.sweeps = 3


def test_option_names():
    assert option_name("weight_threshold") == "--weight-threshold"


@given(start=st.integers(0, 50), length=st.integers(1, 50))
def test_frame_ranges_are_half_open(start: int, length: int):
    available = range(start, start + length)
    assert FrameRange.parse(f"{start}:{start + length}").within(available) == available
    assert FrameRange.parse(":").within(available) == available
    assert FrameRange.parse(f"{start + length - 1}:").within(available) == range(
        start + length - 1, start + length
    )


@pytest.mark.parametrize("text", ["", "3", "3-5", "a:b", "-1:3", "5:5", "6:2", "1:2:3"])
def test_what_is_no_range_is_refused(text):
    with pytest.raises(ConfigurationError, match="--frames"):
        FrameRange.parse(text)


@pytest.mark.parametrize(
    ("kind", "options", "said"),
    [
        (InputOptions, {"views": ()}, "--views"),
        (InputOptions, {"views": ("a", "")}, "--views"),
        (InputOptions, {"views": ("a", "b", "a")}, "'a' is named twice"),
        (InputOptions, {"left": "a", "right": "a"}, "--left, --right"),
        (InputOptions, {"input_layout": "over-under"}, "--input-layout"),
        (OutputOptions, {}, "nothing to write"),
        (OutputOptions, {"output": "x.mkv", "layout": "3d"}, "--layout"),
        (OutputOptions, {"output": "x.mkv", "codec": "mpeg2"}, "--codec"),
        (OutputOptions, {"output": "x.mkv", "segment_length": 0}, "--segment-length"),
    ],
)
def test_options_that_contradict_are_named(kind, options, said):
    with pytest.raises(ConfigurationError, match=said):
        kind(**options)


def test_differences_are_told_in_words():
    assert describe_difference({"a": 1, "b": 2}, {"a": 1, "b": 3}) == "b was 2, is 3"
    assert describe_difference({"a": 1}, {"a": 1}) == ""
