from __future__ import annotations

import json

import pytest

from dscqs.displays import MODES, DisplayShelf, profile_from_dict, shipped_profiles
from dscqs.errors import DisplayError, NotFound

GOOD = {
    "title": "a monitor", "mode": "rows", "width_px": 1920, "height_px": 1080,
    "distance_heights": 3.1,
}  # fmt: skip


def test_every_mode_has_a_profile_that_ships():
    assert {profile.mode for profile in shipped_profiles().values()} == set(MODES)


def test_the_displays_of_the_thesis():
    polarised = shipped_profiles()["polarised"]
    barrier = shipped_profiles()["autostereoscopic"]
    assert (polarised.mode, polarised.eye_px) == ("dual", (1024, 768))
    assert (barrier.mode, barrier.eye_px) == ("columns", (1024, 768))


def test_half_layouts_take_eyes_as_large_as_the_screen():
    assert profile_from_dict({**GOOD, "mode": "sbs-half"}).eye_px == (1920, 1080)
    assert profile_from_dict({**GOOD, "mode": "tab-full"}).eye_px == (1920, 540)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"title": ""}, "title: "),
        ({"title": None}, "title: "),
        ({"calibrated": 3}, "calibrated: "),
        ({"mode": "hologram"}, "mode: 'hologram'"),
        ({"mode": ["rows"]}, "mode: "),
        ({"width_px": 1920.0}, "width_px: "),
        ({"width_px": True}, "width_px: "),
        ({"height_px": 3}, "height_px: "),
        ({"mode": "dual", "width_px": 1921}, "mode dual: "),
        ({"distance_heights": float("nan")}, "distance_heights: "),
        ({"distance_heights": 0}, "distance_heights: 0"),
        ({"pixel_pitch_mm": "small"}, "pixel_pitch_mm: "),
        ({"crosstalk": 1.1}, "crosstalk: 1.1"),
        ({"phase": 2}, "phase: "),
        ({"phase": True}, "phase: "),
        ({"swap": 1}, "swap: "),
        ({"eye_code": "red"}, "eye_code: 'red'"),
        ({"colour": "red"}, "colour: no such field"),
    ],
)
def test_a_malformed_profile_is_refused_by_the_name_of_its_field(change, said):
    with pytest.raises(DisplayError) as caught:
        profile_from_dict({**GOOD, **change})
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize("name", list(GOOD))
def test_what_is_missing_is_named(name):
    with pytest.raises(DisplayError, match=f"^{name}: is missing"):
        profile_from_dict({key: value for key, value in GOOD.items() if key != name})


def test_a_calibrated_profile_comes_back_and_hides_the_one_that_ships(tmp_path):
    shelf = DisplayShelf(tmp_path / "displays")
    assert shelf.all() == shipped_profiles()
    made = profile_from_dict({**GOOD, "swap": True, "phase": 1, "pixel_pitch_mm": 0.2771})
    shelf.put("passive-monitor", made)
    shelf.put("desk-3", made)
    again = DisplayShelf(tmp_path / "displays")
    assert again.get("passive-monitor") == again.get("desk-3") == made
    assert [path.name for path in (tmp_path / "displays").iterdir()] != []
    assert json.loads((tmp_path / "displays" / "desk-3.json").read_text()) == made.as_dict()


@pytest.mark.parametrize("name", ["../out", "", "A", "a/b", "." * 3, "x" * 65])
def test_names_that_are_no_file_names_are_refused(name, tmp_path):
    with pytest.raises(DisplayError, match=r"^name: "):
        DisplayShelf(tmp_path).put(name, profile_from_dict(GOOD))
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_display_names_those_known(tmp_path):
    with pytest.raises(NotFound, match="'holodeck' is none of polarised, autostereoscopic"):
        DisplayShelf(tmp_path).get("holodeck")
