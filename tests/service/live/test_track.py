"""Pieces on the disk: in their places however they came about, and a video together."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pytest

from service.live.fragments import DamagedStreamError, Fragment, Splitter, moved
from service.live.track import Track, TrackInfo, TrackWriter

INFO = TrackInfo(fps="15/1", layout="sbs", eye_width=32, eye_height=32, first_frame=4)


def _write(folder, number, frame, count, info=INFO):
    picture = np.random.default_rng(2).integers(0, 256, (32, 64, 3), np.uint8)
    told = []
    writer = TrackWriter(
        folder, info, number=number, frame=frame, crf=20, on_piece=told.append
    )  # fmt: skip
    for place in range(frame, frame + count):
        writer.add(np.roll(picture, place, 1))
    writer.finish()
    return told


def _frames(path):
    command = ["ffprobe", "-v", "error", "-of", "json", "-show_frames", str(path)]
    return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)["frames"]


@pytest.fixture
def folder(tmp_path):
    """Two segments of a job, of 20 and 17 frames, the second written first."""
    assert _write(tmp_path, 2, 20, 17) == [2, 3]
    assert Track(tmp_path).pieces() == []
    assert _write(tmp_path, 0, 0, 20) == [0, 1]
    return tmp_path


def test_pieces_of_segments_in_any_order_are_one_video(folder, tmp_path):
    track = Track(folder)
    pieces = track.pieces()
    assert [(piece.number, piece.num_frames) for piece in pieces] == [
        (0, 15), (1, 5), (2, 15), (3, 2)
    ]  # fmt: skip
    video = tmp_path / "whole.mp4"
    data = track.init().read_bytes() + b"".join(piece.path.read_bytes() for piece in pieces)
    video.write_bytes(data)
    frames = _frames(video)
    assert len(frames) == 37
    assert [round(float(frame["pts_time"]) * 15) for frame in frames] == list(range(37))
    assert [place for place, frame in enumerate(frames) if frame["key_frame"]] == [0, 15, 20, 35]
    assert frames[0]["tags"]["stereo_mode"] == "left_right"


def test_the_playlist_says_how_long_each_piece_is(folder):
    growing = Track(folder).playlist(ended=False)
    lengths = [float(line[8:-1]) for line in growing.splitlines() if line.startswith("#EXTINF:")]
    assert lengths == pytest.approx([1, 1 / 3, 1, 2 / 15], abs=1e-6)
    assert "#EXT-X-TARGETDURATION:1\n" in growing
    assert "EVENT" in growing
    assert Track(folder).playlist(ended=True).endswith("#EXT-X-ENDLIST\n")


def test_ffmpeg_plays_it_from_the_playlist_with_every_frame(folder):
    for piece in Track(folder).pieces():  # as the routes name them
        (folder / f"segment-{piece.number:06d}.m4s").write_bytes(piece.path.read_bytes())
    (folder / "index.m3u8").write_text(Track(folder).playlist(ended=True))
    assert len(_frames(folder / "index.m3u8")) == 37


def test_a_piece_that_is_missing_ends_what_can_be_watched(folder):
    next(folder.glob("segment-000001-*.m4s")).unlink()
    assert [piece.number for piece in Track(folder).pieces()] == [0]


def test_what_was_written_before_a_kill_is_written_over(folder):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    _write(folder, 2, 20, 17)
    assert {path.name for path in folder.iterdir()} == set(before)
    assert len(Track(folder).pieces()) == 4


def test_every_piece_has_its_picture(folder):
    track = Track(folder)
    for piece in track.pieces():
        assert track.still(piece.number).read_bytes().startswith(b"\xff\xd8")
    assert track.still(9) is None
    assert track.info == INFO
    assert Track(folder / "nowhere").info is None


def test_rates_that_are_no_whole_numbers(tmp_path):
    info = TrackInfo(fps="30000/1001", layout="left", eye_width=64, eye_height=32, first_frame=0)
    _write(tmp_path, 0, 0, 60, info)
    _write(tmp_path, 3, 60, 30, info)
    data = b"".join(
        path.read_bytes() for path in [tmp_path / "init-0.mp4", *sorted(tmp_path.glob("*.m4s"))]
    )
    init, *parts = Splitter().feed(data)
    assert [part.start for part in parts] == [1001 * n * init.timescale // 30000 for n in range(90)]


def test_moving_a_fragment_needs_its_time():
    empty = Fragment(data=b"\x00" * 40, start=0, duration=1, is_key=True)
    with pytest.raises(DamagedStreamError):
        moved(empty, 1, sequence=1)
