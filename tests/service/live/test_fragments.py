"""The live encoder's bytes, cut and put together, read back by independent readers."""

from __future__ import annotations

import json
import subprocess
from fractions import Fraction

import numpy as np
import pytest

from pipeline.errors import OutputError
from pipeline.media.live_encode import LiveEncoder
from pipeline.stereo import StereoLayout
from service.live.fragments import DamagedStreamError, Fragment, Init, Splitter
from service.live.hls import MediaSegment, playlist

FIRST_FRAME = 7


@pytest.fixture(scope="module")
def live():
    """40 frames of 15 a second: (access units, bytes of the MP4)."""
    encoder = LiveEncoder(fps=Fraction(15), layout=StereoLayout.SBS)
    picture = np.random.default_rng(3).integers(0, 256, (64, 128, 3), np.uint8)
    units = [
        unit
        for number in range(40)
        for unit in encoder.encode(np.roll(picture, number, 1), FIRST_FRAME + number)
    ]
    encoder.close()
    return units, encoder.take_mp4()


def _probe(path, *entries):
    command = ["ffprobe", "-v", "error", "-of", "json", "-show_frames", *entries, str(path)]
    return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)["frames"]


def test_every_frame_is_one_access_unit_with_a_key_frame_each_second(live):
    units, _ = live
    assert [unit.frame_index for unit in units] == list(range(FIRST_FRAME, FIRST_FRAME + 40))
    assert [i for i, unit in enumerate(units) if unit.is_key] == [0, 15, 30]
    start_and_sps = (b"\x00\x00\x00\x01\x67", b"\x00\x00\x01\x67")
    assert all(unit.annex_b.startswith(start_and_sps) for unit in units if unit.is_key)


def test_byte_stream_from_any_key_frame_decodes_with_stereo_and_colour(live, tmp_path):
    path = tmp_path / "joined-late.h264"
    path.write_bytes(b"".join(unit.annex_b for unit in live[0][15:]))
    frames = _probe(path)
    assert len(frames) == 25
    assert frames[0]["tags"]["stereo_mode"] == "left_right"
    assert frames[0]["color_space"] == "bt709"
    assert frames[0]["color_range"] == "tv"
    assert {frame["pict_type"] for frame in frames} == {"I", "P"}


@pytest.mark.parametrize("step", [1, 1000, 10**9])
def test_splitting_loses_no_byte_however_they_arrive(live, step):
    _, data = live
    splitter = Splitter()
    parts = []
    for at in range(0, len(data), step):
        parts += splitter.feed(data[at : at + step])
    init, *fragments = parts
    assert isinstance(init, Init)
    assert init.codec.startswith("avc1.64")
    assert all(isinstance(part, Fragment) for part in fragments)
    assert len(fragments) == 40
    assert [i for i, part in enumerate(fragments) if part.is_key] == [0, 15, 30]
    frame = init.timescale // 15
    assert [part.start for part in fragments] == [frame * i for i in range(40)]
    assert {part.duration for part in fragments} == {frame}
    assert data.startswith(b"".join(part.data for part in parts))


def test_init_and_the_fragments_from_a_key_frame_are_a_video(live, tmp_path):
    init, *fragments = Splitter().feed(live[1])
    path = tmp_path / "late.mp4"
    path.write_bytes(init.data + b"".join(part.data for part in fragments[15:]))
    assert len(_probe(path)) == 25


@pytest.mark.parametrize("data", [b"\x00\x00\x00\x00free", b"\xff" * 16, b"\x00\x00\x00\x08mdat"])
def test_damage_is_said(data):
    with pytest.raises(DamagedStreamError):
        Splitter().feed(data)


def test_frames_out_of_order_or_of_another_size_are_refused():
    encoder = LiveEncoder(fps=Fraction(15), layout=StereoLayout.SBS)
    encoder.encode(np.zeros((32, 64, 3), np.uint8), 5)
    with pytest.raises(OutputError, match="comes after frame 5"):
        encoder.encode(np.zeros((32, 64, 3), np.uint8), 5)
    with pytest.raises(OutputError, match="begin a new stream"):
        encoder.encode(np.zeros((32, 32, 3), np.uint8), 6)
    encoder.close()


def test_a_playlist_grows_and_ends():
    segments = [MediaSegment(number=n, duration=1.0) for n in range(2)]
    growing = playlist(segments, ended=False, growing=True)
    assert "#EXT-X-PLAYLIST-TYPE:EVENT" in growing
    assert "#EXT-X-ENDLIST" not in growing
    ended = playlist(segments, ended=True, growing=True)
    assert ended.endswith("segment-000001.m4s\n#EXT-X-ENDLIST\n")
    assert "#EXT-X-MEDIA-SEQUENCE:4" in playlist(
        [MediaSegment(number=4, duration=0.5)], ended=False, growing=False
    )


def test_a_lost_frame_is_a_longer_one_and_fragments_wait_for_one_frame_only():
    encoder = LiveEncoder(fps=Fraction(15), layout=StereoLayout.SBS)
    splitter = Splitter()
    ready = []
    for number in (4, 5, 8, 9):
        encoder.encode(np.zeros((32, 64, 3), np.uint8), number)
        ready.append(splitter.feed(encoder.take_mp4()))
    encoder.close()
    ready.append(splitter.feed(encoder.take_mp4()))
    fragments = [[part for part in parts if isinstance(part, Fragment)] for parts in ready]
    assert [len(parts) for parts in fragments] == [0, 1, 1, 1, 1]
    flat = [part for parts in fragments for part in parts]
    frame = 15360 // 15
    assert [part.start // frame for part in flat] == [0, 1, 4, 5]
    assert [part.duration // frame for part in flat] == [1, 3, 1, 1]


def test_an_encoder_that_begins_late_has_the_times_of_one_that_began_before():
    picture = np.zeros((32, 64, 3), np.uint8)
    found = []
    for first in (7, 90):
        encoder = LiveEncoder(fps=Fraction(15), layout=StereoLayout.SBS, begin=7)
        units = [unit for number in range(first, 94) for unit in encoder.encode(picture, number)]
        encoder.close()
        init, *parts = Splitter().feed(encoder.take_mp4())
        assert [unit.frame_index for unit in units] == list(range(first, 94))
        assert units[0].is_key
        found.append({part.start: part.duration for part in parts[-4:]})
    assert found[0] == found[1]
    assert min(found[0]) == (90 - 7) * init.timescale // 15
