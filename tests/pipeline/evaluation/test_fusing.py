"""Peers that fuse views: geometry, cost, faults; the real programs where they are installed."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.evaluation import peers, programs
from pipeline.evaluation.btv_l1 import BTV_L1
from pipeline.evaluation.fusing import Asked
from pipeline.evaluation.programs import ProgramFailed
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.vidsr import VIDSR
from pipeline.frames import MultiViewFrame, View
from pipeline.synthetic import SampleScene
from tests.support.needed import absent
from tests.support.waiting import PATIENCE

ROOT = Path(__file__).parents[3]


def waves(shape, step=1.0, offset=0.0):
    """A smooth picture, sampled this far apart from an offset along both axes, LR pixels."""
    rows, columns = np.mgrid[: shape[0], : shape[1]] * step + offset
    return 120 + 50 * np.sin(rows / 5) + 40 * np.cos(columns / 7 + rows / 9)


@pytest.fixture(scope="module")
def asked():
    """A region of the second of four views, which are half a pixel apart: one of HR pixels."""
    views = [
        View(
            view_id=str(number),
            luma=np.rint(waves((64, 88), offset=(number - 1) / 2)).astype(np.float32),
        )
        for number in range(4)
    ]
    frame = MultiViewFrame(frame_index=0, views=tuple(views), left="1", right="2")
    return Asked(frame=frame, reference="1", sigma=0.6, region=(30, 16, 48, 40))


def off(picture, offset):
    """Return how far a region lies from the truth whose pixels are so far from LR pixels."""
    truth = waves((128, 176), 0.5, offset)[32:112, 60:156]
    return np.abs(picture - truth)[8:-8, 8:-8].mean()


def built(target, *assignments):
    """Have the program built at a place of its own; return what was said."""
    environment = {name: value for name, value in os.environ.items() if "MAKE" not in name}
    done = subprocess.run(
        ["make", "--silent", "-C", ROOT, f"BTV_L1={target}", *assignments, target],
        capture_output=True, text=True, timeout=PATIENCE, check=True, env=environment,
    )  # fmt: skip
    return done.stdout


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Install a program in the place of btv-l1: lines of Python."""
    monkeypatch.setenv("DEPTHSR_PEERS", str(tmp_path))

    def install(lines: str) -> None:
        program = tmp_path / "btv-l1"
        program.write_text(f"#!{sys.executable}\nimport sys, time\n{lines}\n")
        program.chmod(0o755)

    return install


ENLARGES = """
width, height, count, reference = map(int, sys.argv[1:5])
views = sys.stdin.buffer.read()
assert len(views) == width * height * count and float(sys.argv[5]) > 0
rows = range(reference * height, (reference + 1) * height)
for row in rows:
    line = bytes(value for value in views[row * width : (row + 1) * width] for _ in "12")
    sys.stdout.buffer.write(line + line)
"""


def test_btv_l1_doubles_a_region_where_it_can_be_built(asked, tmp_path, monkeypatch):
    """What it makes of the views lies on their pixels; elsewhere it is left out, and says so."""
    if BTV_L1.missing():
        said = built(tmp_path / "btv-l1")
        monkeypatch.setenv("DEPTHSR_PEERS", str(tmp_path))
        assert ("BTV-L1 is left out" in said) == (BTV_L1.missing() == "not installed")
        if BTV_L1.missing():
            return
    made = BTV_L1.run(asked)
    assert made.result.shape == (80, 96)
    assert off(made.result, 0) < 1
    assert off(made.result, 0) < min(off(made.result, shift) for shift in (-0.25, 0.25))
    assert made.cpu_seconds > 0
    assert 5 < made.memory_mib < 500


def test_vidsr_doubles_a_region_where_it_is_installed(asked):
    """What it makes of the views has its pixel areas aligned with theirs."""
    if VIDSR.missing():
        absent(f"vidsr: {VIDSR.missing()}; `make peers`, DEPTHSR_PEERS")
    made = VIDSR.run(asked)
    assert made.result.shape == (80, 96)
    assert off(made.result, -0.25) < 2
    assert made.cpu_seconds > 0
    assert made.memory_mib > 5


def test_without_a_compiler_btv_l1_is_left_out_and_nothing_is_left_behind(tmp_path):
    program = tmp_path / "peers" / "btv-l1"
    said = built(program, "CXX=no-such-compiler")
    assert "BTV-L1 is left out" in said
    assert "libopencv-superres-dev" in said
    assert list(program.parent.iterdir()) == []


@pytest.mark.parametrize("region", [(30, 16, 48, 40), (0, 0, 88, 64), (60, 44, 28, 20)])
def test_btv_l1_is_given_the_views_around_a_region_and_gives_the_region(asked, stand_in, region):
    stand_in(ENLARGES)
    made = BTV_L1.run(replace(asked, region=region))
    x, y, width, height = region
    wanted = asked.frame.view("1").luma.repeat(2, 0).repeat(2, 1)
    assert np.array_equal(made.result, wanted[2 * y :, 2 * x :][: 2 * height, : 2 * width])


@pytest.fixture(scope="module")
def four_views():
    """The rendered scene, small: four views of 128×96."""
    return Subject(
        name="sample", frame=None, sample=SampleScene(width=128, height=96, num_views=4),
        settings=Settings(),
    )  # fmt: skip


FAULTS = {
    "raise SystemExit(3)": "failed: status 3",
    "sys.exit('no memory')": "failed: no memory",
    "print('x' * 99, end='')": "gave 99 pixels, not 49152",
    "time.sleep(600)": "did not end within 1 s",
    "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)": "failed: status -11",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_program_that_fails_is_named_and_the_others_are_measured(
    four_views, stand_in, monkeypatch, tmp_path, fault
):
    stand_in(fault)
    if "sleep" in fault:
        monkeypatch.setattr(programs, "LONGEST", 1)
    kinds = [peers.InputKind(sigma=1.0, noise=2.0)]
    fusers = (BTV_L1, replace(BTV_L1, name="another", missing=lambda: "not installed"))
    rows = peers.measure_middle(four_views, kinds, fusers=fusers, folder=tmp_path / "kept")
    assert [row.remark for row in rows] == [FAULTS[fault], "not installed"]
    assert math.isnan(rows[0].cpu_seconds)
    assert not (tmp_path / "kept").exists()
    said = " ".join(peers.chapter([], rows).answer)
    assert f"Not measured: BTV-L1: {FAULTS[fault]}. Not measured: another: not installed." in said


def test_a_program_that_cannot_be_started_is_named(asked, stand_in, tmp_path):
    stand_in("")
    (tmp_path / "btv-l1").chmod(0o644)
    with pytest.raises(ProgramFailed, match="does not start: Permission denied"):
        BTV_L1.run(asked)


def test_ours_are_measured_on_the_same_middle_and_what_a_peer_made_is_kept(
    four_views, stand_in, tmp_path
):
    kinds = [peers.InputKind(sigma=sigma, noise=2.0) for sigma in (1.0, None)]

    def measured(kinds=kinds, notes=None):
        return peers.measure_middle(four_views, kinds, fusers=(BTV_L1,), folder=tmp_path / "kept")

    stand_in(ENLARGES)
    rows = measured()
    assert [row.input_name for row in rows] == ["Gaussian 1, noise 2", "bicubic, noise 2"]
    for row in rows:
        assert row.peer == "BTV-L1"
        assert row.psnr["default"] > row.psnr["bicubic"] > row.psnr["BTV-L1"] > 15
    program = (tmp_path / "btv-l1").read_text()
    again = measured()
    assert [replace(row, memory_mib=0) for row in again] == [
        replace(row, memory_mib=0) for row in rows
    ]
    assert len(list((tmp_path / "kept").iterdir())) == 2
    (tmp_path / "btv-l1").write_text(f"{program}\nsys.exit('another program')")
    assert {row.remark for row in measured()} == {"failed: another program"}
    assert peers.measure_middle(four_views, [peers.InputKind(sigma=1.0, noise=0.0)]) == []


@pytest.mark.parametrize(
    ("on_pixels", "decimated", "offset"),
    [(True, True, 0.0), (False, False, 0.0), (False, True, 0.25), (True, False, -0.25)],
)
def test_pictures_are_put_where_the_truth_is(on_pixels, decimated, offset):
    """Half an HR pixel lies between the two ways of placing LR pixels."""
    picture = waves((80, 96), 0.5).astype(np.float32)
    placed = peers._placed(picture, on_pixels=on_pixels, decimated=decimated)
    wanted = waves((80, 96), 0.5, offset)
    assert np.abs(placed - wanted)[8:-8, 8:-8].max() < 0.75


def test_a_program_is_accounted_for_by_its_own_time_and_memory():
    held = np.ones(200 << 17)  # this process is larger than the program
    works = "import time; held = b'1' * (50 << 20); end = time.process_time() + 0.3\n"
    made = programs.run([sys.executable, "-c", works + "while time.process_time() < end: pass"])
    assert held.nbytes >> 20 == 200
    assert 50 < made.memory_mib < 100
    assert 0.3 <= made.cpu_seconds < 3
    assert made.seconds > 0.3


def test_a_program_that_is_slow_to_read_gets_all_that_it_is_given():
    given = os.urandom(1 << 20)
    slow = "import sys, time; time.sleep(0.2); sys.stdout.buffer.write(sys.stdin.buffer.read())"
    assert programs.run([sys.executable, "-c", slow], given).result == given


def test_what_a_program_left_running_ends_with_it(monkeypatch):
    monkeypatch.setattr(programs, "LONGEST", 0.2)
    begin = time.monotonic()
    with pytest.raises(ProgramFailed, match=r"did not end within 0\.2 s"):
        programs.run(["sh", "-c", "sleep 600 & wait"])
    assert time.monotonic() - begin < 300
