"""Segments on real Dask workers: the same bits as here, whatever dies meanwhile."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cloudpickle
import pytest

from pipeline.cluster import ClusterEngine, _call, examine
from pipeline.config import Settings
from pipeline.errors import ClusterError, Interrupted, SceneError
from pipeline.events import Compiling, FrameFinished, SegmentFinished
from pipeline.job import FrameRange, InputOptions, Job, OutputOptions
from pipeline.media.media_sink import MediaSink
from pipeline.numba_cache import edition
from pipeline.run import run_job
from pipeline.stop import StopFlag
from pipeline.synthetic import SampleScene, write_scene
from tests.support.cluster import Cluster
from tests.support.waiting import PATIENCE, until

ROOT = Path(__file__).parents[2]
NUM_FRAMES = 6


@pytest.fixture(scope="module")
def cluster(tmp_path_factory) -> Iterator[Cluster]:
    with contextlib.closing(Cluster(tmp_path_factory.mktemp("cluster"))) as started:
        started.worker()
        yield started


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    scene = SampleScene(width=104, height=80, num_views=2)
    folder = tmp_path_factory.mktemp("scene") / "scene"
    return write_scene(folder, scene, num_frames=NUM_FRAMES, noise_sigma=2.0)


class Held(MediaSink):
    """A sink that, once a segment is finished, goes on amid the next when the run is over only."""

    def write_segment(self, segment, stem, results):
        def held():
            results_of_it = iter(results)
            yield next(results_of_it)
            folder = stem.parent
            while any(folder.glob("segment-*.json")) and any(folder.glob("*.run")):
                time.sleep(0.01)
            yield from results_of_it

        return super().write_segment(segment, stem, held())


def _job(manifest: Path, folder: Path, **settings: Any) -> Job:
    folder.mkdir()
    return Job(
        scene=manifest,
        settings=Settings(**{"temporal": "warm", **settings}),
        output=OutputOptions(
            output=folder / "out.mkv", frames_dir=folder / "frames",
            report=folder / "report.json", segment_length=2,
        ),
    )  # fmt: skip


def _bytes(folder: Path) -> dict[str, bytes]:
    files = [folder / "out.mkv", *sorted((folder / "frames").iterdir())]
    return {path.name: path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def local(manifest, tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("local") / "job"
    run_job(_job(manifest, folder))
    return _bytes(folder)


def test_a_worker_keeps_what_it_compiles_where_every_process_does(tmp_path):
    """What came with the installation, compiled ahead, is there for Dask's workers too."""
    call = tmp_path / "call"
    call.write_bytes(cloudpickle.dumps(_call("_first_line")))
    program = (
        "import cloudpickle, pathlib, sys\n"
        "call = cloudpickle.loads(pathlib.Path(sys.argv[1]).read_bytes())\n"
        "assert call('a\\nb') == 'a'\n"
        "from numba import config\n"
        "print(config.CACHE_DIR)"
    )
    environment = {
        key: value for key, value in os.environ.items() if not key.startswith(("NUMBA", "DEPTHSR"))
    }
    done = subprocess.run(
        [sys.executable, "-c", program, call], check=True, timeout=PATIENCE, text=True,
        stdout=subprocess.PIPE, cwd=ROOT, env={**environment, "DEPTHSR_CACHE": str(tmp_path)},
    )  # fmt: skip
    assert Path(done.stdout.strip()) == tmp_path / "numba" / edition()


def test_a_worker_killed_in_the_middle_costs_a_retry_and_no_bit(cluster, manifest, local, tmp_path):
    doomed = cluster.worker()
    job = _job(manifest, tmp_path / "job")
    events = []

    def on_event(event):
        events.append(event)
        if isinstance(event, FrameFinished) and doomed.poll() is None:
            doomed.kill()  # both workers are in the middle of a segment
            doomed.wait()
            # as if it had been in the middle of a picture, too
            (job.output.frames_dir / ".left-000000.png.0123456789ab.tmp").write_bytes(b"half")

    with ClusterEngine(cluster.address, patience=PATIENCE) as engine:
        engine.wait_for_workers(2, PATIENCE)
        summary = run_job(job, engine=engine, on_event=on_event)
    assert doomed.poll() is not None
    assert _bytes(tmp_path / "job") == local
    assert summary.frames_computed == NUM_FRAMES
    assert {event.index for event in events if isinstance(event, SegmentFinished)} == {0, 1, 2}
    last = [event for event in events if isinstance(event, FrameFinished)][-1]
    assert (last.done, last.total) == (NUM_FRAMES, NUM_FRAMES)
    frames = json.loads((tmp_path / "job" / "report.json").read_text())["frames"]
    assert [frame["frame_index"] for frame in frames] == list(range(NUM_FRAMES))
    assert sorted(path.name for path in (tmp_path / "job").iterdir()) == [
        "frames", "out.mkv", "report.json",
    ]  # fmt: skip


@pytest.mark.parametrize("settings", [{"temporal": "swift"}, {"temporal_window": 1}], ids=str)
def test_what_looks_at_other_frames_comes_out_as_at_home(cluster, manifest, tmp_path, settings):
    def made(name, engine=None):
        job = _job(manifest, tmp_path / name, **settings)
        run_job(replace(job, input=InputOptions(frames=FrameRange.parse(":4"))), engine=engine)
        return _bytes(tmp_path / name)

    with ClusterEngine(cluster.address, patience=PATIENCE) as engine:
        assert made("cluster", engine) == made("local")


def test_what_workers_have_finished_does_not_die_with_them(cluster, manifest, local, tmp_path):
    """To Dask it is lost, and nobody is left to make it again; it lies where it was written."""

    def are_all(status):
        return {state.status for state in engine._client.futures.values()} == {status}

    def on_event(event):
        if isinstance(event, FrameFinished) and event.done == 1:
            until(lambda: are_all("finished"))
            cluster.lose_workers()
            until(lambda: are_all("lost"))

    with ClusterEngine(cluster.address, patience=PATIENCE) as engine:
        run_job(_job(manifest, tmp_path / "job"), engine=engine, on_event=on_event)
    cluster.worker()
    assert _bytes(tmp_path / "job") == local


def test_a_worker_that_compiles_says_so(manifest, tmp_path):
    told, stop = [], StopFlag()

    def on_event(event):
        if isinstance(event, Compiling):
            told.append(event)
            stop.set()

    with contextlib.closing(Cluster(tmp_path)) as fresh:
        fresh.worker(NUMBA_CACHE_DIR=str(tmp_path / "nothing-compiled"))
        with (
            ClusterEngine(fresh.address, patience=PATIENCE) as engine,
            pytest.raises(Interrupted),
        ):
            run_job(_job(manifest, tmp_path / "job"), engine=engine, on_event=on_event, stop=stop)
    assert len(told) == 1


def test_a_stop_ends_the_workers_tasks_and_a_resumed_run_goes_on(
    cluster, manifest, local, tmp_path
):
    job, stop = _job(manifest, tmp_path / "job"), StopFlag()
    stopped = []

    def on_event(event):
        if isinstance(event, SegmentFinished):
            stop.set()
            stopped.append(time.monotonic())

    with ClusterEngine(cluster.address, patience=PATIENCE, make_sink=Held) as engine:
        with pytest.raises(Interrupted):
            run_job(job, engine=engine, on_event=on_event, stop=stop)
        assert time.monotonic() - stopped[0] < 60
        until(lambda: not any(engine._client.processing().values()))
    assert not (tmp_path / "job" / "out.mkv").exists()
    with ClusterEngine(cluster.address, patience=PATIENCE) as engine:
        summary = run_job(job, engine=engine, resume=True)
    assert 0 < summary.frames_computed < NUM_FRAMES
    assert _bytes(tmp_path / "job") == local


def test_an_error_of_the_scene_is_told_as_at_home(cluster, manifest, tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    for path in manifest.parent.rglob("*"):
        if path.is_file():
            copy = folder / path.relative_to(manifest.parent)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    broken = sorted(path for path in folder.rglob("*") if path.suffix in (".png", ".mkv"))[0]
    broken.write_bytes(b"nothing")
    job = replace(_job(manifest, tmp_path / "job"), scene=folder / manifest.name)
    with (
        ClusterEngine(cluster.address, patience=PATIENCE) as engine,
        pytest.raises(SceneError, match=broken.name),
    ):
        run_job(job, engine=engine)


def _refusal(address: str) -> str:
    """Return what is said of a scheduler; with more patience where it is slow to answer at all."""
    for patience in (1, 5, 25, PATIENCE):
        with pytest.raises(ClusterError) as caught:
            ClusterEngine(address, patience=patience)
        if "no scheduler" not in str(caught.value):
            break
    return str(caught.value)


def test_no_scheduler_and_no_worker_are_told_apart(tmp_path):
    with pytest.raises(ClusterError, match="no scheduler answers there"):
        ClusterEngine("tcp://127.0.0.1:9", patience=0.5)
    with pytest.raises(ClusterError, match="no scheduler answers there"):
        ClusterEngine("carrier pigeon", patience=0.5)
    with contextlib.closing(Cluster(tmp_path)) as empty:
        assert "no worker; start some with 'dask worker tcp:" in _refusal(empty.address)


def test_a_client_that_is_refused_leaves_nothing_to_the_garbage_collector():
    """Which would close it in any thread, also in one that it has to wait for."""
    before = set(threading.enumerate())
    with pytest.raises(ClusterError, match="no scheduler answers there"):
        ClusterEngine("carrier pigeon", patience=0.5)
    assert set(threading.enumerate()) <= before


def test_a_worker_without_the_package_is_named(cluster, manifest, tmp_path):
    process = cluster.worker(PYTHONPATH=str(cluster.without_package))
    try:
        with ClusterEngine(cluster.address, patience=PATIENCE) as engine:
            engine.wait_for_workers(2, PATIENCE)
            with pytest.raises(ClusterError, match=r"worker tcp://.*: it cannot import depthsr"):
                run_job(_job(manifest, tmp_path / "job"), engine=engine)
    finally:
        process.kill()
        process.wait()


def test_a_worker_that_differs_says_in_what():
    other = pickle.dumps({"versions": {"numpy": "1.0"}, "scene": [], "work": b""})
    assert "not 1.0; install the same version there" in examine(other)


def test_a_scheduler_that_is_lost_amid_segments_is_told_at_once(manifest, tmp_path, capfd):
    """Nothing is waited for that no scheduler can answer, and Dask's tracebacks are not shown."""
    lost = []
    with contextlib.closing(Cluster(tmp_path)) as cluster:
        cluster.worker()

        def on_event(event):
            if isinstance(event, SegmentFinished):
                cluster.lose_scheduler()
                lost.append(time.monotonic())

        with ClusterEngine(cluster.address, patience=PATIENCE, make_sink=Held) as engine:
            with pytest.raises(ClusterError, match=r"the scheduler is lost; --resume goes on"):
                run_job(_job(manifest, tmp_path / "job"), engine=engine, on_event=on_event)
            assert time.monotonic() - lost[0] < 8
    assert "Traceback" not in capfd.readouterr().err
