"""The subcommands of the service: ``serve``, ``submit``, ``export``, ``settings``."""

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
    from service.jobs.paths import OURS
    from service.options import add_options

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
    add_options(submit.add_argument_group("method"), Settings)
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
    not_theirs = (*OURS, "view_at", "segment_length")
    add_options(export.add_argument_group("output"), OutputOptions, leave_out=not_theirs)
    export.set_defaults(command=_run_export)


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
    for sentence in config.open_doors():
        logging.getLogger(__name__).warning(sentence)
    Store(config.data).close()  # another service, or a newer one: said before any address is
    serve(create_app(config), config, say=say)
    return EXIT_DONE


def _run_submit(arguments: argparse.Namespace) -> int:
    import dataclasses

    from pipeline.config import Settings
    from pipeline.job import InputOptions, OutputOptions
    from service.client import ServiceError, scene_files, scene_name
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
            if not any(path.is_file() for path in files.values()):
                raise ServiceError(f"{arguments.scene}: there is no such scene")
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
    videos = [item for item in client.results(job_id) if item.media_type.startswith("video/")]
    for result in videos:
        own_end = result.name.partition(".")[2]
        file = target if len(videos) == 1 else target.with_name(f"{target.stem}.{own_end}")
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
