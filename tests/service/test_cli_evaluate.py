"""`depthsr evaluate`: what is refused, and the exit status; measuring is tested elsewhere."""

from __future__ import annotations

import json

import pytest

from pipeline.evaluation import bars
from pipeline.evaluation.floors import Verdict
from service.cli import main


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["all", "/nowhere", "-o", "{}/out"], "/nowhere: there is no such file or folder"),
        (["all", "sample", "-o", "{}/out", "--chapters", "psf,x"], "--chapters: 'x' is not one of"),
        (["all", "sample", "-o", "{}/file"], "file: cannot be written: it is a file"),
        (["all", "sample", "-o", "{}/out", "--noises", "1;2"], "--noises: '1;2' is not a list"),
        (["all", "sample", "-o", "{}/out", "--page", "{}/no/x.md"], "x.md: cannot be written"),
        (["bars", "{}"], "holds no scene lytro_2067, flower, cones, art, kitti"),
        (["bars"], "no real scenes: name their folder, or set DEPTHSR_SCENES"),
    ],
)
def test_bad_requests_name_what_and_where(capsys, monkeypatch, tmp_path, arguments, said):
    monkeypatch.delenv("DEPTHSR_SCENES", raising=False)
    (tmp_path / "file").touch()
    try:
        status = main(["evaluate", *(argument.format(tmp_path) for argument in arguments)])
    except SystemExit as refused:
        status = refused.code
    assert status == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("met", [True, False, None])
def test_the_bars_fail_where_one_is_not_met(capsys, monkeypatch, tmp_path, met):
    """The verdicts stand in for two minutes of measuring."""
    verdicts = [
        Verdict(floor="high enough", measured="2 dB", met=True),
        Verdict(floor="wide enough", measured="1 px", met=met),
    ]
    monkeypatch.setattr(bars, "measure_bars", lambda folder, settings, note: verdicts)
    status = main(["evaluate", "bars", str(tmp_path), "--json", str(tmp_path / "bars.json"), "-q"])
    assert status == (0 if met else 1)
    assert "wide enough" in capsys.readouterr().out
    assert json.loads((tmp_path / "bars.json").read_text())["met"] is bool(met)


@pytest.mark.parametrize(
    "command", [["psf", "-o"], ["psf", "--json"], ["evaluate", "set1", "--json"]]
)
def test_no_file_of_the_scene_is_written_over(capsys, tiny_scene, command):
    manifest = tiny_scene / "scene.json"
    before = manifest.read_bytes()
    *words, option = command
    assert main([*words, str(tiny_scene), option, str(manifest)]) == 2
    assert "scene.json: would overwrite the scene" in capsys.readouterr().err
    assert manifest.read_bytes() == before
