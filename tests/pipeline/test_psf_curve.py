from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import ConfigurationError
from pipeline.psf_curve import PsfCurve, format_psf, psf_picture
from pipeline.report import strict_json

CURVE = PsfCurve(
    view_id="cam3",
    sigmas=(0.5, 1.0, 1.5),
    misfits=(2.25, 1.125, float("nan")),
    sigma=1.1,
    support=7,
)


def test_text_names_the_choice_and_marks_the_nearest_row():
    lines = format_psf([CURVE]).splitlines()
    assert lines[0] == "cam3: σ = 1.10 HR pixels, support 7"
    assert [line.endswith("←") for line in lines[2:]] == [False, True, False]
    assert "1.125" in lines[3]


def test_an_assumption_is_called_one_and_no_row_is_its_choice():
    told = replace(CURVE, remark="PSF: the views cannot tell; σ 1.1 is assumed")
    lines = format_psf([told]).splitlines()
    assert lines[:2] == ["cam3: σ = 1.10 HR pixels (assumed), support 7", told.remark]
    assert not any("←" in line for line in lines)
    untold = replace(told, misfits=(float("nan"),) * 3)
    assert format_psf([untold]).splitlines() == lines[:2]


def test_picture_has_one_plot_a_curve():
    layer = PsfCurve(
        view_id="cam3", sigmas=(0.5, 1.0), misfits=(1.0, 2.0), sigma=0.5, support=5, layer=2
    )
    one, two = psf_picture([CURVE]), psf_picture([CURVE, layer])
    assert two.shape[0] > 1.9 * (one.shape[0] - 32)
    assert np.ptp(one) > 100
    assert "depth layer 2" in layer.title


def test_curves_go_into_strict_json():
    back = json.loads(strict_json([CURVE]))
    assert back[0]["misfits"] == [2.25, 1.125, None]


def test_a_curve_needs_a_misfit_for_each_sigma():
    with pytest.raises(ConfigurationError):
        PsfCurve(view_id="a", sigmas=(1.0,), misfits=(), sigma=1.0, support=7)
