"""The subcommands for streams: ``publish`` and ``subscribe``."""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

from service.console import EXIT_DONE, EXIT_FAILURE, EXIT_INTERRUPTED

PATIENCE = 5.0
"""How long a service that is not there yet is waited for, seconds."""

WINDOW_PLAYERS = {
    "mpv": (
        "mpv", "--no-config", "--really-quiet", "--profile=low-latency", "--untimed", "--no-cache",
        "--demuxer-lavf-format=h264", "--title=depthsr", "-",
    ),
    "ffplay": (
        "ffplay", "-loglevel", "error", "-fflags", "nobuffer", "-flags", "low_delay",
        "-window_title", "depthsr", "-f", "h264", "-",
    ),
}  # fmt: skip
"""Players that show an H.264 byte stream from a pipe, the better one first."""


def add_streams(commands: Any) -> None:
    """Add the subcommands to the command line."""
    _add_publish(commands)
    _add_subscribe(commands)


def _add_publish(commands: Any) -> None:
    from pipeline.job import InputOptions
    from service.options import add_options

    parser = commands.add_parser(
        "publish",
        help="send live cameras, or a scene as if it were some, into a stream",
        description="Send into a stream, over zenoh, what cameras on the network see (--camera for "
        "each); or play a scene as live cameras: the manifest, then every view's picture and depth "
        "map at its time.",
    )
    parser.add_argument(
        "scene", type=Path, nargs="?", metavar="SCENE",
        help="as for run; with cameras: a manifest of theirs, for calibration and stereo pair",
    )  # fmt: skip
    parser.add_argument(
        "--camera", action="append", type=_camera, metavar="NAME=ADDRESS",
        help="a camera, as FFmpeg opens it (rtsp://HOST/PATH, udp://, http://); once for each, "
        "left to right",
    )  # fmt: skip
    parser.add_argument("--stream", required=True, metavar="NAME", help="name of the stream")
    parser.add_argument(
        "--rate", type=_rate, metavar="N",
        help="frames a second (default: the scene's, or the left eye's camera's)",
    )  # fmt: skip
    parser.add_argument("--loop", action="store_true", help="begin again at the end, for ever")
    parser.add_argument(
        "--encoding", choices=("jpeg", "png", "raw"),
        help="how colour is sent (default: as it lies on disk, or JPEG)",
    )  # fmt: skip
    parser.add_argument(
        "--jitter", type=float, default=0.0, metavar="N",
        help="each picture is late by up to this [seconds] (default: 0)",
    )  # fmt: skip
    parser.add_argument(
        "--loss", type=float, default=0.0, metavar="N",
        help="share of pictures that are left out, 0 to 1 (default: 0)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="of jitter and loss (default: 1)"
    )
    add_options(parser, InputOptions, leave_out=("frames", "views"))
    _add_bus(parser)
    parser.set_defaults(command=_run_publish)


def _add_subscribe(commands: Any) -> None:
    parser = commands.add_parser(
        "subscribe",
        help="receive a stream: into a file, or to look at",
        description="Receive the super-resolved pictures of a stream over zenoh: into a file "
        "without coding them again, or into the window of mpv or ffplay.",
    )
    parser.add_argument("stream", metavar="NAME", help="name of the stream")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="file to write (.mkv, .mp4, .h264)"
    )
    where.add_argument("--window", action="store_true", help="show it with mpv or ffplay")
    parser.add_argument("--frames", type=int, metavar="N", help="end after so many")
    parser.add_argument(
        "--wait", type=float, metavar="N",
        help="end when nothing comes for so long [seconds] (default: never)",
    )  # fmt: skip
    _add_bus(parser)
    parser.set_defaults(command=_run_subscribe)


def _add_bus(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("zenoh")
    from service.bus.config import DEFAULT_ENDPOINT

    group.add_argument(
        "--connect", type=_endpoints, default=(DEFAULT_ENDPOINT,), metavar="ENDPOINT,...",
        help=f"where the service or a router is (default: {DEFAULT_ENDPOINT})",
    )  # fmt: skip
    group.add_argument("--ca", type=Path, metavar="FILE", help="certificate of the authority")
    group.add_argument("--certificate", type=Path, metavar="FILE", help="our certificate (PEM)")
    group.add_argument("--key", type=Path, metavar="FILE", help="private key of our certificate")
    group.add_argument("--user", metavar="NAME", help="name to give")
    group.add_argument(
        "--password-file", type=Path, metavar="FILE",
        help="file of the password to give (default: what DEPTHSR_ZENOH_PASSWORD says)",
    )  # fmt: skip
    parser.add_argument("-q", "--quiet", action="store_true", help="say nothing but errors")
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="tracebacks of unexpected failures"
    )


@contextlib.contextmanager
def _connected(arguments: argparse.Namespace) -> Iterator[Any]:
    """Yield the bus, left again whatever happens."""
    from pipeline.errors import ConfigurationError
    from service.bus.config import BusConfig

    password = os.environ.get("DEPTHSR_ZENOH_PASSWORD")
    if arguments.password_file is not None:
        try:
            password = arguments.password_file.read_text(encoding="utf-8").strip()
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"--password-file: cannot be read: {error}") from error
    config = BusConfig(
        connect=arguments.connect,
        ca=arguments.ca,
        certificate=arguments.certificate,
        key=arguments.key,
        mutual_tls=arguments.certificate is not None,
        user=arguments.user,
        password=password,
    )
    with _opened(config) as bus:
        yield bus


def _opened(config: Any) -> Any:
    """Return the bus; a service that is just starting is waited for."""
    from service.bus.bus import BusError
    from service.bus.zenoh_bus import ZenohBus

    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return ZenohBus(config)
        except BusError as error:
            if time.monotonic() > deadline:
                hint = "depthsr serve starts a service, --connect names another"
                raise BusError(f"{error}; {hint}") from error
            time.sleep(0.25)


@contextlib.contextmanager
def _until_signal() -> Iterator[threading.Event]:
    """Yield an event that SIGINT and SIGTERM set."""
    stop = threading.Event()
    before = {
        number: signal.signal(number, lambda *_: stop.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run_publish(arguments: argparse.Namespace) -> int:
    from pipeline.errors import ConfigurationError
    from pipeline.media.layouts import describe_path
    from pipeline.media.live_frames import PictureEncoding
    from pipeline.media.live_source import LiveSource
    from pipeline.media.scene_source import with_pair
    from service.streams.player import Player, Playing

    _check_stream(arguments.stream)
    if arguments.camera:
        return _relay_cameras(arguments)
    if arguments.scene is None:
        raise ConfigurationError("SCENE: name a scene to play, or cameras (--camera NAME=ADDRESS)")
    if not 0 <= arguments.loss <= 1 or not 0 <= arguments.jitter <= 60:
        raise ConfigurationError("--loss: 0 to 1; --jitter: 0 to 60 seconds")
    scene = describe_path(arguments.scene, getattr(arguments, "input_layout", None))
    scene = with_pair(scene, *_pair(arguments))
    encoding = None if arguments.encoding is None else PictureEncoding.named(arguments.encoding)
    with (
        _until_signal() as stop,
        LiveSource(scene, encoding=encoding, fps=arguments.rate) as source,
        _connected(arguments) as bus,
    ):
        manifest = source.manifest
        playing = Playing(
            rate=manifest.fps,
            loop=arguments.loop,
            jitter=arguments.jitter,
            loss=arguments.loss,
            seed=arguments.seed,
        )
        player = Player(bus, arguments.stream, source, playing)
        if not arguments.quiet:
            views = len(manifest.view_ids)
            _note(f"{arguments.stream}: {views} views, {float(playing.rate):g} frames a second")
        played = player.play(stop)
    if not arguments.quiet:
        sys.stdout.write(
            f"published {played.frames} frames, {played.pictures} pictures, "
            f"{played.bytes / 1e6:.1f} MB; left out {played.lost}; "
            f"{1000 * played.late:.0f} ms late at the end\n"
        )
    return EXIT_INTERRUPTED if stop.is_set() and not arguments.loop else EXIT_DONE


def _pair(arguments: argparse.Namespace) -> tuple[str | None, str | None]:
    """Return the views that are to be the eyes, as far as they were named."""
    return getattr(arguments, "left", None), getattr(arguments, "right", None)


def _relay_cameras(arguments: argparse.Namespace) -> int:
    from pipeline.errors import ConfigurationError
    from pipeline.media.cameras import Cameras
    from pipeline.media.live_frames import PictureEncoding
    from pipeline.media.manifest import MANIFEST_NAME, read_json
    from service.streams.feed import Feed
    from service.streams.relay import manifest_of_cameras, relay

    addresses = dict(arguments.camera)
    if len(addresses) < len(arguments.camera):
        raise ConfigurationError("--camera: a name is given twice")
    if arguments.loop or arguments.jitter or arguments.loss or hasattr(arguments, "input_layout"):
        raise ConfigurationError(
            "--loop, --jitter, --loss, --input-layout: for a scene that is played only"
        )
    rig = None
    if arguments.scene is not None:
        path = arguments.scene
        path = path / MANIFEST_NAME if path.is_dir() else path
        try:
            rig = read_json(path.read_bytes(), path)
        except OSError as error:
            raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from error

    encoding = PictureEncoding.named(arguments.encoding or "jpeg")
    # refused before any camera is opened, if it is to be
    left, _ = manifest_of_cameras(
        addresses, arguments.rate or Fraction(1), rig, *_pair(arguments)
    ).pair
    addresses = {left: addresses[left], **addresses}  # there is no frame without the left eye
    with (
        _until_signal() as stop,
        _connected(arguments) as bus,
        Cameras(
            addresses, stop, fps=arguments.rate, encoding=encoding,
            on_news=lambda news: _note(str(news)),
        ) as cameras,
    ):  # fmt: skip
        manifest = manifest_of_cameras(
            dict(arguments.camera), cameras.fps, rig, *_pair(arguments)
        )  # fmt: skip
        if not arguments.quiet:
            rate = f"{float(cameras.fps):g} frames a second"
            _note(f"{arguments.stream}: {len(addresses)} cameras, {rate}")
        sent = relay(
            Feed(bus, arguments.stream, manifest), cameras.instants(), len(addresses)
        )  # fmt: skip
    if not arguments.quiet:
        sys.stdout.write(
            f"published {sent.frames} frames, {sent.pictures} pictures, "
            f"{sent.bytes / 1e6:.1f} MB; {sent.incomplete} frames lacked a camera; "
            f"left out {cameras.left_out} that could not be sent in time\n"
        )
    return EXIT_DONE


def _run_subscribe(arguments: argparse.Namespace) -> int:
    from pipeline.errors import ConfigurationError
    from service.streams.receiver import Receiver

    _check_stream(arguments.stream)
    suffix = "" if arguments.output is None else arguments.output.suffix.lower()
    if arguments.output is not None and suffix not in (".mkv", ".mp4", ".h264"):
        raise ConfigurationError(f"{arguments.output}: must end with .mkv, .mp4 or .h264")
    player = _window_player() if arguments.window else None
    with _until_signal() as stop, _connected(arguments) as bus:
        receiver = Receiver(bus, arguments.stream)
        units = _counted(receiver.units(stop=stop, timeout=arguments.wait), arguments.frames)
        if player is not None:
            count = _to_window(player, units)
        elif suffix in (".mkv", ".mp4"):
            count = _to_file(arguments.output, units)
        elif suffix:
            count = _to_raw(arguments.output, units)
        else:
            count = _to_lines(units)
        receiver.close()
    if not arguments.quiet:
        where = f", wrote {arguments.output}" if arguments.output is not None and count else ""
        _note(f"received {count} frames, missed {receiver.missed}{where}")
    if not count:
        sys.stderr.write(f"depthsr: error: stream {arguments.stream}: nothing came\n")
        return EXIT_FAILURE
    return EXIT_DONE


def _to_file(path: Path, units: Iterator[Any]) -> int:
    """Write the units into a container; a stream that changes its size ends the file."""
    from pipeline.media.live_file import live_file

    first = next(units, None)
    if first is None:
        return 0
    _note(f"{first.width}×{first.height}, {float(first.fps):g} frames a second")
    with live_file(path, first.fps) as file:
        file.add(first.data, first.position, is_key=first.is_key)
        last, shift = first.position, 0
        for unit in units:
            if (unit.width, unit.height, unit.fps) != (first.width, first.height, first.fps):
                _note(f"the stream is {unit.width}×{unit.height} now: {path} ends here")
                break
            if unit.is_new_run:
                shift = last + 1 - unit.position
                _note("the stream was started anew; some frames are missing")
            last = unit.position + shift
            file.add(unit.data, last, is_key=unit.is_key)
    return file.frames


def _to_raw(path: Path, units: Iterator[Any]) -> int:
    from pipeline.media.files import atomic_path

    count = 0
    first = next(units, None)
    if first is None:
        return 0
    with atomic_path(path) as unfinished, unfinished.open("wb") as file:
        file.write(first.data)
        count += 1
        for unit in units:
            file.write(unit.data)
            count += 1
    return count


def _to_window(player: tuple[str, ...], units: Iterator[Any]) -> int:
    """Feed a player's stdin until it is closed or the stream ends."""
    count = 0
    with subprocess.Popen(player, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        try:
            for unit in units:
                process.stdin.write(unit.data)
                process.stdin.flush()
                count += 1
        except BrokenPipeError:
            pass  # the window was closed
        finally:
            with contextlib.suppress(OSError):
                process.stdin.close()
            try:
                process.wait(3)
            except subprocess.TimeoutExpired:
                process.kill()
    return count


def _to_lines(units: Iterator[Any]) -> int:
    """Tell of each unit in a line."""
    count = 0
    for unit in units:
        latency = (unit.published_time_ns - unit.capture_time_ns) / 1e6
        gap = f", {unit.missed} missed before it" if unit.missed else ""
        sys.stdout.write(
            f"frame {unit.frame_index}: sequence {unit.sequence}, "
            f"{'key, ' if unit.is_key else ''}{unit.width}×{unit.height}, "
            f"{len(unit.data)} bytes, {latency:.0f} ms after its capture{gap}\n"
        )
        sys.stdout.flush()
        count += 1
    return count


def _counted(units: Iterator[Any], most: int | None) -> Iterator[Any]:
    for number, unit in enumerate(units, start=1):
        yield unit
        if most is not None and number >= most:
            return


def _window_player() -> tuple[str, ...]:
    from pipeline.errors import ConfigurationError

    for name, words in WINDOW_PLAYERS.items():
        if shutil.which(name):
            return words
    raise ConfigurationError("--window: neither mpv nor ffplay is installed; use -o FILE")


def _check_stream(name: str) -> None:
    from pipeline.errors import ConfigurationError
    from service.bus import keys

    try:
        keys.status(name)
    except ValueError as error:
        raise ConfigurationError(f"--stream: {error}") from None


def _camera(text: str) -> tuple[str, str]:
    name, _, address = text.partition("=")
    if not (name and address) or "://" in name:  # and what was said, with its password, is not told
        raise argparse.ArgumentTypeError("must be NAME=ADDRESS, as left=rtsp://HOST/PATH")
    return name, address


def _rate(text: str) -> Fraction:
    try:
        rate = Fraction(text)
    except ZeroDivisionError:
        raise ValueError(text) from None
    if not 0 < rate <= 1000:
        raise ValueError(text)
    return rate


_rate.__name__ = "rate"  # argparse says "invalid rate value"


def _endpoints(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _note(text: str) -> None:
    sys.stderr.write(f"depthsr: {text}\n")
    sys.stderr.flush()
