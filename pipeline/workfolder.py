"""The folder beside the output that keeps the finished segments of a job.

::

    .out.mkv.depthsr/
        job.json              what the segments belong to
        lock                  held while a process works here
        segment-000000.mkv    video of a finished segment (when a video is written)
        segment-000000.json   its account; written last: it says that the segment is finished

Everything in it can be lost without harm but time. A killed process leaves it
behind; ``--resume`` goes on from it, a run without discards it.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from pipeline.errors import OutputError
from pipeline.job import Segment, describe_difference
from pipeline.media.files import TEMPORARY_SUFFIX, output_error, write_atomic
from pipeline.report import strict_json, to_plain

try:
    import fcntl
except ImportError:  # Windows: two runs on one output are not told apart there
    fcntl = None  # type: ignore[assignment]

JOB_FORMAT = "depthsr-job/1"
"""Value of the key ``format`` of ``job.json``; changes when finished segments lose their worth."""


def work_folder_of(result: Path) -> Path:
    """Return the work folder that belongs to an output file or folder."""
    return result.parent / f".{result.name}.depthsr"


class SegmentFiles:
    """The files of the segments in a work folder, wherever they are computed.

    Parameters
    ----------
    folder : Path
        It must exist.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def stem(self, segment: Segment) -> Path:
        """Return the path of a segment's files, without their endings."""
        return self.folder / segment.name

    def account(self, segment: Segment) -> dict[str, Any] | None:
        """Return the account of a finished segment; None where it is not finished."""
        return _read(self.folder / f"{segment.name}.json")

    def finish(self, segment: Segment, account: Mapping[str, Any]) -> None:
        """Write the segment's account: from here on it counts as finished."""
        write_atomic(self.folder / f"{segment.name}.json", strict_json(account).encode())


class WorkFolder(SegmentFiles):
    """An open, locked work folder; a context manager that unlocks it.

    Parameters
    ----------
    folder : Path
        Made if it is not there; its parent must exist.
    fingerprint : mapping of str to plain value
        What the result depends on. A folder with another fingerprint is of no use.
    resume : bool
        Keep finished segments; otherwise everything old is discarded.

    Raises
    ------
    OutputError
        If the folder cannot be made or written, is in use, or (resuming)
        belongs to another job.
    """

    def __init__(
        self,
        folder: Path,
        fingerprint: Mapping[str, Any],
        *,
        resume: bool,
    ) -> None:
        super().__init__(folder)
        self._made = not folder.exists()
        self._lock: IO[str] | None = None
        wanted = {"format": JOB_FORMAT, **to_plain(dict(fingerprint))}
        try:
            folder.mkdir(exist_ok=True)
            self._lock = self._locked()
            found = _read(folder / "job.json")
            if found is not None and resume:
                difference = describe_difference(found, wanted)
                if difference:
                    raise OutputError(
                        f"--resume: {folder} was begun by another job ({difference}); "
                        "run without --resume to begin anew"
                    )
                self._discard(half_written_only=True)
            else:
                self._discard()
            write_atomic(folder / "job.json", strict_json(wanted).encode())
        except OSError as error:
            self.close()
            if self._made:
                with contextlib.suppress(OSError):
                    self.remove()
            raise output_error(folder, error) from error
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> WorkFolder:
        return self

    def __exit__(self, *_: object) -> None:
        """Unlock the folder; remove it where it holds nothing that is worth going on from."""
        if self._lock is not None and not any(self.folder.glob("segment-*.json")):
            self.remove()
        self.close()

    def close(self) -> None:
        """Unlock the folder, leaving what is in it; may be called again."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def remove(self) -> None:
        """Remove the folder: the job is done."""
        self._discard()
        self.close()
        with contextlib.suppress(OSError):
            (self.folder / "lock").unlink(missing_ok=True)
            self.folder.rmdir()

    def _locked(self) -> IO[str]:
        file = (self.folder / "lock").open("w", encoding="utf-8")
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                file.close()
                raise OutputError(
                    f"{self.folder}: another run is writing the same output"
                ) from None
        return file

    def _discard(self, *, half_written_only: bool = False) -> None:
        for path in self.folder.iterdir():
            keep = half_written_only and not path.name.endswith(TEMPORARY_SUFFIX)
            if path.name != "lock" and path.is_file() and not keep:
                path.unlink()


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    return content if isinstance(content, dict) else None
