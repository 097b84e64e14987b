from __future__ import annotations

import json
import math
import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import Settings, Solver
from pipeline.report import (
    distinct,
    peak_memory_mib,
    strict_json,
    sum_timings,
    to_plain,
    versions,
)
from pipeline.results import FrameReport, StartChoice, TargetReport, ViewReport

VIEW = ViewReport(
    view_id="cam1",
    registered_fraction=0.75,
    verified_fraction=0.5,
    weight_fraction=0.25,
    rejections={"weight": 3, "depth": 0},
    median_absolute_weight=math.nan,
    residual_rms=np.float32(1.5),
)


def test_everything_of_a_frame_report_is_there_and_nan_is_null():
    target = TargetReport(
        view_id="cam0", views=(VIEW,), phase_coverage=100.0, phase_coverage_reference=25.0,
        remark="", solver="fused", iterations=4, stop_reason="converged", residuals=(2.0, 1.0),
        start=StartChoice(warm_share=0.0, is_cut=False),
    )  # fmt: skip
    report = FrameReport(
        frame_index=3, noise_sigma=2.0, noise_is_estimated=True, psf_sigma=1.0, psf_support=7,
        psf_is_estimated=False, targets=(target,), timings={"registration": 0.5},
    )  # fmt: skip
    back = json.loads(strict_json(report))
    assert set(back) == set(FrameReport.__dataclass_fields__)
    view = back["targets"][0]["views"][0]
    assert set(view) == set(ViewReport.__dataclass_fields__)
    assert view["median_absolute_weight"] is None
    assert view["residual_rms"] == 1.5
    assert view["rejections"] == {"weight": 3, "depth": 0}
    assert back["targets"][0]["residuals"] == [2.0, 1.0]


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        max_leaves=20,
    )
)
def test_json_is_strict_and_comes_back(value):
    def refuse(name):
        raise AssertionError(f"{name} in JSON")

    back = json.loads(strict_json(value), parse_constant=refuse)
    assert back == to_plain(value)


def test_values_of_numpy_and_the_standard_library():
    plain = to_plain(
        {
            "rate": Fraction(30000, 1001), "path": Path("a/b"), "solver": Solver.POCS,
            "count": np.int64(3), "array": np.array([[1.5, np.inf]]), "set": {"b", "a"},
            "frames": range(3, 7), "yes": np.bool_(True), "settings": Settings(),
        }
    )  # fmt: skip
    assert plain["settings"]["solver"] == "fused"
    del plain["settings"]
    assert plain == {
        "rate": "30000/1001", "path": "a/b", "solver": "pocs", "count": 3,
        "array": [[1.5, None]], "set": ["a", "b"], "frames": [3, 7], "yes": True,
    }  # fmt: skip


def test_what_has_no_plain_form_is_refused():
    with pytest.raises(TypeError, match="no plain form of object"):
        to_plain(object())


def test_versions_and_memory():
    found = versions()
    assert found["numpy"] == np.__version__
    assert "python" in found
    memory = peak_memory_mib()
    assert memory is not None
    assert 10 < memory < 100_000


def test_timings_add_up_and_warnings_are_said_once():
    assert sum_timings([{"a": 1.0}, {"a": 0.5, "b": 2.0}]) == {"a": 1.5, "b": 2.0}
    assert distinct(["x", "y", "x"]) == ["x", "y"]


def test_paths_that_are_no_text_come_back_from_json():
    path = os.fsdecode(b"b\xffd \xc3\xa4.mkv")
    text = strict_json({"path": Path(path)})
    text.encode()
    assert json.loads(text)["path"] == path
