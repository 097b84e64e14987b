"""Segments computed by many machines: the only door to Dask distributed.

The engine is Dask's own: its scheduler and its workers, started as its documentation says
(``dask scheduler``, ``dask worker ADDRESS``). A task is one segment, the very one that a local
run computes, its warm-up frames included; so the results are the same, bit for bit, where the
workers have the same versions. Scene, work folder and pictures are read and written by path, on
storage that all workers share; through the engine go orders and news alone. A worker that dies
costs its segment another try. The scheduler need not have depthsr; the workers must.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import queue
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from distributed import Client, Future, KilledWorker, get_worker
from distributed.worker import Worker as DaskWorker

from pipeline.compile_notice import compile_notice
from pipeline.errors import ClusterError, ConfigurationError, PipelineError
from pipeline.events import Compiling, Event, SegmentFinished, Warned
from pipeline.fingerprint import scene_files
from pipeline.job import Job, Segment
from pipeline.line import Work
from pipeline.media.media_sink import MediaSink
from pipeline.report import versions
from pipeline.segments import FrameComputed, LocalEngine, is_finished, open_source
from pipeline.sink import OutputPlan, Sink
from pipeline.stop import StopFlag
from pipeline.workfolder import SegmentFiles

PATIENCE = 10.0
"""Seconds that a scheduler may take to answer, and its first worker to appear."""

POLL = 0.2
"""Seconds between two looks at the stop flag."""

LETTING_GO = 5.0
"""Seconds that workers may take to drop what is cancelled before we leave all the same."""


@dataclass(frozen=True, kw_only=True)
class _Order:
    """One segment for one worker."""

    work: Work
    segment: Segment
    topic: str
    """Where its news go."""
    token: Path
    """A file that is there as long as the results are wanted."""
    make_sink: Callable[[OutputPlan], Sink]


class _Client(Client):
    """One that closes itself where it is refused.

    Else the garbage collector closes it in whatever thread it runs: in one that another client has
    just begun to start, each of the two waits for the other.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        try:
            super().__init__(*arguments, **named)
        except BaseException:
            self.close()
            raise


class ClusterEngine:
    """Computes segments on the workers of a Dask scheduler; see :class:`pipeline.segments.Engine`.

    Parameters
    ----------
    address : str
        Of the scheduler: ``tcp://HOST:PORT``, or ``tls://HOST:PORT`` with the certificates of
        Dask's configuration.
    patience : float
        Seconds that it may take to answer, and its first worker to appear.
    make_sink : callable
        Makes where the results go of the plan, on the workers: it travels there as a pickle, and
        must make what the sink of the run makes.

    Raises
    ------
    ClusterError
        If no scheduler answers, or it has no worker.
    """

    def __init__(
        self,
        address: str,
        *,
        patience: float = PATIENCE,
        make_sink: Callable[[OutputPlan], Sink] = MediaSink,
    ) -> None:
        self.address = address
        self._make_sink = make_sink
        # what becomes of a connection that is lost is told by our errors, not by its tracebacks
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # versions are our own check
                self._client = _Client(
                    address, timeout=patience, set_as_default=False, name="depthsr"
                )
        except (OSError, ValueError, TypeError) as error:
            raise ClusterError(
                f"--cluster {address}: no scheduler answers there ({_first_line(error)}); "
                "start one with 'dask scheduler'"
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=patience)
        except TimeoutError as error:
            self.close()
            raise ClusterError(
                f"--cluster {address}: the scheduler has no worker; "
                f"start some with 'dask worker {address}'"
            ) from error

    def __enter__(self) -> ClusterEngine:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def wait_for_workers(self, count: int, patience: float = PATIENCE) -> None:
        """Wait until the scheduler has so many workers; raise TimeoutError where it has not."""
        self._client.wait_for_workers(count, timeout=patience)

    def close(self) -> None:
        """Leave the scheduler, which goes on."""
        self._client.close()

    def compute(
        self,
        work: Work,
        segments: Sequence[Segment],
        *,
        on_event: Callable[[Event], None],
        stop: StopFlag,
    ) -> None:
        """Compute the segments; see :class:`pipeline.segments.Engine`.

        Raises
        ------
        ConfigurationError
            If the job is to hold a rate.
        ClusterError
            If a worker cannot do this job, if several died of the same segment, or if the
            scheduler is lost.
        """
        if work.job.settings.realtime:
            raise ConfigurationError("--realtime: holds the rate of one machine, not of --cluster")
        work = _with_whole_paths(work)
        work = replace(work, job=self._with_threads(work.job, len(segments)))
        self._check_workers(work)
        name = f"depthsr-{uuid.uuid4().hex}"
        token = work.folder / f"{name}.run"
        token.touch()
        inbox: queue.SimpleQueue[Mapping[str, Any] | Future] = queue.SimpleQueue()
        self._client.subscribe_topic(name, lambda event: inbox.put(event[1]))
        waiting: dict[str, tuple[Segment, Future]] = {}
        is_told = False
        try:
            for segment in segments:
                order = _Order(
                    work=work, segment=segment, topic=name, token=token, make_sink=self._make_sink
                )
                future = self._client.submit(
                    _call("compute_segment"), pickle.dumps(order),
                    key=f"{name}-{segment.name}", pure=False,
                )  # fmt: skip
                waiting[str(future.key)] = (segment, future)
                future.add_done_callback(inbox.put)
            while waiting:
                stop.check()
                try:
                    item = inbox.get(timeout=POLL)
                except queue.Empty:
                    continue
                if isinstance(item, Future):
                    segment, future = waiting.pop(str(item.key))
                    self._settle(segment, future)
                    on_event(SegmentFinished(index=segment.index, count=work.num_segments))
                    continue
                event = _event(item)
                if isinstance(event, Compiling) and is_told:
                    continue  # another worker said so
                is_told = is_told or isinstance(event, Compiling)
                on_event(event)
        finally:
            token.unlink(missing_ok=True)
            if self._client.status == "running":  # else the scheduler is lost
                self._client.unsubscribe_topic(name)
                self._let_go([future for _, future in waiting.values()])

    def _with_threads(self, job: Job, num_segments: int) -> Job:
        """Return the job with the threads of a segment's hot loops.

        A worker computes as many segments at once as it has threads, so that each needs one;
        where segments are fewer than threads, they share them out.
        """
        if job.settings.threads:
            return job
        workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        counts = [worker["nthreads"] for worker in workers] or [1]
        threads = max(1, min(*counts, sum(counts) // num_segments))
        return replace(job, settings=replace(job.settings, threads=threads))

    def _check_workers(self, work: Work) -> None:
        """Raise ClusterError unless every worker has our versions and sees our files."""
        order = pickle.dumps(
            {
                "versions": _versions(),
                "scene": scene_files(work.job, work.plan.targets),
                "work": pickle.dumps(work),
            }
        )
        answers = self._client.run(_call("examine"), order, on_error="return")
        for address, answer in answers.items():
            if isinstance(answer, ModuleNotFoundError):
                answer = f"it cannot import depthsr ({answer}); install the same version there"
            elif isinstance(answer, BaseException):
                answer = _first_line(answer)
            if answer:
                raise ClusterError(f"--cluster {self.address}: worker {address}: {answer}")

    def _settle(self, segment: Segment, future: Future) -> None:
        """Raise what went wrong with a segment, if anything.

        A segment whose worker died after its end is lost to Dask, not to us: its files are there.
        """
        if future.status in ("finished", "lost"):
            return
        if future.status != "error":
            raise ClusterError(
                f"--cluster {self.address}: the scheduler is lost; "
                "--resume goes on from the segments that are finished"
            )
        error = future.exception()
        if isinstance(error, KilledWorker):
            raise ClusterError(
                f"{segment.name}: {error.allowed_failures + 1} workers died of it, the last of "
                f"them {error.last_worker.address}; their logs may tell why (memory?)"
            ) from error
        if isinstance(error, PipelineError):
            raise error
        raise ClusterError(
            f"{segment.name}: failed on a worker: {type(error).__name__}: {_first_line(error)}"
        ) from error

    def _let_go(self, futures: list[Future]) -> None:
        """Cancel what is not done, and wait a little until no worker computes it any more."""
        keys = {future.key for future in futures}
        with contextlib.suppress(Exception):  # the scheduler may be what is lost
            self._client.cancel(futures, force=True)
            end = time.monotonic() + LETTING_GO
            while time.monotonic() < end and any(
                keys.intersection(running)
                for running in self._client.run(_call("running_tasks"), b"").values()
            ):
                time.sleep(POLL)


def _event(news: Mapping[str, Any]) -> Event:
    if "frame" in news:
        return FrameComputed(frame_index=news["frame"])
    if "compiling" in news:
        return Compiling()
    return Warned(text=news["warning"])


def _first_line(error: BaseException | None) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def _versions() -> dict[str, str]:
    """Return the versions that decide the result; of Python the first two numbers."""
    found = versions()
    return {**found, "python": ".".join(found["python"].split(".")[:2])}


def _with_whole_paths(work: Work) -> Work:
    """Return the work with absolute paths: workers have other working folders."""

    def whole(path: Path | None) -> Path | None:
        return None if path is None else path.absolute()

    def output(options: Any) -> Any:
        names = ("output", "frames_dir", "report", "debug_dir")
        return replace(options, **{name: whole(getattr(options, name)) for name in names})

    job = replace(work.job, scene=work.job.scene.absolute(), output=output(work.job.output))
    plan = replace(work.plan, options=output(work.plan.options))
    return replace(work, job=job, plan=plan, folder=work.folder.absolute())


# --- on the workers ---------------------------------------------------------------------------


def _call(name: str) -> Callable[[bytes], Any]:
    """Return a function that calls one of this module; it travels whole.

    Neither it nor its argument, a pickle in a pickle, asks the scheduler for this package. Where
    the worker keeps what it compiles is decided before it imports what would be compiled.
    """

    def call(order: bytes) -> Any:
        import importlib

        importlib.import_module("pipeline.numba_cache").prepare_numba_cache()
        return getattr(importlib.import_module("pipeline.cluster"), name)(order)

    return call


def examine(order: bytes) -> str:
    """Return why this worker cannot do a job, in words; an empty text where it can."""
    told = pickle.loads(order)
    ours = _versions()
    for name, version in told["versions"].items():
        if ours.get(name) != version:
            return f"it has {name} {ours.get(name)}, not {version}; install the same version there"
    work = pickle.loads(told["work"])
    try:
        if scene_files(work.job, work.plan.targets) != told["scene"]:
            return f"it does not see the same files of the scene at {work.job.scene}"
        for folder in (work.folder, work.job.output.frames_dir):
            if folder is not None:
                with tempfile.TemporaryFile(dir=folder):
                    pass
    except OSError as error:
        return f"{error.filename}: {error.strerror}; scene and output must be on shared storage"
    return ""


def running_tasks(_: bytes) -> list[str]:
    """Return the keys of the tasks that this worker's threads are busy with."""
    return [str(key) for key in get_worker().active_threads.values()]


def compute_segment(order: bytes) -> None:
    """Compute one segment on this worker."""
    told: _Order = pickle.loads(order)
    worker = get_worker()
    sink = told.make_sink(told.work.plan)
    if is_finished(SegmentFiles(told.work.folder), sink, told.segment):
        return  # a worker died between its last file and its answer

    def tell(event: Event) -> None:
        if isinstance(event, FrameComputed):
            worker.log_event(told.topic, {"frame": event.frame_index})
        elif isinstance(event, Warned):
            worker.log_event(told.topic, {"warning": event.text})

    def tell_compiling() -> None:
        worker.log_event(told.topic, {"compiling": True})

    with open_source(told.work.job) as source, compile_notice(tell_compiling):
        LocalEngine(source, sink).compute(
            told.work, [told.segment], on_event=tell, stop=_Unwanted(worker, told.token)
        )


class _Unwanted(StopFlag):
    """Set once the task is cancelled, its client or its worker has gone, or its run has ended."""

    def __init__(self, worker: DaskWorker, token: Path) -> None:
        super().__init__()
        self._worker = worker
        self._key = worker.get_current_task()
        self._token = token

    @property
    def is_set(self) -> bool:
        task = self._worker.state.tasks.get(self._key)
        wanted = task is not None and task.state in ("executing", "long-running", "resumed")
        return not (wanted and self._token.exists())
