"""Uploads that nobody made a job of do not stay for ever."""

from __future__ import annotations

import asyncio

import pytest

from service.http import uploads
from service.store import Store
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
