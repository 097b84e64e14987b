"""What is said of the RGB of pictures is said of the results: nothing is graded anew."""

from __future__ import annotations

import contextlib
import io
import json
import struct
import subprocess
from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.errors import SceneError
from pipeline.events import Warned
from pipeline.export import Master, export
from pipeline.job import Job, OutputOptions
from pipeline.media.colorimetry import (
    BT2020,
    HLG,
    PQ,
    Colorimetry,
    LightLevel,
    MasteringDisplay,
)
from pipeline.media.decode import VideoReader
from pipeline.media.decoded import matrix_of
from pipeline.media.encode import write_segment
from pipeline.media.images import read_header
from pipeline.media.join import join_segments
from pipeline.media.live_encode import LiveEncoder
from pipeline.media.lossless import open_lossless
from pipeline.media.png import encode_png, write_png
from pipeline.media.probe import describe, format_description
from pipeline.media.source import open_scene
from pipeline.media.video_format import CODECS, Container, VideoCodec, VideoFormat
from pipeline.media.ycbcr import YcbcrMatrix
from pipeline.run import run_job
from pipeline.stereo import StereoLayout
from tests.support.needed import program


def _point(x: int, y: int) -> tuple[Fraction, Fraction]:
    return Fraction(x, 1000), Fraction(y, 1000)


DISPLAY = MasteringDisplay(
    red=_point(680, 320), green=_point(265, 690), blue=_point(150, 60), white=_point(313, 329),
    darkest=Fraction(1, 200), brightest=Fraction(1000),
)  # fmt: skip

HDR10 = Colorimetry(
    primaries=BT2020, transfer=PQ, mastering=DISPLAY,
    light_level=LightLevel(pixel=900, frame=400),
)  # fmt: skip

COLOUR = np.array([50000, 30000, 10000], np.uint16)


def write_film(path, codec=VideoCodec.H264, colorimetry=HDR10, frames=2):
    """Write side-by-side video of 16 bits, grey noise on the left of each eye and a colour."""
    kind = VideoFormat(
        container=Container.MKV, codec=codec, layout=StereoLayout.SBS, fps=Fraction(24),
        colorimetry=colorimetry,
    )  # fmt: skip
    rng = np.random.default_rng(4)
    eye = np.empty((48, 64, 3), np.uint16)
    eye[:] = COLOUR
    eye[:, :32] = rng.integers(10000, 50000, (48, 32, 1))
    segment = path.with_name("segment.mkv")
    write_segment(segment, kind, [(eye, np.roll(eye, -2, axis=1))] * frames, first_frame=0)
    join_segments([segment], path, kind)
    return path


def told(path) -> Colorimetry:
    reader = VideoReader(path)
    try:
        return reader.colorimetry
    finally:
        reader.close()


def probed(path) -> dict:
    command = [program("ffprobe"), "-v", "error", "-of", "json", "-show_streams", str(path)]
    answer = subprocess.run(command, check=True, capture_output=True)
    return json.loads(answer.stdout)["streams"][0]


def near(found) -> Colorimetry:
    """Return what was found, its mastering display that of HDR10 where it is nearly that one."""
    assert found.mastering is not None
    for name, value in vars(DISPLAY).items():
        got = np.asarray(vars(found.mastering)[name], float)
        np.testing.assert_allclose(got, np.asarray(value, float), atol=1e-4)
    return replace(found, mastering=DISPLAY)


def warnings_of(job) -> list[str]:
    events = []
    run_job(job, on_event=events.append)
    return [event.text for event in events if isinstance(event, Warned)]


def job_of(film, folder, **output) -> Job:
    return Job(
        scene=film, settings=Settings(magnification="2"),
        output=OutputOptions(output=folder / "out.mkv", **output),
    )  # fmt: skip


@pytest.mark.parametrize("codec", [VideoCodec.H264, VideoCodec.HEVC, VideoCodec.AV1])
def test_what_is_written_is_read(tmp_path, codec):
    film = write_film(tmp_path / "film.mkv", codec)
    found = told(film)
    if codec is VideoCodec.AV1:  # in parts of 1/65536, luminance in parts of 1/16384
        found = near(found)
    assert found == HDR10
    said = probed(film)
    assert said["pix_fmt"] == "yuv420p10le"
    assert (said["color_space"], said["color_primaries"]) == ("bt2020nc", "bt2020")
    assert said["color_transfer"] == "smpte2084"


@pytest.mark.parametrize(
    ("container", "codec"), [(kind, codec) for kind, codecs in CODECS.items() for codec in codecs]
)
def test_every_container_says_the_light_of_hdr10(tmp_path, container, codec):
    """Also where the stream itself has no place for it; asked of another project's probe."""
    write_film(tmp_path / "film.mkv", codec)
    kind = VideoFormat(
        container=container, codec=codec, layout=StereoLayout.SBS, fps=Fraction(24)
    )  # fmt: skip
    out = tmp_path / f"out.{container}"
    join_segments([tmp_path / "segment.mkv"], out, kind)
    assert near(told(out)) == HDR10
    said = probed(out)
    assert "title" not in said.get("tags", {})
    told_of = {item["side_data_type"]: item for item in said["side_data_list"]}
    display = told_of["Mastering display metadata"]
    assert [Fraction(display[name]) for name in ("green_x", "min_luminance", "max_luminance")] == [
        DISPLAY.green[0], DISPLAY.darkest, DISPLAY.brightest
    ]  # fmt: skip
    level = told_of["Content light level metadata"]
    assert (level["max_content"], level["max_average"]) == (900, 400)


@pytest.mark.parametrize(
    "said", [replace(HDR10, light_level=None), replace(HDR10, mastering=None)]
)  # fmt: skip
def test_half_of_what_hdr10_says_stays_half(tmp_path, said):
    """Though x265 writes levels of light that are 0."""
    assert told(write_film(tmp_path / "film.mkv", VideoCodec.HEVC, said)) == said


@pytest.mark.parametrize(
    ("primaries", "transfer"), [(BT2020, PQ), (BT2020, HLG), (12, 13), (5, 6), (1, 1)]
)
def test_a_result_is_said_to_be_what_its_input_was(tmp_path, primaries, transfer):
    colorimetry = Colorimetry(primaries=primaries, transfer=transfer)
    film = write_film(tmp_path / "film.mkv", colorimetry=colorimetry)
    frames = tmp_path / "frames"
    assert not [
        text for text in warnings_of(job_of(film, tmp_path, frames_dir=frames)) if "prim" in text
    ]
    assert told(tmp_path / "out.mkv") == colorimetry
    assert read_header(frames / "left-000000.png").colorimetry == colorimetry


def test_colours_of_high_dynamic_range_come_out_as_they_went_in(tmp_path):
    """Through 10 bits of BT.2020, super-resolution, a master, and an export from that."""
    film = write_film(tmp_path / "film.mkv")
    run_job(job_of(film, tmp_path))
    assert told(tmp_path / "out.mkv") == HDR10
    (tmp_path / "lossless").mkdir()
    run_job(job_of(film, tmp_path / "lossless", codec="ffv1"))
    path = tmp_path / "lossless" / "out.mkv"
    assert told(path) == HDR10
    master = Master(path=path, fps=Fraction(24), first_frame=0, layout=StereoLayout.SBS)
    export(master, OutputOptions(output=tmp_path / "other.mp4", frames_dir=tmp_path / "frames"))
    assert told(tmp_path / "other.mp4") == HDR10
    said = probed(tmp_path / "other.mp4")
    assert (said["color_space"], said["color_transfer"]) == ("bt2020nc", "smpte2084")
    assert read_header(tmp_path / "frames" / "left-000000.png").colorimetry.is_hdr
    for result in (tmp_path / "out.mkv", path, tmp_path / "other.mp4"):
        with av.open(str(result)) as container:
            frame = next(container.decode(video=0))
            # swscale, not the project, by the matrix that the file names
            found = frame.reformat(format="rgb48le", dst_colorspace=9).to_ndarray()
        there = found[20:76, 80:120].reshape(-1, 3).mean(axis=0)
        assert np.abs(there - COLOUR).max() < 0.01 * 65535


def test_what_does_not_come_out_right_of_high_dynamic_range_is_said(tmp_path):
    film = write_film(tmp_path / "film.mkv")
    output = OutputOptions(output=tmp_path / "out.webm", layout="anaglyph")
    told = warnings_of(Job(scene=film, settings=Settings(), output=output))
    assert sum("8 bits" in text or "anaglyph" in text for text in told) == 2


def test_what_does_not_come_out_right_in_an_export_is_said_too(tmp_path):
    film = write_film(tmp_path / "film.mkv", VideoCodec.FFV1)
    master = Master(path=film, fps=Fraction(24), first_frame=0, layout=StereoLayout.SBS)
    events = []
    export(master, OutputOptions(output=tmp_path / "out.webm"), on_event=events.append)
    (told,) = [event.text for event in events if isinstance(event, Warned)]
    assert "8 bits" in told


def test_video_that_changes_its_dynamic_range_is_refused_there(tmp_path):
    film = tmp_path / "film.h264"
    with film.open("wb") as file:
        for transfer in (1, PQ):
            part = io.BytesIO()
            with av.open(part, "w", format="h264") as container:
                stream = container.add_stream("libx264", rate=24, options={"bf": "0"})
                stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
                stream.codec_context.color_trc = transfer
                grey = np.full((72, 64), 90, np.uint8)
                for _ in range(2):
                    container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, "yuv420p")))
                container.mux(stream.encode(None))
            file.write(part.getvalue())
    with contextlib.closing(VideoReader(film)) as reader:
        reader.picture(1)
        with pytest.raises(SceneError, match=r"frame 2: .*changes to high dynamic range"):
            reader.picture(2)


def test_probe_says_it(tmp_path):
    film = write_film(tmp_path / "film.mkv")
    with open_scene(film) as source:
        description = describe(source)
    assert (description["primaries"], description["transfer"]) == ("bt2020", "smpte2084")
    assert "bt2020 primaries, smpte2084 transfer" in format_description(description)


def test_views_that_differ_are_told(tmp_path, write_scene):
    scene = write_scene(views=3, frames=1)
    for view, colorimetry in ((0, HDR10), (1, HDR10), (2, Colorimetry())):
        for path in (scene / f"v{view}").glob("color-*.png"):
            picture = np.full((18, 26, 3), 90, np.uint8)
            write_png(path, picture, colorimetry)
    with open_scene(scene) as source:
        info = source.info
    assert info.colorimetry.names == HDR10.names
    assert any("another transfer in: v2" in text for text in info.warnings)


def test_raw_video_of_bt_2020_has_its_primaries(tmp_path):
    yuv = {"width": 16, "height": 8, "pixel_format": "yuv420p10le", "matrix": "bt2020"}
    views = [{"id": name, "color": {"yuv": f"{name}.yuv", **yuv}} for name in "lr"]
    for name in "lr":
        (tmp_path / f"{name}.yuv").write_bytes(bytes(2 * 16 * 8 * 3 // 2))
    manifest = {"format": "depthsr-scene/1", "views": views}
    (tmp_path / "scene.json").write_text(json.dumps(manifest))
    with open_scene(tmp_path) as source:
        assert source.info.colorimetry.names == ("bt2020", "bt709")


def test_what_says_nothing_is_taken_for_the_usual():
    assert Colorimetry.told(2, 0).is_usual
    assert Colorimetry.told(9, 99).names == ("bt2020", "bt709")


def test_a_matrix_that_is_not_told_follows_the_primaries():
    """As players take it (mpv), and as results are written."""
    frame = av.VideoFrame(64, 48, "yuv420p10le")
    assert matrix_of(frame) is YcbcrMatrix.BT601
    frame.color_primaries = BT2020
    assert matrix_of(frame) is YcbcrMatrix.BT2020


def test_a_usual_png_has_no_chunk_more():
    picture = np.zeros((3, 5, 3), np.uint8)
    assert encode_png(picture) == encode_png(picture, Colorimetry())
    said = encode_png(picture, HDR10)
    at = said.index(b"cICP")
    assert struct.unpack(">I", said[at - 4 : at]) == (4,)
    assert said[at + 4 : at + 8] == bytes((9, 16, 0, 1))


def test_a_live_stream_is_tagged_with_it():
    encoder = LiveEncoder(fps=Fraction(15), layout=StereoLayout.LEFT, colorimetry=HDR10)
    (unit,) = encoder.encode(np.full((32, 64, 3), 120, np.uint8), 0)
    encoder.close()
    decoder = av.CodecContext.create("h264", "r")
    frames = decoder.decode(av.Packet(unit.annex_b)) or decoder.decode(None)
    tags = (frames[0].colorspace, frames[0].color_primaries, frames[0].color_trc)
    assert tuple(map(int, tags)) == (9, 9, 16)


def test_no_stimuli_are_made_of_high_dynamic_range(tmp_path):
    film = write_film(tmp_path / "film.mkv", VideoCodec.FFV1)
    with pytest.raises(SceneError, match="high dynamic range"):
        open_lossless(film)


def test_interlaced_video_is_warned_of(tmp_path):
    film = tmp_path / "film.mkv"
    with av.open(str(film), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"x264-params": "tff=1"})
        stream.width, stream.height, stream.pix_fmt = 128, 64, "yuv420p"
        noise = np.random.default_rng(1).integers(0, 256, (96, 128), np.uint8)
        for _ in range(2):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noise, "yuv420p")))
        container.mux(stream.encode(None))
    with open_scene(film, input_layout="sbs") as source:
        assert any(text.startswith("interlaced: left, right;") for text in source.info.warnings)
