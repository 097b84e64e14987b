"""A process of its own that does one job: the request on stdin, what happens on stdout.

stdin: one line of JSON (:class:`WorkOrder`); later the line ``stop``; its end means that the
service is gone, and this process ends at once. stdout: one line of JSON for each event
(``{"event": KIND, ...}``), a ``beat`` every second, a ``piece`` when there is more to watch,
and last ``done`` or ``problem``. Decoding
and computing happen here only, with the memory that the service allows.
"""

from __future__ import annotations

import dataclasses
import json
import signal
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from service.child import Voice, begin, limit_memory, take_stdout


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


def main() -> int:
    """Do the job that stdin orders."""
    voice = take_stdout()
    order = WorkOrder(**json.loads(sys.stdin.readline()))
    limit_memory(order.memory)
    begin(voice)

    from service.numba_cache import prepare_numba_cache

    prepare_numba_cache()
    from pipeline.errors import Interrupted, PipelineError
    from service.http.problems import problem

    try:
        with (Path(order.folder) / "worker.lock").open("w") as lock:
            _wait_for(lock)
            voice.say("done", **_work(order, voice))
        return 0
    except Interrupted:
        voice.say("stopped")
    except PipelineError as error:
        text = str(error).replace(order.folder + "/", "")
        voice.say("problem", problem=problem(_kind(error), text))
    except MemoryError:
        voice.say("problem", problem=problem("memory-limit", "the worker ran out of memory"))
    except OSError as error:
        kind = "disk-full" if error.errno in (28, 122) else "output-error"
        voice.say("problem", problem=problem(kind, error.strerror or type(error).__name__))
    return 1


def _work(order: WorkOrder, voice: Voice) -> dict[str, Any]:
    """Do the job, once; a worker that died after its work has left its last word."""
    from pipeline.events import Event
    from pipeline.media.files import write_atomic
    from pipeline.stop import StopFlag

    results = Path(order.folder) / "results"
    results.mkdir(exist_ok=True)
    finished = Path(order.folder) / "done.json"
    if finished.exists():
        return json.loads(finished.read_text(encoding="utf-8"))

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
    from pipeline.errors import SceneError
    from pipeline.export import export
    from pipeline.media.files import write_atomic
    from pipeline.media.source import FrameSource, open_scene
    from pipeline.run import Tools, run_job
    from service.jobs.request import JobRequest, export_options, make_job
    from service.jobs.sinks import JobSinks, master_in
    from service.jobs.watch_sink import EyeSources

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

    sinks = JobSinks(
        folder=folder,
        sources=EyeSources(open_scene=open_scene, scene=job.scene, options=job.input),
        keep_master=request.output.master,
        on_piece=tell_piece,
    )

    computed = folder / "computed.json"
    if not computed.exists():  # else an earlier worker died over the exports
        tools = dataclasses.replace(Tools(), open_scene=open_checked, make_sink=sinks)
        summary = run_job(job, on_event=tell, stop=stop, resume=True, tools=tools)
        said = {"frames": summary.frames, "seconds": summary.seconds}
        write_atomic(computed, json.dumps(said).encode())
    for form in request.exports:
        options = export_options(form, results, order.name)
        if options.output is None or not options.output.exists():
            export(master_in(folder), options, stop=stop)
    return dict(json.loads(computed.read_text(encoding="utf-8")))


def _kind(error: Exception) -> str:
    cause = error.__cause__
    if isinstance(cause, OSError) and cause.errno in (28, 122):
        return "disk-full"
    return str(getattr(error, "code", "internal"))


def _wait_for(lock: IO[str]) -> None:
    """Wait until an earlier worker of the job is gone; the watchdog bounds the wait."""
    import fcntl

    fcntl.flock(lock, fcntl.LOCK_EX)


if __name__ == "__main__":
    sys.exit(main())
