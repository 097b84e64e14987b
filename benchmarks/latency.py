"""How long a live frame takes, from its last view's arrival to the published result.

A real service, and a source that plays a rendered scene over zenoh, in processes of their own
on this machine; what is told is what the stream's status tells.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from pipeline.synthetic.scene import SampleScene
from pipeline.synthetic.writing import write_scene

PATIENCE = 120.0
"""How long a stream may need to come alive, seconds."""

STREAM = "bench"


@dataclass(frozen=True, kw_only=True)
class StreamPlan:
    """One stream that is measured."""

    size: tuple[int, int]
    """(width, height) of a view, LR pixels."""
    num_views: int
    rate: int
    """Frames a second."""
    seconds: float
    """How long it is watched once it is alive."""
    num_frames: int = 6
    """Of the scene, which is played in a loop."""


def measure_stream(plan: StreamPlan, threads: int) -> dict[str, Any]:
    """Return the status of a stream that has run for a while."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        width, height = plan.size
        scene = SampleScene(width=width, height=height, num_views=plan.num_views)
        write_scene(folder / "scene", scene, num_frames=plan.num_frames)
        with running(folder, plan, threads) as url, httpx.Client(base_url=url, timeout=30) as api:
            wait_until_live(api)
            threading.Event().wait(plan.seconds)
            status: dict[str, Any] = api.get(f"/api/v1/streams/{STREAM}").json()["status"]
            return status


def wait_until_live(api: httpx.Client) -> None:
    """Return once the stream is live."""
    pause = threading.Event()
    for _ in range(int(4 * PATIENCE)):
        found = api.get(f"/api/v1/streams/{STREAM}").json()
        if found.get("state") == "live":
            return
        pause.wait(0.25)
    raise RuntimeError(f"the stream did not come alive: {found}")


@contextmanager
def running(folder: Path, plan: StreamPlan, threads: int) -> Iterator[str]:
    """Yield the address of a service with the stream's source running."""
    ours = [sys.executable, "-m", "service"]
    endpoint = f"unixsock-stream/{folder}/bus"
    serve = [
        *ours, "serve", "--port", "0", "--data", str(folder / "data"), "--zenoh-listen", endpoint,
        "--worker-threads", str(threads), "--log-level", "warning",
    ]  # fmt: skip
    publish = [
        *ours, "publish", str(folder / "scene"), "--stream", STREAM, "--loop", "-q",
        "--rate", str(plan.rate), "--connect", endpoint,
    ]  # fmt: skip
    environment = {
        name: value for name, value in os.environ.items()
        if not name.startswith("DEPTHSR_") or name == "DEPTHSR_CACHE"
    }  # fmt: skip
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True, env=environment) as service:
        try:
            assert service.stdout is not None
            found = re.search(r"http://\S+", service.stdout.readline())
            assert found
            with subprocess.Popen(publish, env=environment) as source:
                try:
                    yield found[0]
                finally:
                    source.send_signal(signal.SIGTERM)
        finally:
            service.terminate()


def remark(status: dict[str, Any]) -> str:
    """Return what was left out, in a few words."""
    efforts = status["frames_by_effort"]
    total = max(1, sum(efforts.values()))
    last = list(efforts)[-1] if efforts else "full quality"
    dropped = status["counts"]["frames_behind"] + status["frames_too_late"]
    most = max(efforts, key=lambda words: efforts[words], default="full quality")
    share = 100 * efforts.get(most, 0) // total
    return (
        f"{status['fps_in']:g} frames a second in, {status['fps_out']:g} out; "
        f"{dropped} of {dropped + status['frames_done']} dropped, the start included; {share} % "
        f"with {most}, at least {last}"
    )
