from __future__ import annotations

import dataclasses
from pathlib import Path
from unicodedata import category

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from pipeline.config import Settings
from pipeline.errors import ConfigurationError
from pipeline.job import FrameRange, InputOptions, OutputOptions
from service.jobs.paths import OURS
from service.jobs.pictures import declared_size, too_large
from service.jobs.request import (
    MAX_STEM,
    InputModel,
    JobRequest,
    OutputModel,
    SettingsModel,
    file_name,
    make_job,
    plain_name,
    safe_name,
    without_layout,
)


@pytest.mark.parametrize(
    ("model", "kind", "ours", "added"),
    [
        (SettingsModel, Settings, (), set()),
        (InputModel, InputOptions, (), set()),
        (OutputModel, OutputOptions, OURS, {"container", "video", "frames", "master"}),
    ],
)
def test_http_knows_the_settings_of_the_command_line(model, kind, ours, added):
    fields = {item.name: item for item in dataclasses.fields(kind) if item.name not in ours}
    assert set(model.model_fields) == set(fields) | added
    properties = model.model_json_schema()["properties"]
    for name, item in fields.items():
        assert item.metadata["help"] in properties[name]["description"]
        for choice in item.metadata["choices"]:
            assert f"'{choice}'" in str(properties[name])


def test_a_request_becomes_the_job_that_run_would_do(tmp_path):
    request = JobRequest.model_validate(
        {
            "settings": {"magnification": "3", "noise_sigma": 2},
            "input": {"frames": "4:8", "views": ["a", "b"]},
            "output": {"container": "mp4", "layout": "half-sbs", "frames": True},
        }
    )
    job = make_job(request, tmp_path / "scene", tmp_path / "results", name="clip")
    assert job.settings == Settings(magnification="3", noise_sigma=2.0)
    assert not job.magnification_is_default
    assert job.input == InputOptions(frames=FrameRange(start=4, stop=8), views=("a", "b"))
    assert job.output.output == tmp_path / "results" / "clip_3D_HSBS_LR.mp4"
    assert job.output.frames_dir == tmp_path / "results" / "frames"


def test_nothing_said_is_what_run_does_by_itself(tmp_path):
    job = make_job(JobRequest(), Path("scene"), tmp_path)
    assert job.settings == Settings()
    assert job.magnification_is_default


@pytest.mark.parametrize(
    "body",
    [
        {"settings": {"magnification": "9"}},
        {"settings": {"unheard": 1}},
        {"input": {"frames": "a:b"}},
        {"output": {"output": "/etc/passwd"}},
        {"output": {"debug_dir": "/tmp"}},
        {"priority": 99},
    ],
)
def test_what_is_not_in_the_table_is_refused(body):
    with pytest.raises(ValidationError):
        JobRequest.model_validate(body)


@pytest.mark.parametrize(
    "body",
    [
        {"settings": {"sweeps": 0}},
        {"input": {"frames": "8:4"}},
        {"output": {"video": False}},
    ],
)
def test_what_contradicts_itself_is_refused(body, tmp_path):
    with pytest.raises(ConfigurationError):
        make_job(JobRequest.model_validate(body), tmp_path, tmp_path)


PACKED = ("sbs", "half-sbs", "tab", "half-tab")


@pytest.mark.parametrize("old", PACKED)
@pytest.mark.parametrize("layout", PACKED)
def test_a_name_tells_one_layout(old, layout):
    """Players believe the first that they find."""
    told = Path(file_name("a-clip", old, "mp4")).stem
    assert without_layout(told) == without_layout(told.lower().replace("_", ".")) == "a-clip"
    assert file_name(without_layout(told), layout, "mkv") == file_name("a-clip", layout, "mkv")


@pytest.mark.parametrize("name", ["cam_LR", "half_time", "table", "sbs", "a_3dx", "ou"])
def test_what_is_no_layout_stays_in_a_name(name):
    assert without_layout(name) == name


@given(st.text(max_size=40) | st.from_regex(r"(\.\.?|/|\\|a|C:|\x00| )+", fullmatch=True))
def test_names_never_leave_their_folder(name):
    good = safe_name(name)
    if good is not None:
        assert (Path("/base") / good).resolve().is_relative_to("/base")
        assert not good.startswith("/")
        assert all(not part.startswith(".") for part in good.split("/"))


@pytest.mark.parametrize("name", ["a.png", "cam0/color-0000.png", "a b/ä.png"])
def test_good_names_stay(name):
    assert safe_name(name) == name


@given(st.text(max_size=100))
def test_names_of_jobs_are_plain(name):
    """What they become is a file's name; it is that already."""
    plain = plain_name(name)
    assert len(plain.encode()) <= MAX_STEM
    assert all(c.isalnum() or c in "-_" or category(c) in ("Mn", "Mc") for c in plain)
    assert category(plain[:1] or "-") not in ("Mn", "Mc")
    assert plain_name(plain) == plain
    if plain:
        assert safe_name(plain) == plain


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("Ürün, café", "Ürün--café"),
        ("cafe\u0301", "café"),
        ("Straße", "Straße"),
        ("हिन्दी ไทยที่", "हिन्दी-ไทยที่"),
        ("休日" * 99, "休日" * 20),
        ("🎬\ufe0f take", "take"),
    ],
)
def test_letters_of_any_script_stay_in_the_names_of_jobs(name, plain):
    assert plain_name(name) == plain


def test_a_picture_that_says_it_is_huge_is_found_without_decoding(tmp_path):
    bomb = bytes.fromhex("89504e470d0a1a0a0000000d4948445200100000001000000802000000")
    (tmp_path / "fine.txt").write_text("no picture")
    (tmp_path / "bomb.png").write_bytes(bomb)
    assert "1048576x1048576" in (too_large(tmp_path, 1 << 25) or "")


def test_sizes_of_real_pictures():
    import cv2
    import numpy as np

    picture = np.zeros((30, 50, 3), np.uint8)
    for ending in (".png", ".jpg"):
        done, data = cv2.imencode(ending, picture)
        assert done
        assert declared_size(data.tobytes()) == (50, 30)


@given(st.binary(max_size=64))
def test_any_bytes_are_looked_at_without_harm(data):
    for head in (b"", b"\xff\xd8", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"):
        declared_size(head + data)
