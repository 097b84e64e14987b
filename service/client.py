"""A small typed client of the service's HTTP doors.

>>> with Client("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     job = client.submit_files({"scene.json": path})
...     for event in client.events(job.id):
...         print(event.kind, event.data)
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from pipeline.errors import PipelineError, SceneError
from pipeline.media.eye_files import LAYOUT, eyes_beside, name_of_pair
from pipeline.media.manifest import MANIFEST_NAME

FINAL = ("succeeded", "failed", "cancelled")


class ServiceError(PipelineError):
    """The service refused, failed, or could not be reached."""

    code = "service-error"

    def __init__(self, message: str, *, problem: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.problem = dict(problem or {})


@dataclass(frozen=True, kw_only=True)
class RemoteJob:
    """A job as the service tells it."""

    id: str
    name: str
    state: str
    attempt: int
    frames_done: int
    frames_total: int | None
    problem: Mapping[str, Any] | None

    @property
    def is_final(self) -> bool:
        return self.state in FINAL


@dataclass(frozen=True, kw_only=True)
class RemoteEvent:
    """Something that happened in a job."""

    sequence: int
    kind: str
    data: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class RemoteResult:
    """A file that a job has made."""

    name: str
    size: int
    media_type: str
    url: str


class Client:
    """A connection to a service; a context manager that closes it."""

    def __init__(self, server: str, *, token: str | None = None, timeout: float = 30.0) -> None:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._http = httpx.Client(base_url=server, headers=headers, timeout=timeout)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def submit(self, request: Mapping[str, Any], *, key: str | None = None) -> RemoteJob:
        """Submit a job whose scene the service can reach."""
        answer = self._ask("POST", "/api/v1/jobs", json=dict(request), headers=_keyed(key))
        return _job(answer.json())

    def submit_files(
        self,
        files: Mapping[str, Path],
        request: Mapping[str, Any] | None = None,
        *,
        key: str | None = None,
    ) -> RemoteJob:
        """Submit a job together with the files of its scene, by their relative names."""
        with ExitStack() as stack:
            parts = [
                ("files", (name, stack.enter_context(path.open("rb"))))
                for name, path in files.items()
            ]
            answer = self._ask(
                "POST", "/api/v1/jobs", files=parts, data={"job": json.dumps(dict(request or {}))},
                headers=_keyed(key), timeout=None,
            )  # fmt: skip
        return _job(answer.json())

    def job(self, job_id: str) -> RemoteJob:
        """Return a job."""
        return _job(self._ask("GET", f"/api/v1/jobs/{job_id}").json())

    def jobs(self, *, state: str | None = None) -> Iterator[RemoteJob]:
        """Yield all jobs, newest first."""
        where: str | None = "/api/v1/jobs" + (f"?state={state}" if state else "")
        while where:
            page = self._ask("GET", where).json()
            yield from map(_job, page["jobs"])
            where = page["next"]

    def cancel(self, job_id: str) -> RemoteJob:
        """Ask a job to stop."""
        return _job(self._ask("POST", f"/api/v1/jobs/{job_id}/cancel").json())

    def retry(self, job_id: str) -> RemoteJob:
        """Queue a failed or cancelled job again."""
        return _job(self._ask("POST", f"/api/v1/jobs/{job_id}/retry").json())

    def delete(self, job_id: str) -> None:
        """Forget a finished job and its files."""
        self._ask("DELETE", f"/api/v1/jobs/{job_id}")

    def export(self, job_id: str, form: Mapping[str, Any]) -> RemoteJob:
        """Have what a finished job made in another form; it is a job of its own."""
        answer = self._ask("POST", f"/api/v1/jobs/{job_id}/exports", json=dict(form))
        return _job(answer.json())

    def events(
        self, job_id: str, *, after: int = 0, patience: float = 60.0
    ) -> Iterator[RemoteEvent]:
        """Yield events until the job is over, through lost connections and restarts.

        ``patience`` is how long the service may be away, in seconds.
        """
        lost: float | None = None
        while True:
            try:
                with self._http.stream(
                    "GET", f"/api/v1/jobs/{job_id}/events",
                    headers={"Accept": "text/event-stream", "Last-Event-ID": str(after)},
                    timeout=httpx.Timeout(30.0),
                ) as stream:  # fmt: skip
                    if stream.status_code != 200:
                        stream.read()
                        raise _refused(stream)
                    for line in stream.iter_lines():
                        if line.startswith("data: "):
                            said = json.loads(line[6:])
                            lost, after = None, said["sequence"]
                            yield RemoteEvent(sequence=after, kind=said["kind"], data=said["data"])
                if _job(_taken(self._http.get(f"/api/v1/jobs/{job_id}")).json()).is_final:
                    return
            except httpx.TransportError as error:
                lost = lost or time.monotonic()
                if time.monotonic() - lost > patience:
                    raise self._absent(error) from error
            time.sleep(0.5)

    def results(self, job_id: str) -> list[RemoteResult]:
        """Return the files of a finished job."""
        answer = self._ask("GET", f"/api/v1/jobs/{job_id}/results")
        return [RemoteResult(**item) for item in answer.json()]

    def download(self, result: RemoteResult, target: Path) -> None:
        """Fetch a result; the target appears whole or not at all."""
        self._fetch(result.url, target)

    def download_archive(self, job_id: str, target: Path) -> None:
        """Fetch all results of a job as one ZIP; the target appears whole or not at all."""
        self._fetch(f"/api/v1/jobs/{job_id}/archive", target)

    def _fetch(self, where: str, target: Path) -> None:
        half = target.with_name(f".{target.name}.{os.getpid()}.tmp")
        try:
            with self._http.stream("GET", where) as stream, half.open("wb") as file:
                if stream.status_code != 200:
                    stream.read()
                    raise _refused(stream)
                for chunk in stream.iter_bytes():
                    file.write(chunk)
            half.replace(target)
        except httpx.TransportError as error:
            raise ServiceError(f"{target.name}: the connection was lost: {error}") from error
        finally:
            half.unlink(missing_ok=True)

    def _ask(self, method: str, where: str, **options: Any) -> httpx.Response:
        try:
            answer = self._http.request(method, where, **options)
        except httpx.TransportError as error:
            raise self._absent(error) from error
        return _taken(answer)

    def _absent(self, error: Exception) -> ServiceError:
        return ServiceError(
            f"{self._http.base_url}: is not there: {error}; "
            "depthsr serve starts a service, --server names another"
        )


def scene_files(scene: Path) -> dict[str, Path]:
    """Return the files to send for a scene, by the names that they get: those that it is read from.

    Of a video of one eye both eyes' are sent.

    Raises
    ------
    SceneError
        If a folder or a manifest is no scene.
    """
    from pipeline.media.layouts import describe_path  # codecs, which other commands need not load

    is_manifest = scene.suffix.lower() == ".json"
    if scene.is_file() and not is_manifest:
        eyes = eyes_beside(scene)
        if eyes is None or not _is_one_eye(scene):
            return {scene.name: scene}
        return {path.name: path for path in eyes.present_files()}
    description = describe_path(scene)
    files = {
        path.relative_to(description.root).as_posix(): path
        for path in description.present_files()
        if path != description.source
    }
    if description.layout == "manifest" and description.source is not None:
        files[MANIFEST_NAME] = description.source
    return files


def _is_one_eye(video: Path) -> bool:
    """Tell whether a video that is named as one eye's does not say that it holds both."""
    from pipeline.media.layouts import describe_path  # codecs, which other commands need not load

    try:
        return describe_path(video).layout == LAYOUT
    except SceneError:
        return False  # the service says what is wrong with it


def scene_name(scene: Path) -> str:
    """Return what a scene is called: its folder's name, or its file's, without a word for an eye.

    >>> scene_name(Path("hall/scene.json")), scene_name(Path("clip.mp4"))
    ('hall', 'clip')
    """
    scene = scene.resolve()
    of = scene.parent if scene.name == "scene.json" else scene
    return name_of_pair(of, of.parent.name) or (of.name if of.is_dir() else of.stem)


def _taken(answer: httpx.Response) -> httpx.Response:
    """Return an answer that is no problem."""
    if answer.is_error:
        raise _refused(answer)
    return answer


def _keyed(key: str | None) -> dict[str, str]:
    return {"Idempotency-Key": key} if key else {}


def _job(said: Mapping[str, Any]) -> RemoteJob:
    return RemoteJob(**{name: said[name] for name in RemoteJob.__dataclass_fields__})


def _refused(answer: httpx.Response) -> ServiceError:
    try:
        problem = answer.json()
        text = f"{problem['title']}: {problem['detail']}"
    except (ValueError, KeyError, TypeError):
        problem, text = {}, answer.text[:200]
    if answer.status_code == 401:  # it says which header it misses
        is_unknown = "Authorization" in answer.request.headers
        text = "it does not know this token; give another" if is_unknown else "give a token"
        text += " with --token or DEPTHSR_TOKEN"
    return ServiceError(f"the service answered {answer.status_code}: {text}", problem=problem)
