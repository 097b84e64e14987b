"""A process of its own that does jobs: requests on stdin, what happens on stdout.

stdin: a line of JSON for a job (:class:`WorkOrder`), another one after its ``done``; the line
``stop`` ends the job; the end of stdin means that the service is gone, and this process ends at
once. stdout: one line of JSON for each event (``{"event": KIND, ...}``), a ``beat`` every second,
a ``piece`` when there is more to watch, and last ``done``, or ``stopped`` or ``problem`` before
the process ends. Decoding and computing happen here only, with the memory that the service allows.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import signal
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from service.child import Voice, begin, limit_memory, log_to, step_back, take_stdout

LOG = "worker.log"
"""Name of the file in a job's folder that its workers' words go to."""


@dataclass(frozen=True, kw_only=True)
class WorkOrder:
    """What a worker is to do."""

    request: dict[str, Any]
    scene: str
    folder: str
    """Of the job; results go to ``results`` in it."""
    name: str = "result"
    threads: int = 0
    memory: int = 0
    """Address space, bytes; 0 is no limit."""
    max_pixels: int = 1 << 25
    max_frames: int = 100_000
    nice: int = 0
    cluster: str = ""
    """Address of the Dask scheduler whose workers compute the segments; "": this process does."""


def main() -> int:
    """Do the jobs that stdin orders, until one of them does not end well."""
    voice = take_stdout()
    orders = begin(voice)
    from pipeline.numba_cache import prepare_numba_cache

    prepare_numba_cache()
    while _serve(WorkOrder(**json.loads(orders.get())), voice):
        pass
    return 1


def _serve(order: WorkOrder, voice: Voice) -> bool:
    """Do one job; return whether this process is good for another one."""
    log_to(Path(order.folder) / LOG)
    limit_memory(order.memory)
    step_back(order.nice)
    from pipeline.errors import Interrupted, PipelineError
    from service.problem_table import DISK_FULL, problem

    try:
        with (Path(order.folder) / "worker.lock").open("w") as lock:
            _wait_for(lock)
            said = _work(order, voice)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # between jobs there is nothing to stop
        voice.say("done", **said)
        return True
    except Interrupted:
        voice.say("stopped")
    except PipelineError as error:
        text = str(error).replace(order.folder + "/", "")
        voice.say("problem", problem=problem(_kind(error), text))
    except MemoryError:
        voice.say("problem", problem=problem("memory-limit", "the worker ran out of memory"))
    except OSError as error:
        kind = "disk-full" if error.errno in DISK_FULL else "output-error"
        voice.say("problem", problem=problem(kind, error.strerror or type(error).__name__))
    return False


def _work(order: WorkOrder, voice: Voice) -> dict[str, Any]:
    """Do the job, once; a worker that died after its work has left its last word."""
    from pipeline.events import Event
    from pipeline.media.files import TEMPORARY_SUFFIX, write_atomic
    from pipeline.stop import StopFlag

    folder = Path(order.folder)
    for path in folder.rglob(f".*{TEMPORARY_SUFFIX}"):
        path.unlink(missing_ok=True)  # half written by a worker that is no more
    results = folder / "results"
    results.mkdir(exist_ok=True)
    finished = folder / "done.json"
    if (kept := _kept(finished)) is not None:
        return kept

    def tell(event: Event) -> None:
        voice.say(type(event).__name__, **asdict(event))

    stop = StopFlag()
    signal.signal(signal.SIGTERM, stop.from_signal)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service's to handle
    work = _export if "export" in order.request else _compute
    said = work(order, voice, tell, stop)
    write_atomic(finished, json.dumps(said).encode())
    return said


def _export(order: WorkOrder, voice: Voice, tell: Any, stop: Any) -> dict[str, Any]:
    from pipeline.export import export
    from service.jobs.request import ExportForm, export_options
    from service.jobs.sinks import master_in

    begin = time.monotonic()
    form = ExportForm.model_validate(order.request["export"])
    options = export_options(form, Path(order.folder) / "results", order.name)
    frames = export(master_in(Path(order.scene)), options, on_event=tell, stop=stop)
    return {"frames": frames, "seconds": time.monotonic() - begin}


def _compute(order: WorkOrder, voice: Voice, tell: Any, stop: Any) -> dict[str, Any]:
    from pipeline.compile_notice import compile_notice
    from pipeline.errors import SceneError
    from pipeline.events import Compiling, Event, SegmentFinished
    from pipeline.export import export
    from pipeline.media.files import write_atomic
    from pipeline.media.source import FrameSource, open_scene
    from pipeline.run import Tools, run_job
    from service.jobs.request import JobRequest, export_options, make_job
    from service.jobs.sinks import WATCH, JobSinks, master_in
    from service.jobs.watch_sink import EyeSources, FoundPieces, untold

    folder = Path(order.folder)
    results = folder / "results"
    request: Any = JobRequest.model_validate(order.request)
    job = make_job(request, Path(order.scene), results, name=order.name, threads=order.threads)

    def open_checked(path: Path, **options: Any) -> FrameSource:
        source = open_scene(path, **options)
        info = source.info
        height, width = info.lr_shape
        if height * width > order.max_pixels or len(info.frame_indices) > order.max_frames:
            source.close()
            raise SceneError(
                f"{width}x{height} pixels, {len(info.frame_indices)} frames: more than the "
                f"service takes ({order.max_pixels} pixels, {order.max_frames} frames)"
            )
        return source

    def tell_piece(track: str, number: int) -> None:
        voice.say("piece", track=track, number=number)

    remote = JobSinks(
        folder=folder.absolute(),
        sources=EyeSources(open_scene=open_scene, scene=job.scene.absolute(), options=job.input),
        keep_master=request.output.master,
    )
    is_ours = not order.cluster or job.settings.realtime  # the rate that is held is one machine's
    sinks = dataclasses.replace(remote, on_piece=tell_piece if is_ours else untold)
    found = FoundPieces(folder / WATCH, tell_piece)

    def tell_more(event: Event) -> None:
        tell(event)
        if not is_ours and isinstance(event, SegmentFinished):
            found.look()

    computed = folder / "computed.json"
    said = _kept(computed)
    if said is None:  # else an earlier worker died over the exports
        tools = dataclasses.replace(Tools(), open_scene=open_checked, make_sink=sinks)
        with contextlib.ExitStack() as stack:
            engine = None
            if not is_ours:
                from pipeline.cluster import ClusterEngine

                engine = stack.enter_context(ClusterEngine(order.cluster, make_sink=remote))
            stack.enter_context(compile_notice(lambda: tell(Compiling())))
            summary = run_job(
                job, on_event=tell_more, stop=stop, resume=True, engine=engine, tools=tools
            )
        said = {"frames": summary.frames, "seconds": summary.seconds}
        write_atomic(computed, json.dumps(said).encode())
    for form in request.exports:
        options = export_options(form, results, order.name)
        if options.output is None or not options.output.exists():
            export(master_in(folder), options, stop=stop)
    return said


def _kept(path: Path) -> dict[str, Any] | None:
    """Return what an earlier worker has left behind; None where there is nothing whole."""
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    return said if isinstance(said, dict) else None


def _kind(error: Exception) -> str:
    from service.problem_table import DISK_FULL

    cause = error.__cause__
    if isinstance(cause, OSError) and cause.errno in DISK_FULL:
        return "disk-full"
    return str(getattr(error, "code", "internal"))


def _wait_for(lock: IO[str]) -> None:
    """Wait until an earlier worker of the job is gone; the watchdog bounds the wait."""
    import fcntl

    fcntl.flock(lock, fcntl.LOCK_EX)


if __name__ == "__main__":
    sys.exit(main())
