"""The presets of thesis Table 1: what each row switches on."""

from __future__ import annotations

import dataclasses

import pytest

from pipeline.config import REGISTRATION_PRESETS
from pipeline.registration.method import METHODS, Initialisation, Layout, MotionModel

ROWS = "abcdefghjkl"


def test_every_preset_of_the_settings_is_a_method_and_the_other_way_round():
    assert tuple(METHODS) == REGISTRATION_PRESETS
    assert "i" not in METHODS, "Table 1 has no row i"
    assert set(ROWS) | {"default", "calibration-only"} == set(METHODS)


def test_no_two_presets_are_alike():
    assert len(set(METHODS.values())) == len(METHODS)


@pytest.mark.parametrize("row", ROWS)
def test_the_rows_are_the_thesis_layers_and_strips(row):
    method = METHODS[row]
    assert method.layout is Layout.STRIPS
    assert method.refine
    assert method.num_layers == (1 if row in "ac" else 11)
    assert method.num_subregions == (1 if row in "abf" else 3)
    translates = method.model is MotionModel.TRANSLATION
    assert translates == (row in "bdg")
    assert translates or method.model is MotionModel.AFFINE
    assert method.best_of_layer_and_patch == (row in "bgkl")


@pytest.mark.parametrize(
    ("row", "initialisation"),
    [
        ("e", Initialisation.CALIBRATION),
        ("h", Initialisation.LAYER),
        ("l", Initialisation.LAYER),
        ("j", Initialisation.NONE),
        ("default", Initialisation.PARALLAX),
        ("calibration-only", Initialisation.CALIBRATION),
    ],
)
def test_where_the_fits_start(row, initialisation):
    assert METHODS[row].initialisation is initialisation


def test_calibration_only_is_the_one_that_is_not_refined():
    assert [name for name, method in METHODS.items() if not method.refine] == ["calibration-only"]


def test_switches_are_independent_and_presets_cannot_be_changed():
    method = dataclasses.replace(
        METHODS["default"], model=MotionModel.QUADRATIC, destination_support=True, num_layers=4
    )
    assert METHODS["default"].model is MotionModel.AFFINE
    assert method.layout is Layout.WINDOWS
    with pytest.raises(dataclasses.FrozenInstanceError):
        METHODS["a"].num_layers = 2


def test_the_value_of_a_model_is_its_degree():
    assert [int(model) for model in MotionModel] == [0, 1, 2]
