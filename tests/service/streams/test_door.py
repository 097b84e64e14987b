"""The folder of the workers' socket: gone with its service, swept where that was killed."""

from __future__ import annotations

import subprocess
import sys
import tempfile

import pytest

from service.bus.memory import MemoryNetwork
from service.config import ServiceConfig
from service.live.broadcast import Broadcasts
from service.streams.door import PrivateFolder
from service.streams.streams import Streams

HOLDER = """
from service.streams.door import PrivateFolder
folder = PrivateFolder()
(folder.path / "bus").touch()
print(folder.path, flush=True)
input()
"""


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder of temporary files, of this test alone."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_streams_that_end_leave_nothing(temporary, tmp_path):
    config = ServiceConfig(data=tmp_path / "data", zenoh_listen=("tcp/127.0.0.1:0",))
    network = MemoryNetwork()
    streams = Streams(config, open_bus=lambda bus: network.connect(), broadcasts=Broadcasts())
    streams.start()
    (folder,) = temporary.iterdir()
    assert folder.stat().st_mode & 0o077 == 0
    streams.close()
    assert list(temporary.iterdir()) == []


def test_what_a_killed_service_left_is_swept_and_what_is_in_use_is_not(temporary):
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        there = other.stdout.readline().decode().strip()
        ours = PrivateFolder()
        assert {str(path) for path in temporary.iterdir()} == {there, str(ours.path)}
        other.kill()
    again = PrivateFolder()
    assert set(temporary.iterdir()) == {ours.path, again.path}
    for folder in (ours, again):
        folder.close()
    assert list(temporary.iterdir()) == []


def test_a_file_of_that_name_is_no_folder_of_ours(temporary):
    (temporary / "depthsr-bus-file").touch()
    PrivateFolder().close()
    assert [path.name for path in temporary.iterdir()] == ["depthsr-bus-file"]
