"""A view between two cameras: on made surfaces, and as a job."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ConfigurationError
from pipeline.freeview import Neighbour, between, hr_motion
from pipeline.grid import Grid, Sampling
from pipeline.job import Job, OutputOptions
from pipeline.metrics import psnr
from pipeline.run import run_job
from pipeline.synthetic import SampleScene, write_scene

SHAPE = (60, 90)


def _texture(shift: float) -> np.ndarray:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    x = columns - shift
    wave = np.sin(0.31 * x) + np.cos(0.23 * rows + 0.11 * x)
    return (128 + 50 * wave).astype(np.float32)


def _plane(shift: float, motion: float) -> Neighbour:
    field = np.zeros((*SHAPE, 2), np.float32)
    field[..., 0] = motion
    return Neighbour(
        luma=_texture(shift), chroma=None, motion=field, nearness=np.ones(SHAPE, np.float32)
    )


@pytest.mark.parametrize("at", [0.0, 0.25, 0.5, 0.9, 1.0])
def test_a_plane_between_lies_where_a_straight_line_puts_it(at):
    made = between(_plane(0, 6), _plane(6, -6), at)
    inner = (slice(8, -8), slice(8, -8))
    assert made.seen[inner].all()
    assert np.abs(made.luma - _texture(6 * at))[inner].max() < 1.0


@given(at=st.floats(0, 1), level=st.floats(0, 255))
def test_a_constant_picture_stays_constant(at, level):
    flat = np.full(SHAPE, level, np.float32)
    made = between(
        replace(_plane(0, 5), luma=flat), replace(_plane(5, -5), luma=flat), at
    )  # fmt: skip
    assert np.abs(made.luma - np.float32(level)).max() < 0.01


def test_the_nearer_surface_hides_the_farther_one_and_gaps_continue_the_farther_one():
    """A near square moves by 12 over a still ground; either camera sees what the other does not."""
    pictures, fields, depths = [], [], []
    for place in (30, 42):
        luma = np.full(SHAPE, 60, np.float32)
        near = np.zeros(SHAPE, np.float32)
        luma[20:40, place : place + 16] = 200
        near[20:40, place : place + 16] = 1
        pictures.append(luma)
        depths.append(near)
        field = np.zeros((*SHAPE, 2), np.float32)
        field[near > 0, 0] = 12 if place == 30 else -12
        fields.append(field)
    left, right = (
        Neighbour(luma=luma, chroma=None, motion=field, nearness=near)
        for luma, field, near in zip(pictures, fields, depths, strict=True)
    )
    made = between(left, right, 0.5).luma
    expected = np.full(SHAPE, 60, np.float32)
    expected[20:40, 36:52] = 200
    wrong = np.abs(made - expected) > 8
    assert wrong.mean() < 0.01
    assert not wrong[:, :30].any()
    assert not wrong[:, 58:].any()


def test_motion_stays_sharp_at_depth_edges_and_linear_on_surfaces():
    grid = Grid(magnification_x=2, magnification_y=2, sampling=Sampling.DECIMATION)
    rows, columns = np.mgrid[:20, :30].astype(np.float32)
    motion_x = np.where(columns < 15, 0.1 * columns, 8).astype(np.float32)
    position = np.stack((columns + motion_x, rows), axis=-1)
    field, _ = hr_motion(position, np.ones((20, 30), bool), np.zeros((20, 30), np.float32), grid)
    assert field[10, 10, 0] == pytest.approx(2 * 0.1 * 5)
    assert field[10, 11, 0] == pytest.approx(2 * 0.1 * 5.5, abs=1e-4)
    across = np.round(np.unique(field[10, 28:34, 0]).astype(float), 3)
    assert set(across.tolist()) <= {2.8, 16.0}


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    scene = SampleScene(width=96, height=72, num_views=3)
    return write_scene(tmp_path_factory.mktemp("row"), scene, num_frames=1)


def test_a_job_writes_the_view_between(manifest, tmp_path):
    summary = run_job(
        Job(scene=manifest, output=OutputOptions(frames_dir=tmp_path / "out", view_at=0.5))
    )
    (path,) = sorted((tmp_path / "out").iterdir())
    assert path.name == "view-0.5-000000.png"
    made = cv2.imread(str(path))
    assert made.shape == (144, 192, 3)
    assert summary.report["frames"][0]["targets"][0]["view_id"] == "cam0"
    run_job(Job(scene=manifest, output=OutputOptions(frames_dir=tmp_path / "own", layout="views")))
    own = [cv2.imread(str(tmp_path / "own" / f"cam{n}-000000.png")) for n in (0, 1)]
    apart = [psnr(made, picture, border=12) for picture in own]
    assert min(apart) > psnr(own[0], own[1], border=12)  # nearer to either than they are


@pytest.mark.parametrize(
    ("view_at", "said"), [(1.0, "must lie between two"), (2.5, "must lie between two"), (0, "0 to")]
)
def test_places_without_two_neighbours_are_refused(manifest, tmp_path, view_at, said):
    job = Job(scene=manifest, output=OutputOptions(frames_dir=tmp_path / "out", view_at=view_at))
    with pytest.raises(ConfigurationError, match=said):
        run_job(job)
