"""The subcommands of the service: ``serve``, ``settings``, and those that talk to it."""

from __future__ import annotations

import argparse
import logging
import os
import sys
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.console import EXIT_DONE, EXIT_FAILURE
from service.terminal import add_server, say, token_of

if TYPE_CHECKING:
    from service.client import Client


def add_serve(commands: Any) -> None:
    """Add the subcommands to the command line."""
    from pipeline.config import Settings
    from pipeline.job import InputOptions, OutputOptions
    from service.jobs.paths import NO_EXPORTS, NOT_OF_EXPORTS, OURS
    from service.options import METHOD_WORDS, add_options

    serve = commands.add_parser(
        "serve",
        help="serve jobs over HTTP",
        description="Serve jobs over HTTP, on this machine alone unless told otherwise.",
    )
    _add_config(serve)
    serve.set_defaults(command=_run_serve)

    settings = commands.add_parser(
        "settings",
        help="print the settings of the service and where each comes from",
        description="Print every setting of the service, its value and its origin.",
    )
    _add_config(settings)
    settings.set_defaults(command=_run_settings)

    submit = commands.add_parser(
        "submit",
        help="send a scene to a service, and fetch the result",
        description="Send a scene to a service; watch the job; fetch the result.",
    )
    submit.add_argument("scene", type=Path, metavar="SCENE", help="as for run")
    add_server(submit, "bearer token")
    submit.add_argument(
        "--by-path", action="store_true", help="name the scene under a root instead of sending it"
    )
    submit.add_argument(
        "--priority", type=int, default=0, metavar="N", help="-10 to 10 (default: 0)"
    )
    submit.add_argument("--watch", action="store_true", help="show progress until it is over")
    submit.add_argument(
        "-o", "--output", type=Path, metavar="FILE",
        help="where to write the video; waits for the end",
    )  # fmt: skip
    add_options(submit.add_argument_group("input"), InputOptions)
    add_options(submit.add_argument_group("output"), OutputOptions, leave_out=OURS)
    add_options(submit.add_argument_group("method", METHOD_WORDS), Settings)
    submit.set_defaults(command=_run_submit)

    export = commands.add_parser(
        "export",
        help="fetch what a job of a service made, in another form",
        description="Have a finished job's result in another form, made from its lossless master; "
        "fetch it.",
    )
    export.add_argument("job", metavar="JOB", help="id of the job, as submit prints it")
    add_server(export, "bearer token")
    export.add_argument("--watch", action="store_true", help="show progress")
    export.add_argument(
        "-o", "--output", type=Path, metavar="FILE", required=True,
        help="where to write the video; a .zip is a lossless PNG of each eye and frame",
    )  # fmt: skip
    add_options(
        export.add_argument_group("output"), OutputOptions,
        leave_out=NOT_OF_EXPORTS, without=NO_EXPORTS,
    )  # fmt: skip
    export.set_defaults(command=_run_export)
    _add_later(commands)


def _add_later(commands: Any) -> None:
    """Add what is done with a job that was sent before."""
    from service.jobs.states import State

    jobs = commands.add_parser(
        "jobs",
        help="list the jobs of a service",
        description="List the jobs of a service, newest first: id, state, frames, name.",
    )
    add_server(jobs, "bearer token")
    states = [state.value for state in State]
    jobs.add_argument("--state", choices=states, help="only those (default: all)")
    jobs.set_defaults(command=_run_jobs)

    fetch = commands.add_parser(
        "fetch",
        help="wait for a job of a service, and fetch what it made",
        description="Wait for the end of a job, and fetch what it made, as it is.",
    )
    fetch.add_argument("job", metavar="JOB", help="id of the job, as submit prints it")
    add_server(fetch, "bearer token")
    fetch.add_argument("--watch", action="store_true", help="show progress")
    fetch.add_argument(
        "-o", "--output", type=Path, metavar="FILE", required=True,
        help="where to write the video; a .zip is all that it made",
    )  # fmt: skip
    fetch.set_defaults(command=_run_fetch)

    cancel = commands.add_parser(
        "cancel",
        help="stop a job of a service",
        description="Ask a job to stop. Its finished segments stay, for a retry.",
    )
    cancel.add_argument("job", metavar="JOB", help="id of the job, as submit prints it")
    add_server(cancel, "bearer token")
    cancel.set_defaults(command=_run_cancel)

    retry = commands.add_parser(
        "retry",
        help="let a failed or cancelled job of a service go on",
        description="Queue a failed or cancelled job again. It goes on from its last finished "
        "segment; fetch waits for it.",
    )
    retry.add_argument("job", metavar="JOB", help="id of the job, as submit prints it")
    add_server(retry, "bearer token")
    retry.set_defaults(command=_run_retry)


def _add_config(parser: argparse.ArgumentParser) -> None:
    from service.config import ServiceConfig
    from service.options import add_options

    parser.add_argument(
        "--config", type=Path, metavar="FILE",
        help="YAML or JSON file of settings (default: what DEPTHSR_CONFIG says)",
    )  # fmt: skip
    add_options(parser, ServiceConfig)


def _loaded(arguments: argparse.Namespace) -> Any:
    from service.config import ServiceConfig, load_config
    from service.options import collect

    named = os.environ.get("DEPTHSR_CONFIG")
    file = arguments.config or (Path(named) if named else None)
    return load_config(file=file, environment=os.environ, flags=collect(arguments, ServiceConfig))


def _run_settings(arguments: argparse.Namespace) -> int:
    from service.config import format_config

    sys.stdout.write(format_config(_loaded(arguments)) + "\n")
    return EXIT_DONE


def _run_serve(arguments: argparse.Namespace) -> int:
    from service.app import create_app
    from service.json_logs import configure
    from service.server import serve
    from service.store import Store

    config = _loaded(arguments).config
    configure(config.log_level)
    for sentence in (*config.open_doors(), *config.missing_roots()):
        logging.getLogger(__name__).warning(sentence)
    Store(config.data).close()  # another service, or a newer one: said before any address is
    serve(create_app(config), config, say=say)
    return EXIT_DONE


def _run_submit(arguments: argparse.Namespace) -> int:
    import dataclasses

    from pipeline.config import Settings
    from pipeline.job import InputOptions, OutputOptions
    from service.client import scene_files, scene_name
    from service.options import collect

    output = collect(arguments, OutputOptions)
    output.pop("output", None)
    if arguments.output is not None:
        output["container"] = arguments.output.suffix.removeprefix(".")
    given = collect(arguments, InputOptions)
    if "frames" in given:
        ends = dataclasses.astuple(given["frames"])
        given["frames"] = ":".join("" if end is None else str(end) for end in ends)
    request: dict[str, Any] = {
        "settings": collect(arguments, Settings),
        "input": given,
        "output": output,
        "priority": arguments.priority,
    }
    key = uuid.uuid4().hex
    with _client(arguments) as client:
        if arguments.by_path:
            job = client.submit({**request, "scene": str(arguments.scene)}, key=key)
        else:
            files = scene_files(arguments.scene)
            request["name"] = scene_name(arguments.scene)
            size = sum(path.stat().st_size for path in files.values())
            count = f"{len(files)} file{'s'[: len(files) != 1]}"
            sys.stderr.write(f"sending {count}, {size / 1e6:.1f} MB\n")
            job = client.submit_files(files, request, key=key)
        sys.stdout.write(f"job {job.id}\n")
        sys.stdout.flush()
        if not arguments.watch and arguments.output is None:
            return EXIT_DONE
        if not _succeeds(client, job.id, arguments.watch):
            return EXIT_FAILURE
        if arguments.output is not None:
            _fetch_video(client, job.id, arguments.output)
    return EXIT_DONE


def _run_export(arguments: argparse.Namespace) -> int:
    from pipeline.job import OutputOptions
    from service.options import collect

    form = collect(arguments, OutputOptions)
    form.pop("output", None)
    ending = arguments.output.suffix.lower().removeprefix(".")
    is_pictures = ending == "zip"
    form |= {"video": False, "frames": True} if is_pictures else {"container": ending}
    with _client(arguments) as client:
        job = client.export(arguments.job, form)
        if not _succeeds(client, job.id, arguments.watch):
            return EXIT_FAILURE
        if is_pictures:
            client.download_archive(job.id, arguments.output)
            _say_written(arguments.output)
        else:
            _fetch_video(client, job.id, arguments.output)
    return EXIT_DONE


def _run_jobs(arguments: argparse.Namespace) -> int:
    with _client(arguments) as client:
        for job in client.jobs(state=arguments.state):
            total = "?" if job.frames_total is None else job.frames_total
            frames = f"{job.frames_done} of {total}"
            sys.stdout.write(f"{job.id}  {job.state:<10}  {frames:>12}  {job.name}\n")
    return EXIT_DONE


def _run_fetch(arguments: argparse.Namespace) -> int:
    with _client(arguments) as client:
        if not _succeeds(client, arguments.job, arguments.watch):
            return EXIT_FAILURE
        if arguments.output.suffix.lower() == ".zip":
            client.download_archive(arguments.job, arguments.output)
            _say_written(arguments.output)
        else:
            _fetch_video(client, arguments.job, arguments.output)
    return EXIT_DONE


def _run_cancel(arguments: argparse.Namespace) -> int:
    with _client(arguments) as client:
        sys.stdout.write(f"{client.cancel(arguments.job).state}\n")
    return EXIT_DONE


def _run_retry(arguments: argparse.Namespace) -> int:
    with _client(arguments) as client:
        sys.stdout.write(f"{client.retry(arguments.job).state}\n")
    return EXIT_DONE


def _client(arguments: argparse.Namespace) -> Client:
    from service.client import Client

    return Client(arguments.server, token=token_of(arguments))


def _succeeds(client: Client, job_id: str, watch: bool) -> bool:
    """Wait for the end of a job; say what became of it where it did not succeed."""
    for event in client.events(job_id):
        if watch:
            sys.stderr.write(_line(event.kind, event.data) + "\n")
    job = client.job(job_id)
    if job.state == "succeeded":
        return True
    said = (job.problem or {}).get("detail", job.state)
    sys.stderr.write(f"depthsr: error: job {job.id} {job.state}: {said}\n")
    return False


def _fetch_video(client: Client, job_id: str, target: Path) -> None:
    """Fetch the video; each of several, as of all views, under a name that ends as its own does."""
    from service.client import ServiceError

    videos = [item for item in client.results(job_id) if item.media_type.startswith("video/")]
    if len(videos) == 1:
        files = {target: videos[0]}
    else:
        ends = (item.name.partition(".")[2] for item in videos)
        named = (target.with_name(f"{target.stem}.{end}") for end in ends)
        files = dict(zip(named, videos, strict=True))
    fitting = [file for file, item in files.items() if item.name.endswith(file.suffix.lower())]
    if not videos or len(fitting) < len(videos):
        made = ", ".join(item.name for item in videos) or "no video"
        raise ServiceError(f"{target}: the job has made {made}; take it as .zip, or export it")
    for file, result in files.items():
        client.download(result, file)
        _say_written(file)


def _say_written(target: Path) -> None:
    sys.stdout.write(f"wrote {target}: {target.stat().st_size} bytes\n")


def _line(kind: str, data: Any) -> str:
    if kind == "FrameFinished":
        return f"frame {data['done']} of {data['total']}"
    if kind == "Warned":
        return f"warning: {data['text']}"
    if kind == "JobStarted":
        return f"{data['frames_total'] - data['frames_done']} frames to come"
    if kind == "SegmentFinished":
        return f"segment {data['index'] + 1} of {data['count']}"
    if kind == "JobFinished":
        return f"computed in {data['seconds']:.1f} s"
    return kind.lower()
