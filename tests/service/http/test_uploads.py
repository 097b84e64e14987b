"""What is sent is read as it was here; uploads that nobody made a job of do not stay for ever."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from pipeline.media.source import open_scene
from service.client import Client, scene_files, scene_name
from service.config import ServiceConfig
from service.http import uploads
from service.store import Store
from tests.support.datasets import write_msr
from tests.support.on_air import OnAir
from tests.support.waiting import PATIENCE


def test_old_uploads_are_swept_while_the_service_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(uploads, "SWEEP_SECONDS", 0.001)
    now = 1e9
    monkeypatch.setattr(uploads.time, "time", lambda: now)
    store = Store(tmp_path, clock=lambda: now)
    (tmp_path / "uploads").mkdir()
    young = store.create_upload("anna", "a.png", 3)
    now -= uploads.KEEP_SECONDS + 1
    old = store.create_upload("anna", "b.png", 3)
    now = 1e9
    for record in (young, old):
        uploads.path_of(tmp_path, record.id).touch()

    async def some_time():
        async with asyncio.timeout(PATIENCE):
            sweeping = asyncio.create_task(uploads.keep_swept(store))
            while store.upload(old.id) is not None:
                await asyncio.sleep(0.001)
            sweeping.cancel()
            with pytest.raises(asyncio.CancelledError):
                await sweeping

    asyncio.run(some_time())
    assert store.upload(young.id) is not None
    assert [path.name for path in (tmp_path / "uploads").iterdir()] == [young.id]
    store.close()


@pytest.mark.parametrize(
    ("called", "kind"), [("Breakdancers", "inverse_depth"), ("hall", "disparity")]
)
def test_a_scene_that_its_folder_s_name_tells_is_told_by_the_job_s(tmp_path, called, kind):
    """The limits of MSR's depth are known by name."""
    folder = write_msr(tmp_path / called, calibration=False)
    config = ServiceConfig(data=tmp_path / "data", workers=0, zenoh="off")
    with OnAir(config) as service, Client(f"http://{service.address}", timeout=PATIENCE) as client:
        job = client.submit_files(scene_files(folder), {"name": scene_name(folder)})
        sent = Path(service.app.state.store.job(job.id).request["scene"])
        with open_scene(folder) as here, open_scene(sent) as there:
            assert here.info.depth_kind == there.info.depth_kind == kind
            np.testing.assert_array_equal(
                here.read(0).views[0].depth_map, there.read(0).views[0].depth_map
            )
    assert job.name == called
