"""What a stream does before its first frame: its frames have not to wait for kernels."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.synthetic import SampleScene, write_scene

LOADED_LATER = """
import gc
import sys
import threading
from fractions import Fraction
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from pipeline.config import Settings
from pipeline.effort import depth_looked_at, looked_at
from pipeline.media.layouts import describe_path
from pipeline.media.live_source import LiveSource
from pipeline.worker import Worker
from service.bus.memory import MemoryNetwork
from service.streams.options import StreamOptions
from service.streams.session import Limits, StreamSession


def loaded():
    kernels = [item for item in gc.get_objects() if isinstance(item, Dispatcher)]
    return {(kernel.__name__, str(types)) for kernel in kernels for types in kernel.signatures}


with LiveSource(describe_path(Path(sys.argv[1]))) as source:
    settings = Settings(temporal="warm")
    session = StreamSession(
        MemoryNetwork().connect(), "s", source.manifest, settings=settings,
        options=StreamOptions(), limits=Limits(),
    )
    session.prepare()
    before = loaded()
    assert len(before) > 20
    worker = Worker(settings, targets=source.manifest.pair)
    ids, pair = source.manifest.view_ids, source.manifest.pair
    for number, index in enumerate(source.frame_indices):
        rungs = session._controller.rungs
        effort = rungs[max(0, number - 4) % len(rungs)].effort
        sent = source.read(index)
        color = {name: sent[name, "color"] for name in looked_at(effort, ids, pair, index)}
        depth = {
            name: sent[name, "depth"]
            for name in depth_looked_at(effort, ids, pair)
            if (name, "depth") in sent
        }
        decoded, refused = session._frames.decode(color, depth)
        assert not refused
        frame = session._frames.frame(index, decoded, depth=depth_looked_at(effort, ids, pair))
        worker.take(frame, effort=effort)
    later = loaded() - before
    assert 10 * len(later) <= len(before), sorted(name for name, _ in later)
"""


@pytest.mark.parametrize("depth", ["stereo", None])
def test_frames_of_a_stream_load_hardly_a_kernel(tmp_path, depth):
    """In a process of its own: other tests have loaded them all."""
    scene = SampleScene(width=96, height=72, num_views=4)
    write_scene(tmp_path, scene, num_frames=22, noise_sigma=1.0, depth=depth)
    subprocess.run(
        [sys.executable, "-c", LOADED_LATER, str(tmp_path)], check=True,
        cwd=Path(__file__).parents[3],
    )  # fmt: skip
