"""What the result of a job depends on: how a resumed run knows that it is the same job."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.effort import SWIFT
from pipeline.job import Job
from pipeline.line import WATCHED, warm_up
from pipeline.media.eye_files import eyes_beside
from pipeline.media.video_format import view_path
from pipeline.report import to_plain, versions
from pipeline.superresolve.due import NEW, STILL, WARM
from pipeline.superresolve.restore import CHANGED, REGISTER_EVERY

RESULT_SETTINGS_IGNORED = frozenset({"threads"})
"""Settings that change the time but not the result, so that a resumed run may differ in them."""

OUTPUT_IGNORED = frozenset({"report", "sound"})
"""What is written at the end alone, beside or along with the pictures."""


def make_fingerprint(job: Job, frames: range, targets: tuple[str, ...]) -> dict[str, Any]:
    """Return what the result of a job depends on, as one flat record."""
    record: dict[str, Any] = {"depthsr": versions()["depthsr"]}
    settings = to_plain(job.settings)
    record |= {key: settings[key] for key in settings if key not in RESULT_SETTINGS_IGNORED}
    record |= {
        f"input {key}": value for key, value in to_plain(job.input).items() if key != "frames"
    }
    record |= {
        f"output {key}": value
        for key, value in to_plain(job.output).items()
        if key not in OUTPUT_IGNORED
    }
    if job.settings.temporal != "cold":
        for name, tuning in (("warm", WARM), ("new", NEW), ("still", STILL)):
            record |= {f"{name} {key}": value for key, value in to_plain(tuning).items()}
        record["warm-up frames"] = [WATCHED, warm_up(job.settings.temporal)]
    if job.settings.temporal == "swift":
        record |= {f"swift {key}": value for key, value in to_plain(SWIFT).items()}
        record |= {f"changed {key}": value for key, value in to_plain(CHANGED).items()}
        record["frames from one that is registered to the next"] = REGISTER_EVERY
    record["frames"] = [frames.start, frames.stop]
    record["targets"] = list(targets)
    record["scene"] = str(job.scene.resolve())
    files = scene_files(job, targets)
    record["number of the scene's files"] = len(files)
    record["digest of the scene's files"] = _digest(files)
    return record


def scene_files(job: Job, targets: Sequence[str] = ()) -> list[tuple[str, int, int]]:
    """Return (path, bytes, time of change in nanoseconds) of the files a scene may consist of.

    The file itself, with that of the other eye beside it; for a manifest or a folder all files
    below it but hidden ones and those that the job itself writes of its targets.
    """
    scene = job.scene
    root = scene if scene.is_dir() else scene.parent
    if scene.is_file() and scene.suffix != ".json":
        eyes = eyes_beside(scene)
        files = [scene] if eyes is None else filter(Path.is_file, eyes.files(range(0)))
        states = [(path.name, path.stat()) for path in files]
        return [(name, status.st_size, status.st_mtime_ns) for name, status in states]
    output = job.output
    own = {
        path.resolve()
        for path in (output.output, output.report, output.frames_dir, output.debug_dir)
        if path is not None
    }
    if output.output is not None:
        own |= {view_path(output.output, view_id).resolve() for view_id in targets}
    marks = "|".join(re.escape(name) for name in ("left", "right", "frame", *targets))
    picture = re.compile(rf"({marks})-[0-9]{{6,}}\b.*\.png")
    found = []
    for folder, folders, names in os.walk(root):
        here = Path(folder)
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and (here / name).resolve() not in own
        )
        for name in sorted(names):
            path = here / name
            if here.resolve() in own and picture.fullmatch(name):
                continue  # the scene's folder is that of the pictures too
            if not name.startswith(".") and path.resolve() not in own and path.is_file():
                status = path.stat()
                found.append((str(path.relative_to(root)), status.st_size, status.st_mtime_ns))
    return found


def _digest(files: Sequence[tuple[str, int, int]]) -> str:
    return hashlib.sha256(repr(files).encode()).hexdigest()[:16]
