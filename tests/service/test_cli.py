"""The command as a user meets it: real processes, their files, their exit status."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from service.__main__ import main as main_as_loaded
from service.cli import main, make_parser
from tests.support.hanging import hanging, wait_until_stopped
from tests.support.waiting import PATIENCE

ROOT = Path(__file__).parents[2]
HEIGHT, WIDTH = 22, 34


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """A moving scene of two views, 16 frames."""
    folder = tmp_path_factory.mktemp("scene")
    rng = np.random.default_rng(3)
    wall = cv2.GaussianBlur(rng.uniform(0, 255, (HEIGHT, WIDTH + 60)), (0, 0), 1.2)
    wall = cv2.normalize(wall, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    for view, shift in (("a", 4), ("b", 0)):
        (folder / view).mkdir()
        for number in range(16):
            picture = wall[:, shift + number : shift + number + WIDTH]
            cv2.imwrite(str(folder / view / f"color-{number:03d}.png"), picture)
        cv2.imwrite(str(folder / view / "depth.png"), np.full((HEIGHT, WIDTH), 40, np.uint8))
    manifest = {
        "format": "depthsr-scene/1",
        "fps": "12/1",
        "frame_count": 16,
        "views": [
            {"id": view, "color": f"{view}/color-%03d.png", "depth": f"{view}/depth-%03d.png"}
            for view in "ab"
        ],
        "depth": {"kind": "disparity", "scale": 0.1, "offset": 0, "unknown": None},
    }
    for view in "ab":
        depth = (folder / view / "depth.png").read_bytes()
        for number in range(16):
            (folder / view / f"depth-{number:03d}.png").write_bytes(depth)
        (folder / view / "depth.png").unlink()
    (folder / "scene.json").write_text(json.dumps(manifest))
    return folder


def _start(*arguments: object, **options) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "service", *map(str, arguments)],
        cwd=ROOT, stderr=subprocess.PIPE, text=True, **{"stdout": subprocess.PIPE, **options},
    )  # fmt: skip


def depthsr(*arguments: object, **options) -> subprocess.CompletedProcess:
    process = _start(*arguments, **options)
    out, err = process.communicate(timeout=PATIENCE)
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)


def _is_one_error_line(text: str, said: str) -> bool:
    lines = text.splitlines()
    return len(lines) == 1 and lines[0].startswith("depthsr: error: ") and said in lines[0]


@pytest.fixture(scope="module")
def undisturbed(scene, tmp_path_factory) -> Path:
    """What a run that nobody disturbs writes."""
    folder = tmp_path_factory.mktemp("undisturbed")
    done = depthsr("run", scene, "-o", folder / "out.mkv", "--segment-length", 1)
    assert done.returncode == 0, done.stderr
    return folder / "out.mkv"


def test_run_writes_video_pictures_and_report(scene, tmp_path):
    done = depthsr(
        "run", scene, "-o", tmp_path / "out.mp4", "--frames-dir", tmp_path / "frames",
        "--report", tmp_path / "report.json", "--frames", "3:5", "--magnification", "3",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "wrote" in done.stdout
    names = sorted(path.name for path in (tmp_path / "frames").iterdir())
    assert names == ["left-000003.png", "left-000004.png", "right-000003.png", "right-000004.png"]
    picture = cv2.imread(str(tmp_path / "frames" / "left-000003.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (3 * HEIGHT, 3 * WIDTH)
    report = json.loads((tmp_path / "report.json").read_text())
    assert [frame["frame_index"] for frame in report["frames"]] == [3, 4]
    assert report["output"]["hr_width"] == 3 * WIDTH
    assert (tmp_path / "out.mp4").stat().st_size > 1000
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frames", "out.mp4", "report.json"]


def test_quiet_says_nothing_but_warnings(scene, tmp_path):
    done = depthsr("run", scene, "-q", "-o", tmp_path / "out.mkv", "--frames", ":1")
    assert (done.returncode, done.stdout) == (0, "")
    others = [
        line for line in done.stderr.splitlines() if not line.startswith("depthsr: warning: ")
    ]
    assert others == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--magnification", "0"], "--magnification"),
        (["--psf-support", "4"], "--psf-support: must be an odd number"),
        (["--psf-sigma", "nan"], "--psf-sigma"),
        (["--threads", "many"], "--threads"),
        (["--frames", "9:3"], "holds no frame"),
        (["--frames", "0:17"], "not within the scene's frames 0:16"),
        (["--frames", "x"], "not a range"),
        (["--views", "a,z"], "'z'"),
        (["--views", "a,a"], "twice"),
        (["--left", "z"], "'z'"),
        (["--left", "a", "--right", "a"], "both are 'a'"),
        (["--codec", "ffv1", "-o", "{folder}/out.mp4"], "ffv1"),
        (["-o", "{folder}/out.gif"], ".gif"),
        (["-o", "{folder}/missing/out.mkv"], "there is no folder"),
        (["-o", "{folder}"], "it is a folder"),
        (["--no-such-option"], "--no-such-option"),
    ],
)
def test_bad_usage_is_status_2_and_one_line(scene, tmp_path, capsys, options, said):
    """In this process, for there are many; the others here are processes of their own."""
    options = [option.replace("{folder}", str(tmp_path)) for option in options]
    if "-o" not in options:
        options += ["-o", str(tmp_path / "out.mkv")]
    assert main(["run", str(scene), *options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert _is_one_error_line(err, said), err
    assert list(tmp_path.iterdir()) == []


def test_bad_input_is_status_2_and_one_line(tmp_path):
    for path, said in ((tmp_path / "nowhere", "nowhere"), (tmp_path, str(tmp_path))):
        done = depthsr("run", path, "-o", tmp_path / "out.mkv", "-v")
        assert done.returncode == 2
        assert _is_one_error_line(done.stderr, said), done.stderr


def test_no_command_and_no_output_are_usage_errors(scene):
    done = depthsr()
    assert done.returncode == 2
    assert _is_one_error_line(done.stderr, "COMMAND")
    done = depthsr("run", scene)
    assert done.returncode == 2
    assert _is_one_error_line(done.stderr, "nothing to write")


def test_help_names_every_setting_with_its_unit():
    text = depthsr("run", "--help", env={**os.environ, "COLUMNS": "300"}).stdout
    for option in (
        "--magnification", "--sampling", "--psf", "--psf-sigma", "--psf-support", "--noise-sigma",
        "--layers", "--subregions", "--weight-threshold", "--depth-threshold",
        "--residual-threshold", "--views", "--left", "--right", "--frames", "--input-layout",
        "--threads", "--layout", "--codec", "--quality", "--crf", "--frames-dir", "--report",
        "--debug-dir", "--resume", "--segment-length", "--output", "--solver", "--registration",
        "--sweeps", "--residual-bound", "--chroma", "--quiet", "--verbose",
    ):  # fmt: skip
        assert option in text
    for unit in ("[HR pixels]", "[grey levels]", "[frames]", "[threads]", "[times]"):
        assert unit in text


def test_psf_takes_what_it_heeds_alone(scene, capsys):
    assert main(["psf", str(scene), "--chroma", "sr"]) == 2
    assert "--chroma" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        make_parser().parse_args(["psf", "--help"])
    usage = capsys.readouterr().out.partition("\n\n")[0]
    assert set(re.findall(r"--[a-z-]+", usage)) == {
        "--json", "--views", "--left", "--right", "--frames", "--input-layout",
        "--magnification", "--sampling", "--registration", "--layers", "--subregions",
        "--weight-threshold", "--depth-threshold", "--psf-support", "--psf-per-layer",
        "--noise-sigma", "--threads",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("what", "heavy"),
    [
        ("from service.cli import make_parser\nmake_parser().format_help()",
         {"numpy", "cv2", "av", "numba", "scipy"}),
        ("import service.app", {"matplotlib", "numba", "scipy", "fpdf"}),
        ("import service.worker_process, pipeline.run", {"fastapi", "scipy.optimize"}),
    ],
    ids=["help", "a service", "a worker"],
)  # fmt: skip
def test_what_begins_fast_imports_nothing_heavy(what, heavy):
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{what}\nprint(*sys.modules)"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert heavy.isdisjoint(done.stdout.split())


def test_nothing_is_looked_for_at_the_very_end():
    """A search for garbage among all that numba has made takes most of a second."""
    program = (
        "import atexit, gc\n"
        "from service.cli import main\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 0))\n"
        "main(['--version'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "True"


def test_version():
    done = depthsr("--version")
    assert (done.returncode, done.stdout.split()[0]) == (0, "depthsr")
    assert "numpy" in depthsr("version").stdout


def _num_segments(folder: Path) -> int:
    return len(list(folder.glob(".out.mkv.depthsr/segment-*.json")))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_interrupted_and_resumed_run_ends_with_the_same_bytes(scene, undisturbed, tmp_path, number):
    options = ("run", scene, "-o", tmp_path / "out.mkv", "--segment-length", 1)
    held = hanging(tmp_path / "held", "service", finished=2)
    process = _start(*options, env={**os.environ, **held})
    wait_until_stopped(process.pid)
    assert _num_segments(tmp_path) == 2
    begin = time.monotonic()
    process.send_signal(number)
    process.send_signal(signal.SIGCONT)
    _, err = process.communicate(timeout=PATIENCE)
    seconds = time.monotonic() - begin
    assert not (tmp_path / "out.mkv").exists()
    assert 2 <= _num_segments(tmp_path) <= 5  # of 16: what was begun
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 130
        assert err.splitlines()[-1].startswith("depthsr: interrupted")
        assert "Traceback" not in err
        assert seconds < 30
    done = depthsr(*options, "--resume")
    assert done.returncode == 0, done.stderr
    assert "done before" in done.stderr
    assert (tmp_path / "out.mkv").read_bytes() == undisturbed.read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"held", "out.mkv"}


def test_threads_do_not_change_the_bytes(scene, undisturbed, tmp_path):
    done = depthsr("run", scene, "-o", tmp_path / "out.mkv", "--segment-length", 1, "--threads", 1)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.mkv").read_bytes() == undisturbed.read_bytes()


def test_probe_prints_the_views(scene):
    done = depthsr("probe", scene)
    assert done.returncode == 0, done.stderr
    assert f"{WIDTH}×{HEIGHT}" in done.stdout
    described = json.loads(depthsr("probe", scene, "--json").stdout)
    assert described


def test_set1_of_a_real_scene(scenes_dir, tmp_path):
    done = depthsr(
        "evaluate", "set1", scenes_dir / "art", "--psf-sigma", 1.0, "--noise", 2,
        "--methods", "bicubic,lanczos,single-view", "--json", tmp_path / "out.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    content = json.loads((tmp_path / "out.json").read_text())
    scores = {score["method"]: score for score in content["scores"]}
    assert scores["bicubic"]["psnr"] == pytest.approx(30.5, abs=0.3)
    assert scores["lanczos"]["gain_over_bicubic"] == pytest.approx(0.11, abs=0.05)
    assert "single-view" in done.stdout


def test_a_reader_that_goes_away_is_no_error_message(scene):
    reading, writing = os.pipe()
    os.close(reading)
    done = depthsr("probe", scene, stdout=writing)
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_terminal_without_unicode_is_served(scene):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = depthsr("probe", scene, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"{WIDTH}\\xd7{HEIGHT}" in done.stdout


def test_kernels_can_be_compiled_ahead(capsys):
    """What the container's build runs."""
    assert main(["compile", "--quiet"]) == 0
    assert "error" not in capsys.readouterr().err


def test_interrupted_as_it_is_loaded_it_ends_as_it_does_later(monkeypatch, capsys):
    class Interrupting:
        def find_spec(self, name, *_):
            if name == "service.cli":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "service.cli", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupting(), *sys.meta_path])
    assert main_as_loaded() == 130
    assert capsys.readouterr().err == "depthsr: interrupted\n"
