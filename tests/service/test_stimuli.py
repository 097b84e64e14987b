"""Stimuli and plans from results: what went in comes out, sample by sample."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import yaml

from dscqs.errors import PlanError, StimulusError
from dscqs.pixel_hash import hash_frames
from dscqs.stimulus import digest
from pipeline.baselines import bicubic
from pipeline.colour import to_rgb
from pipeline.grid import Grid, Sampling
from pipeline.media.images import read_image
from pipeline.media.lossless import open_lossless
from pipeline.media.png import encode_png, write_png
from pipeline.media.source import open_scene
from pipeline.synthetic import SampleScene, write_scene
from service.cli import main
from service.client import Client
from service.plan_files import find_stimuli, format_plan, read_plan
from service.stimuli import make_stimuli, read_manifest
from tests.support.waiting import PATIENCE


def _eye(seed, height=24, width=32):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)


@pytest.fixture
def results(tmp_path):
    """Pictures of three frames for each of three conditions of two contents."""
    for content in ("ballet", "street"):
        for seed, condition in enumerate(("original", "bicubic", "sr")):
            folder = tmp_path / "out" / content / condition
            folder.mkdir(parents=True)
            for number in range(3):
                for eye, name in enumerate(("left", "right")):
                    picture = _eye(100 * seed + 10 * number + eye)
                    write_png(folder / f"{name}-{number + 7:06d}.png", picture)
    return tmp_path / "out"


def _sources(results):
    return {
        f"{path.parent.name}/{path.name}": str(path)
        for path in sorted(results.glob("*/*"))
    }  # fmt: skip


def test_stills_are_the_frame_of_both_eyes(results, tmp_path):
    made = make_stimuli(_sources(results), tmp_path / "stimuli", frame=1)
    assert [(one.width, one.height, one.frames) for one in made] == [(64, 24, 1)] * 6
    one = next(item for item in made if item.key == "street/sr")
    expected = np.concatenate([_eye(210), _eye(211)], axis=1)
    path = tmp_path / "stimuli" / one.file
    assert np.array_equal(read_image(path).samples, expected)
    assert one.pixels == hash_frames([expected])
    assert one.sha256 == digest(path.read_bytes())


def test_what_was_observed_is_enlarged_as_results_are(tmp_path):
    """Both eyes of a scene, of the frame asked for, on the grid asked for."""
    scene = SampleScene(width=32, height=24, num_views=4)
    manifest = write_scene(tmp_path / "scene", scene, num_frames=2, sampling=Sampling.AREA)
    stimuli = tmp_path / "stimuli"
    words = ["dscqs", "stimuli", f"stage/bicubic=bicubic:{manifest}", "-o", str(stimuli)]
    assert main([*words, "--frame", "1", "--magnification", "3"]) == 0
    with open_scene(manifest) as source:
        frame = source.read(1)
    grid = Grid(magnification_x=3, magnification_y=3, sampling=Sampling.AREA)
    eyes = [frame.view(name) for name in (frame.left, frame.right)]
    expected = [to_rgb(bicubic(eye.luma, grid), bicubic(eye.chroma, grid), 8) for eye in eyes]
    made = read_image(stimuli / "stage--bicubic.png").samples
    assert made.shape == (72, 192, 3)
    assert np.array_equal(made, np.concatenate(expected, axis=1))


def test_clips_are_every_frame(results, tmp_path):
    sources = {"ballet/sr": str(results / "ballet" / "sr")}
    with pytest.raises(StimulusError, match="--fps"):
        make_stimuli(sources, tmp_path / "stimuli", kind="video")
    (one,) = make_stimuli(sources, tmp_path / "stimuli", kind="video", fps=Fraction(25))
    expected = [
        np.concatenate([_eye(200 + 10 * number), _eye(201 + 10 * number)], axis=1)
        for number in range(3)
    ]
    clip = open_lossless(tmp_path / "stimuli" / one.file)
    assert np.array_equal(list(clip.frames()), expected)
    assert one.pixels == hash_frames(expected)


def test_stimuli_are_added_to_those_that_are_there(results, tmp_path):
    sources = _sources(results)
    for key in ("ballet/original", "ballet/sr"):
        make_stimuli({key: sources[key]}, tmp_path / "stimuli")
    assert set(read_manifest(tmp_path / "stimuli")["stimuli"]) == {"ballet/original", "ballet/sr"}
    with pytest.raises(StimulusError, match="kind still"):
        make_stimuli(
            {"ballet/x": sources["ballet/sr"]}, tmp_path / "stimuli", kind="video", fps=Fraction(25)
        )


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: (folder / "right-000008.png").unlink(), "is missing"),
        (lambda folder: [path.unlink() for path in folder.iterdir()], "has no left"),
        (lambda folder: write_png(folder / "right-000007.png", _eye(1, 20)), "differ in size"),
    ],
)
def test_incomplete_results_are_refused(results, tmp_path, spoil, said):
    spoil(results / "ballet" / "sr")
    with pytest.raises(StimulusError, match=said):
        make_stimuli(_sources(results), tmp_path / "stimuli", frame=1)


def test_conditions_of_one_content_must_be_alike(results, tmp_path):
    for eye in ("left", "right"):
        write_png(results / "ballet" / "sr" / f"{eye}-000007.png", _eye(1, 24, 40))
    with pytest.raises(StimulusError, match="ballet/sr: is 80×24"):
        make_stimuli(_sources(results), tmp_path / "stimuli")


@pytest.mark.parametrize("key", ["ballet", "a/b/c", "../x/sr", "ballet/", "b\0/sr"])
def test_names_that_are_none_are_refused(results, tmp_path, key):
    with pytest.raises(StimulusError):
        make_stimuli({key: str(results / "ballet" / "sr")}, tmp_path / "stimuli")


def _command(*words):
    return main(["dscqs", *map(str, words)])


def test_from_results_to_a_plan(results, tmp_path, capsys):
    pairs = [f"{key}={source}" for key, source in _sources(results).items()]
    plan = tmp_path / "plan.yaml"
    assert _command(
        "plan", tmp_path / "stimuli", *pairs, "-o", plan, "--displays",
        "polarised,autostereoscopic", "--dummies", 2, "--repetitions", 2, "--training", "street",
    ) == 0  # fmt: skip
    assert "1 content, 6 presentations, 3.7 minutes" in capsys.readouterr().out
    read = read_plan(plan)
    assert read.name == "Set 1 of the thesis: degraded scenes whose original is known"
    assert (read.reference, read.conditions) == ("original", ("bicubic", "sr"))
    assert read.training == ("street/bicubic", "street/sr")
    assert read.displays == ("polarised", "autostereoscopic")
    assert set(read.pixels) == set(read.hashes) == set(read.used)
    assert yaml.safe_load(format_plan(read))["dummies"] == 2


def test_a_folder_without_a_manifest_is_read_by_its_names(tmp_path):
    for name in ("ballet--bicubic", "ballet--sr", "ballet--sr-calibration"):
        (tmp_path / f"{name}.png").write_bytes(encode_png(_eye(1)))
    kind, stimuli = find_stimuli(tmp_path)
    assert kind == "still"
    assert set(stimuli) == {"ballet/bicubic", "ballet/sr", "ballet/sr-calibration"}
    assert _command("plan", tmp_path, "-o", tmp_path / "p.yaml", "--template", "set2") == 0
    assert read_plan(tmp_path / "p.yaml").reference == "bicubic"


def test_more_than_half_an_hour_is_refused_unless_wanted(tmp_path, capsys):
    for condition in ("original", "bicubic", "sr"):
        (tmp_path / f"ballet--{condition}.png").write_bytes(encode_png(_eye(1)))
    words = ["plan", tmp_path, "-o", tmp_path / "p.yaml", "--repetitions", "20", "--dummies", "20"]
    assert _command(*words, "--coherence", "2", "--break-every", "5") == 2
    assert "more than 30" in capsys.readouterr().err
    assert not (tmp_path / "p.yaml").exists()
    assert _command(*words, "--coherence", "2", "--break-every", "5", "--long-session") == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name: [", "cannot be read"),
        ("- a", "must be a mapping"),
        ("name: set\ncolour: red", "colour: no such field"),
        ("name: set", "contents: is missing"),
    ],
)
def test_a_malformed_file_is_refused_by_its_name(tmp_path, text, said):
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    with pytest.raises(PlanError, match=said) as caught:
        read_plan(path)
    assert str(path) in str(caught.value)
    with pytest.raises(PlanError, match="cannot be read"):
        read_plan(tmp_path / "nothing.yaml")


@pytest.mark.parametrize("output", [{"frames": True, "video": False}, {"codec": "ffv1"}])
def test_a_finished_job_becomes_stimuli(live_service, tmp_path, output):
    request = {
        "scene": "tiny",
        "input": {"frames": "0:1"},
        "output": {"container": "mkv", **output},
    }
    with Client(live_service.url, timeout=PATIENCE) as client:
        job = client.submit(request)
        for _ in client.events(job.id):
            pass
        assert client.job(job.id).state == "succeeded"
    words = ["-o", tmp_path / "stimuli", "--server", live_service.url]
    assert _command("stimuli", f"tiny/sr=job:{job.id}", *words) == 0
    made = read_manifest(tmp_path / "stimuli")["stimuli"]["tiny/sr"]
    assert (made["width"], made["height"], made["frames"]) == (2 * 96, 72, 1)
    assert _command("stimuli", "tiny/x=job:nothing", *words) != 0
