"""Jobs on air: each piece that a worker has written goes to the viewers at the live edge."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

from pipeline.stereo import StereoLayout
from service.jobs.sinks import WATCH
from service.live.broadcast import Broadcast, Broadcasts
from service.live.track import Track
from service.scheduler import job_folder


class JobWatch:
    """Feeds the broadcasts ``jobs/<job>`` and ``jobs/<job>/before``; for any thread.

    Parameters
    ----------
    data : Path
        Data folder of the service.
    broadcasts : Broadcasts
    """

    def __init__(self, data: Path, broadcasts: Broadcasts) -> None:
        self._data = data
        self._broadcasts = broadcasts
        self._lock = threading.Lock()

    def take(self, job_id: str, said: dict[str, Any]) -> None:
        """Put a piece on air: what a worker said of it."""
        name = broadcast_name("jobs", job_id, said["track"])
        track = job_track(self._data, job_id, said["track"])
        with self._lock:
            broadcast = self._broadcasts.get(name) or self._begin(name, track)
            path, still = track.piece(said["number"]), track.still(said["number"])
            if broadcast is None or path is None:
                return
            broadcast.feed(path.read_bytes())
            if still is not None:
                broadcast.show(still.read_bytes())

    def end(self, job_id: str) -> None:
        """Go off air: the worker has ended."""
        for track in ("result", "before"):
            self._broadcasts.close(broadcast_name("jobs", job_id, track))

    def _begin(self, name: str, track: Track) -> Broadcast | None:
        info, init = track.info, track.init()
        if info is None or init is None:
            return None
        made = self._broadcasts.open(name, fps=info.rate, layout=StereoLayout(info.layout))
        made.feed(init.read_bytes())
        return made


def broadcast_name(kind: str, name: str, track: str) -> str:
    """Return the name under which a track of a job or stream is on air.

    >>> broadcast_name("streams", "room", "result"), broadcast_name("jobs", "3f", "before")
    ('streams/room', 'jobs/3f/before')
    """
    return f"{kind}/{name}" + ("" if track == "result" else f"/{track}")


def job_track(data: Path, job_id: str, track: str) -> Track:
    """Return a track of a job."""
    return Track(job_folder(data, job_id) / WATCH / track)
