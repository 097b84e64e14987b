"""Sound goes along with the pictures: as it is, where it was, into what takes it."""

from __future__ import annotations

import json
import subprocess
from fractions import Fraction

import av
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.errors import OutputError
from pipeline.events import Warned
from pipeline.export import Master, export
from pipeline.job import FrameRange, InputOptions, Job, OutputOptions
from pipeline.media.encode import write_segment
from pipeline.media.info import Sound
from pipeline.media.join import join_segments, takes_sound
from pipeline.media.probe import describe, format_description
from pipeline.media.source import open_scene
from pipeline.media.video_format import Container, VideoCodec, VideoFormat
from pipeline.run import run_job
from pipeline.stereo import StereoLayout
from tests.support.needed import program

FPS, RATE, FRAMES = 8, 8000, 24


def write_film(path, codec: str | None, *, frames: int = FRAMES):
    """A side-by-side video of frames of 32×64; sample n of its sound is n, but for what it loses.

    Its sound is one second longer than its pictures.
    """
    rng = np.random.default_rng(2)
    texture = rng.integers(0, 256, (32, 64), dtype=np.uint8)
    with av.open(str(path), "w") as film:
        picture = film.add_stream("libx264", rate=FPS, width=64, height=32, pix_fmt="gray")
        sound = codec and film.add_stream(codec, rate=RATE, layout="mono")
        for number in range(frames):
            frame = av.VideoFrame.from_ndarray(np.roll(texture, number, axis=0), "gray")
            film.mux(picture.encode(frame))
        film.mux(picture.encode(None))
        if sound:
            samples = np.arange(RATE * (frames + FPS) // FPS, dtype=np.int16)[None]
            kind = sound.codec_context.format.name
            if kind == "u8":
                samples = samples.astype(np.uint8)
            elif kind.startswith("flt"):
                samples = (samples / 32768).astype(np.float32)
            for begin in range(0, samples.shape[1], 1000):
                part = np.ascontiguousarray(samples[:, begin : begin + 1000])
                piece = av.AudioFrame.from_ndarray(part, format=kind, layout="mono")
                piece.sample_rate, piece.pts = RATE, begin
                film.mux(sound.encode(piece))
            film.mux(sound.encode(None))
    return path


def heard(path) -> tuple[Fraction, np.ndarray]:
    """Return when the sound of a file begins, seconds after its pictures do, and its samples."""
    with av.open(str(path)) as container:
        (video,) = container.streams.video
        (audio,) = container.streams.audio
        zero = video.start_time * video.time_base
        frames = list(container.decode(audio))
        begin = frames[0].pts * frames[0].time_base - zero
        return begin, np.concatenate([frame.to_ndarray() for frame in frames], axis=1)[0]


def packets(path) -> list[bytes]:
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(audio=0) if packet.size]


def is_silent(path) -> bool:
    with av.open(str(path)) as container:
        return not container.streams.audio


def segments_of(folder, video_format, *lengths, first=0):
    paths = []
    for length in lengths:
        eye = np.full((32, 32), 8 * len(paths), np.uint8)
        paths.append(folder / f"{len(paths)}.mkv")
        write_segment(paths[-1], video_format, [(eye, eye)] * length, first_frame=first)
        first += length
    return paths


def form(container: Container, fps: Fraction = Fraction(FPS)) -> VideoFormat:
    codec = VideoCodec.VP9 if container is Container.WEBM else VideoCodec.H264
    return VideoFormat(container=container, codec=codec, layout=StereoLayout.SBS, fps=fps)


@pytest.mark.parametrize("container", [Container.MKV, Container.MP4])
@pytest.mark.parametrize("begin", [0, 1, 13])
def test_every_sample_comes_at_its_time(tmp_path, container, begin):
    """Samples say where they were; a packet begun before the first picture is left out."""
    film = write_film(tmp_path / "film.mkv", "pcm_s16le")
    sound = Sound(path=film, begin=Fraction(begin, FPS), end=Fraction(begin + 9, FPS))
    video = form(container)
    out = tmp_path / f"out.{container}"
    assert join_segments(segments_of(tmp_path, video, 4, 5), out, video, sound) == 9
    late, samples = heard(out)
    assert 0 <= late < 0.126  # a packet has a thousand samples
    assert samples[0] == pytest.approx(begin * RATE / FPS + late * RATE, abs=RATE / 1000)
    np.testing.assert_array_equal(np.diff(samples), 1)
    assert samples[-1] == pytest.approx((begin + 9) * RATE / FPS, abs=1000)


@pytest.mark.parametrize(
    ("codec", "container"),
    [("aac", "mp4"), ("aac", "mkv"), ("libopus", "webm"), ("flac", "mkv")],
)
def test_sound_is_copied_as_it_is(tmp_path, codec, container):
    film = write_film(tmp_path / "film.mkv", codec)
    video = form(Container(container))
    assert takes_sound(video.container, film)
    sound = Sound(path=film, begin=Fraction(0), end=Fraction(3))
    twice = [tmp_path / name / f"out.{container}" for name in "ab"]
    for out in twice:
        out.parent.mkdir()
        join_segments(segments_of(out.parent, video, 16, 8), out, video, sound)
    source, copied = packets(film), packets(twice[0])
    begin = next(number for number, packet in enumerate(source) if packet == copied[0])
    assert begin <= 1  # but for what primes the decoder
    assert copied == source[begin : begin + len(copied)]
    assert twice[0].read_bytes() == twice[1].read_bytes()
    done = subprocess.run(
        [program("ffmpeg"), "-v", "warning", "-i", twice[0], "-f", "null", "-"],
        capture_output=True, check=True, text=True,
    )  # fmt: skip
    assert done.stderr == ""


@pytest.mark.parametrize(("codec", "container"), [("aac", "webm"), ("pcm_u8", "mp4")])
def test_what_a_file_does_not_take_is_known_before(tmp_path, codec, container):
    assert not takes_sound(Container(container), write_film(tmp_path / "film.mkv", codec))


def test_probe_tells_of_sound_and_of_what_nearness_is_counted_in(tmp_path):
    with open_scene(write_film(tmp_path / "film.mkv", "flac"), input_layout="sbs") as source:
        description = describe(source)
    assert description["sound"] == "flac"
    text = format_description(description)
    assert "sound        flac, goes along as it is" in text
    assert f"{FPS} a second" in text
    assert "in pixels of disparity" in text


def test_sound_that_is_gone_is_named(tmp_path):
    video = form(Container.MKV)
    sound = Sound(path=tmp_path / "gone.mkv", begin=Fraction(0), end=Fraction(1))
    out = tmp_path / "out.mkv"
    with pytest.raises(OutputError, match=r"gone\.mkv: its sound cannot be read: .*--sound none"):
        join_segments(segments_of(tmp_path, video, 2), out, video, sound)
    assert not out.exists()


def test_titles_that_are_no_utf_8_do_no_harm(tmp_path):
    film = write_film(tmp_path / "film.avi", "pcm_s16le", frames=2)
    film.write_bytes(film.read_bytes().replace(b"Lavf", b"L\xe4vf"))
    job = Job(
        scene=film, settings=Settings(psf_sigma=1.0), input=InputOptions(input_layout="sbs"),
        output=OutputOptions(output=tmp_path / "out.mkv"),
    )  # fmt: skip
    run_job(job)
    assert not is_silent(tmp_path / "out.mkv")


def test_the_sound_of_a_scene_is_that_of_its_left_eye(tmp_path):
    write_film(tmp_path / "a.mkv", "aac", frames=2)
    write_film(tmp_path / "b.mkv", "aac", frames=2)
    write_film(tmp_path / "silent.mkv", None, frames=2)

    def sound_of(*films, **more):
        views = [{"id": name, "color": film} for name, film in zip("pqr", films, strict=False)]
        content = {"format": "depthsr-scene/1", "views": views} | more
        (tmp_path / "scene.json").write_text(json.dumps(content))
        with open_scene(tmp_path / "scene.json") as scene:
            said = [text for text in scene.info.warnings if "sound" in text]
            return scene.info.sound and scene.info.sound.name, said

    assert sound_of("a.mkv", "b.mkv") == ("a.mkv", [])
    assert sound_of("a.mkv", "b.mkv", "a.mkv", stereo={"left": "q", "right": "r"}) == ("b.mkv", [])
    assert sound_of("silent.mkv", "b.mkv") == ("b.mkv", [])
    assert sound_of("silent.mkv", "silent.mkv") == (None, [])
    name, (text,) = sound_of("a.mkv", "silent.mkv", fps=30)
    assert name is None
    assert "a.mkv: the sound is not taken over, since 30 frames are shown a second" in text
    with open_scene(tmp_path / "a.mkv", input_layout="sbs") as scene:
        assert scene.info.sound == tmp_path / "a.mkv"


def test_a_run_keeps_the_sound_of_the_frames_it_writes(tmp_path):
    film = write_film(tmp_path / "film.mkv", "aac", frames=6)

    def run(name, **options):
        told = []
        job = Job(
            scene=film,
            settings=Settings(psf_sigma=1.0),
            input=InputOptions(input_layout="sbs", frames=FrameRange(start=2, stop=6)),
            output=OutputOptions(output=tmp_path / name, segment_length=2, **options),
        )
        summary = run_job(job, on_event=told.append)
        said = [event.text for event in told if isinstance(event, Warned) and "sound" in event.text]
        assert [text for text in summary.report["warnings"] if "sound" in text] == said
        return tmp_path / name, said

    path, said = run("out.mp4")
    assert said == []
    late, samples = heard(path)
    assert 0 <= late < 0.13
    assert len(samples) == pytest.approx(RATE * 4 / FPS, abs=2100)
    path, said = run("silent.mp4", sound="none")
    assert is_silent(path)
    assert said == []
    path, (text,) = run("out.webm")
    assert is_silent(path)
    assert text == f"{path}: a .webm file takes no aac sound: it has none"


def test_an_export_has_the_sound_of_its_master(tmp_path):
    film = write_film(tmp_path / "film.mkv", "aac", frames=6)
    video = VideoFormat(
        container=Container.MKV, codec=VideoCodec.FFV1, layout=StereoLayout.SBS, fps=Fraction(FPS)
    )
    path = tmp_path / "master.mkv"
    sound = Sound(path=film, begin=Fraction(2, FPS), end=Fraction(6, FPS))
    join_segments(segments_of(tmp_path, video, 4, first=2), path, video, sound)
    master = Master(path=path, fps=Fraction(FPS), first_frame=2, layout=StereoLayout.SBS)
    for name, options in (("a.mp4", {}), ("b.mp4", {"sound": "none"}), ("c.webm", {})):
        export(master, OutputOptions(output=tmp_path / name, layout="half-sbs", **options))
    assert packets(tmp_path / "a.mp4") == packets(path)
    assert is_silent(tmp_path / "b.mp4")
    assert is_silent(tmp_path / "c.webm")
