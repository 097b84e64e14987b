"""What ``publish`` and ``subscribe`` say when they cannot."""

from __future__ import annotations

import pytest

from service import cli_streams
from service.cli import main
from service.cli_streams import WINDOW_PLAYERS
from tests.service.streams.conftest import free_endpoint

CAMERAS = ["--camera", "b=tcp://h", "--camera", "c=tcp://h"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["subscribe", "a/b"], "cannot be called 'a/b'"),
        (["subscribe", "a", "-o", "x.avi"], "must end with .mkv, .mp4 or .h264"),
        (["subscribe", "a", "--connect", "7447"], "is no endpoint"),
        (["subscribe", "a", "--certificate", "c.pem"], "name both"),
        (["subscribe", "a", "--password-file", "none.txt"], "--password-file"),
        (["publish", "none", "--stream", "a"], "none"),
        (["publish", "none", "--stream", "a", "--loss", "2"], "--loss"),
        (["publish", "none", "--stream", "a", "--rate", "0"], "--rate"),
        (["publish", "none", "--stream", "a", "--rate", "1/0"], "--rate"),
        (["publish", "none"], "--stream"),
        (["publish", "--stream", "a"], "name a scene to play, or cameras"),
        (["publish", "--stream", "a", "--camera", "left"], "--camera"),
        (["publish", "--stream", "a", "--camera", "rtsp://h/?key=x"], "must be NAME=ADDRESS, as"),
        (["publish", "--stream", "a", "--camera", "b=tcp://h"], "two or more are needed"),
        (["publish", "--stream", "a", *2 * ["--camera", "b=tcp://h"]], "given twice"),
        (["publish", "none", "--stream", "a", "--camera", "b=tcp://h"], "none: cannot be read"),
        (["publish", "--stream", "a", "--camera", "b=tcp://h", "--loop"], "--loop"),
        (["publish", "--stream", "a", *CAMERAS, "--input-layout", "sbs"], "--input-layout"),
        (["publish", "--stream", "a", *CAMERAS, "--left", "x"], "--left: no view 'x'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    err = capsys.readouterr().err
    assert said in err
    assert len(err.splitlines()) == 1


def test_a_window_needs_a_player(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["subscribe", "a", "--window"]) == 2
    assert "neither mpv nor ffplay is installed" in capsys.readouterr().err
    assert list(WINDOW_PLAYERS) == ["mpv", "ffplay"]


def test_nobody_there_is_told_after_a_while(capsys, monkeypatch):
    monkeypatch.setattr(cli_streams, "PATIENCE", 0.5)
    endpoint = free_endpoint()
    assert main(["subscribe", "a", "--connect", endpoint]) == 1
    said = capsys.readouterr().err
    assert f"zenoh at {endpoint}: Unable to connect" in said
    assert "depthsr serve starts a service, --connect names another" in said
