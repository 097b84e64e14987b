"""The streams of the service: found on the bus or asked for over HTTP, each with a worker.

One thread looks after all of them; callbacks of the bus only leave it notes. A
stream that another source calls itself after is the same stream: whoever may
publish may do that, which is why passwords and certificates exist.
"""

from __future__ import annotations

import contextlib
import json
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.config import Settings
from pipeline.errors import PipelineError, SceneError
from pipeline.media.live_manifest import LiveManifest, live_manifest, read_live_manifest
from pipeline.stereo import StereoLayout
from service.bus import keys
from service.bus.bus import JSON, Answer, Bus, BusError, Question, Sample, answer_json
from service.bus.config import BusConfig
from service.config import MIB, ServiceConfig
from service.live.broadcast import Broadcasts
from service.streams.door import WorkersDoor
from service.streams.options import StreamOptions
from service.streams.process import StreamProcess
from service.streams.sequences import last_run
from service.streams.states import Action, State
from service.streams.stills import Wish
from service.streams.stream import MAX_LOSSES, KeptStreams, Stream
from service.streams.worker import StreamOrder

log = logging.getLogger(__name__)

TICK = 0.5
"""Seconds between two looks at the streams."""

RETRY = 2.0
"""Seconds between two tries to open the bus."""

MAX_MANIFEST = 1 << 20
"""Longest manifest taken, bytes."""

LOSS_TIME = 60.0
"""Seconds."""

MAX_BACKOFF = 10.0
"""Longest wait before a lost worker's successor, seconds."""

FORGET = 3600.0
"""A stream that a manifest began is forgotten when it has waited so long, seconds."""

FROM_BUS = "zenoh"
"""Whose streams are that a manifest began."""


class StreamRefusedError(PipelineError):
    """The stream cannot be had now."""

    code = "stream-refused"


class TooManyStreamsError(StreamRefusedError):
    """There are as many streams as the service bears."""

    code = "too-many-streams"


class NoSuchStreamError(PipelineError):
    """There is no stream of that name."""

    code = "no-such-stream"


@dataclass(frozen=True, kw_only=True)
class _Note:
    """Something for the thread to see to."""

    stream: str
    manifest: bytes


class Streams:
    """All streams of one service.

    Parameters
    ----------
    config : ServiceConfig
        Limits, and how the bus is reached.
    open_bus : callable
        Makes a bus of its settings.
    broadcasts : Broadcasts
        Where browsers watch: each stream as ``streams/<stream>``.
    on_change : callable
        Told the id of a stream that has changed.
    """

    def __init__(
        self,
        config: ServiceConfig,
        *,
        open_bus: Callable[[BusConfig], Bus],
        broadcasts: Broadcasts,
        on_change: Callable[[str], None] = lambda stream: None,
    ) -> None:
        self.config = config
        self._open_bus = open_bus
        self._broadcasts = broadcasts
        self._kept = KeptStreams(config.data / "streams")
        self._on_change = on_change
        self._lock = threading.RLock()
        self._streams: dict[str, Stream] = {}
        self._notes: queue.Queue[_Note] = queue.Queue(maxsize=64)
        self._wake = threading.Event()
        self._closing = False
        self._bus: Bus | None = None
        self._door = WorkersDoor()
        self.refused = 0
        """Manifests that were not taken."""
        self.losses = 0
        """Workers that were lost."""
        self.problem = "zenoh is not open yet"
        """Why there is no bus; empty where there is one."""
        self._thread = threading.Thread(target=self._run, name="depthsr-streams", daemon=True)

    # For the service

    @property
    def is_on(self) -> bool:
        """True where there shall be streams."""
        return self.config.zenoh != "off"

    def start(self) -> None:
        """Open the bus, now or as soon as it can be had, and listen."""
        if self.is_on:
            for item in self._kept.all():
                self._streams[item.id] = item
                if item.manifest is not None and item.state is not State.STOPPED:
                    self._begin(item, item.manifest)
            self._open()
            self._thread.start()

    def close(self) -> None:
        """End the workers and leave the bus. Takes at most the grace time and a little."""
        self._closing = True
        self._wake.set()
        if self._thread.ident is not None:
            self._thread.join()
        with self._lock:
            processes = [item.process for item in self._streams.values() if item.process]
        for process in processes:
            process.stop()
        deadline = time.monotonic() + self.config.grace
        for process in processes:
            process.join(max(0.0, deadline - time.monotonic()))
            process.kill()
            process.join(2)
        if self._bus is not None:
            self._bus.close()
        self._door.close()

    def all(self) -> list[Stream]:
        """Return all streams, newest first."""
        with self._lock:
            return sorted(self._streams.values(), key=lambda item: item.created, reverse=True)

    def get(self, stream: str) -> Stream | None:
        """Return a stream."""
        with self._lock:
            return self._streams.get(stream)

    def create(
        self,
        stream: str,
        client: str,
        *,
        manifest: Mapping[str, Any] | None = None,
        settings: Mapping[str, Any] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> Stream:
        """Make a stream that waits for its source; begin it where the manifest is given.

        Raises
        ------
        StreamRefusedError
            If there are too many, or it is there and has not been stopped.
        PipelineError
            If manifest, settings or options are wrong.
        """
        Settings(**self._with_defaults(settings or {}))
        StreamOptions(**(options or {}))
        read = None if manifest is None else live_manifest(manifest)
        if read is not None:
            check_views(read, self.config.max_views)
        with self._lock:
            known = self._streams.get(stream)
            if known is not None and known.state not in (State.STOPPED, State.FAILED):
                raise StreamRefusedError(f"{stream}: is there and {known.state}; stop it first")
            self._check_room(stream)
            item = Stream(
                id=stream,
                client=client,
                settings=dict(settings or {}),
                options=dict(options or {}),
                created=time.time(),
                run=known.run if known else 0,
            )
            self._streams[stream] = item
            if read is not None:
                self._begin(item, read)
            self._kept.keep(item)
        self._publish(item)
        self._on_change(stream)
        return item

    def stop(self, stream: str) -> Stream:
        """Stop a stream; its source is not listened to any more."""
        with self._lock:
            item = self._streams.get(stream)
            if item is None:
                raise NoSuchStreamError(f"{stream}: there is no such stream")
            item.act(Action.STOP)
            if item.process is not None:
                item.process.stop()
            self._go_off_air(item)
            if item.client != FROM_BUS:
                self._kept.keep(item)
        self._publish(item)
        self._on_change(stream)
        return item

    def remove(self, stream: str) -> None:
        """Forget a stream; one that works is stopped first."""
        with self._lock:
            self.stop(stream)
            del self._streams[stream]
            self._kept.forget(stream)

    # The thread

    def _run(self) -> None:
        while not self._closing:
            self._wake.clear()
            try:
                if self._bus is None:
                    self._open()
                self._take_notes()
                self._look()
            except Exception:
                log.warning("streams: trying again", exc_info=True)
            self._wake.wait(TICK if self._bus is not None else RETRY)

    def _open(self) -> None:
        config = self.config.bus()
        try:
            bus = self._open_bus(self._door.opened(config))
        except BusError as error:
            if self.problem != str(error):
                log.warning("streams: %s", error)
            self.problem = str(error)
            return
        bus.subscribe(keys.MANIFESTS, self._hear_manifest)
        bus.answer(keys.SERVICE, answer_json(keys.SERVICE, lambda question: self._listed()))
        bus.answer(keys.STATUSES, self._asked_how_it_is)
        bus.live(keys.SERVICE)
        self._bus, self.problem = bus, ""
        listening = getattr(bus, "listening", config.listen)[: len(config.listen)]
        where = ", ".join((*listening, *config.connect))
        log.info("streams: zenoh is open", extra={"endpoints": where})
        for sample in bus.ask(keys.MANIFESTS, timeout=1.0):
            self._hear_manifest(sample)

    def _listed(self) -> list[dict[str, Any]]:
        return [
            {"stream": item.id, "state": item.state.value, "run": item.run} for item in self.all()
        ]

    def _hear_manifest(self, sample: Sample) -> None:
        """In a thread of the bus."""
        stream = keys.parse_manifest(sample.key)
        if stream is None or sample.size > MAX_MANIFEST:
            self.refused += 1
            return
        try:
            self._notes.put_nowait(_Note(stream=stream, manifest=sample.read()))
        except queue.Full:
            self.refused += 1
        self._wake.set()

    def _take_notes(self) -> None:
        while True:
            try:
                note = self._notes.get_nowait()
            except queue.Empty:
                return
            try:
                self._take(note)
            except PipelineError as error:
                self.refused += 1
                log.info("manifest refused: %s", error, extra={"stream": note.stream})
                self._say_refused(note.stream, error)

    def _take(self, note: _Note) -> None:
        with self._lock:
            item = self._streams.get(note.stream)
            if item is not None and item.state is State.STOPPED:
                self._publish(item)
                return
            manifest = read_live_manifest(note.manifest)
            is_same = (
                item is not None
                and item.manifest is not None
                and item.manifest.content == manifest.content
            )
            if item is not None and is_same and item.state is not State.WAITING:
                if item.state is State.FAILED:
                    self._publish(item)
                return
            check_views(manifest, self.config.max_views)
            if item is None:
                self._check_room(note.stream)
                item = Stream(
                    id=note.stream, client=FROM_BUS, settings={}, options={}, created=time.time()
                )
                self._streams[note.stream] = item
            self._begin(item, manifest)
        self._on_change(note.stream)

    def _check_room(self, stream: str) -> None:
        busy = [
            item for item in self._streams.values()
            if item.id != stream and item.state not in (State.STOPPED, State.FAILED)
        ]  # fmt: skip
        if len(busy) >= self.config.max_streams:
            raise TooManyStreamsError(
                f"{stream}: {len(busy)} streams are there already; stop one first"
            )

    def _begin(self, item: Stream, manifest: LiveManifest) -> None:
        """Let a stream begin with a manifest; the thread starts its worker."""
        if item.process is not None:
            item.process.stop()
        item.manifest, item.problem = manifest, None
        item.losses.clear()
        item.begin_at = 0.0
        if item.broadcasts is None or item.broadcasts[0].fps != manifest.fps:
            asks: tuple[dict[str, Any], ...] = (
                {"ask_still": partial(self._wish, item.id, Wish.ONE)},
                {"ask_video": partial(self._wish, item.id, Wish.BEFORE)},
            )
            result, before = (
                self._broadcasts.open(name, fps=manifest.fps, layout=StereoLayout.SBS, **ask)
                for name, ask in zip(watched_as(item.id), asks, strict=True)
            )
            item.broadcasts = (result, before)
        item.act(Action.BEGIN)
        self._wake.set()

    def _look(self) -> None:
        now = time.monotonic()
        with self._lock:
            items = list(self._streams.values())
        for item in items:
            with self._lock:
                self._look_after(item, now)

    def _look_after(self, item: Stream, now: float) -> None:
        process = item.process
        if process is not None and process.silent_seconds > self.config.lease:
            log.warning("stream worker hangs: killed", extra={"stream": item.id})
            process.kill()
        wants = item.state in (State.STARTING, State.RESTARTING) and process is None
        if wants and now >= item.begin_at and self._bus is not None:
            item.act(Action.BEGIN)
            self._spawn(item)
        if process is not None and item.broadcasts is not None:
            result, before = item.broadcasts
            if result.viewers_of_stills:
                process.wish(Wish.MORE)
            if before.is_watched:
                process.wish(Wish.BEFORE)
        idle = float(item.options.get("idle", StreamOptions().idle))
        silent = item.status.get("silent_s")
        if item.state is State.IDLE and process is not None and not process.asked_to_stop:
            silent = item.status.get("uptime_s", 0.0) if silent is None else silent
            if silent > idle:
                item.act(Action.LEAVE)
                process.stop()
                self._publish(item)
        forgotten = item.client == FROM_BUS and now - item.since > FORGET
        if item.state is State.WAITING and process is None and forgotten:
            self._streams.pop(item.id, None)
            self._go_off_air(item)

    def _go_off_air(self, item: Stream) -> None:
        for name in watched_as(item.id):
            self._broadcasts.close(name)
        item.broadcasts = None

    def _wish(self, stream: str, wish: Wish) -> bool:
        """Ask for pictures of a stream; return whether there is a worker to make them."""
        item = self.get(stream)
        process = None if item is None else item.process
        if process is None:
            return False
        process.wish(wish)  # the end of a worker is an answer, too
        return True

    def _spawn(self, item: Stream) -> None:
        assert item.manifest is not None
        sequences = self._kept.sequences(item.id)
        item.run = max(item.run, last_run(sequences)) + 1
        item.status = {}
        order = StreamOrder(
            stream=item.id,
            run=item.run,
            manifest=item.manifest.content,
            settings=self._with_defaults(item.settings),
            options=item.options,
            bus=_plain(self._door.for_workers(self.config.bus())),
            pictures=-1,
            sequences=str(sequences),
            memory=self.config.worker_memory * MIB,
            max_pixels=self.config.max_pixels,
            max_payload=self.config.max_payload * MIB,
            max_rate=self.config.max_rate,
        )
        run = item.run
        assert item.broadcasts is not None
        result, before = item.broadcasts
        takers = {
            b"m": result.feed, b"j": result.show, b"b": before.feed,
            b"s": lambda nothing: result.confirm(), b"p": lambda nothing: before.pause(),
        }  # fmt: skip

        def pictures(kind: bytes, data: bytes) -> None:
            if item.run == run:
                takers[kind](data)

        item.process = StreamProcess(
            order,
            self.config.data / "streams" / f"{item.id}.log",
            on_event=lambda kind, data: self._said(item, run, kind, data),
            on_picture=pictures,
            on_end=lambda last: self._ended(item, run, last),
        )

    def _with_defaults(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        given = {"temporal": "warm", **settings}
        if self.config.worker_threads:
            given["threads"] = self.config.worker_threads
        return given

    # Threads of the workers

    def _said(self, item: Stream, run: int, kind: str, data: dict[str, Any]) -> None:
        with self._lock:
            if item.run != run or kind != "status":
                return
            item.status = data["status"]
            state = item.status.get("state")
            if item.state.has_worker and item.process and not item.process.asked_to_stop:
                if state == "live":
                    item.act(Action.HEAR)
                elif state == "idle":
                    item.act(Action.SILENCE)
        self._on_change(item.id)

    def _ended(self, item: Stream, run: int, last: dict[str, Any]) -> None:
        with self._lock:
            process = item.process
            if item.run != run or process is None:
                return
            item.process = None
            self._settle_still(item, last)
            if not process.asked_to_stop and item.state.has_worker:
                self._lose(item, last)
        self._wake.set()
        self._publish(item)
        self._on_change(item.id)

    def _settle_still(self, item: Stream, last: dict[str, Any]) -> None:
        """Say whether the still is of the last picture: of a worker that was killed, it may not."""
        if item.broadcasts is not None:
            result, _ = item.broadcasts
            if last.get("event") == "stopped":
                result.confirm()
            else:
                result.lose_still()

    def _lose(self, item: Stream, last: dict[str, Any]) -> None:
        now = time.monotonic()
        self.losses += 1
        item.losses.append(now)
        item.act(Action.LOSE)
        often = [at for at in item.losses if now - at < LOSS_TIME]
        if last.get("event") == "problem":
            item.problem = {"code": last.get("code"), "detail": last.get("text")}
        if len(often) >= MAX_LOSSES:
            item.act(Action.GIVE_UP)
            said = item.problem["detail"] if item.problem else "its worker died too often"
            item.problem = {"code": "worker-lost", "detail": said}
        item.begin_at = now + min(MAX_BACKOFF, 0.25 * 2 ** (len(often) - 1))

    # What the bus is told

    def _publish(self, item: Stream) -> None:
        """Tell subscribers of a stream without a worker how it is."""
        self._put_status(item.id, _how_it_is(item))

    def _asked_how_it_is(self, question: Question) -> Iterator[Answer]:
        """Answer for the streams whose worker says nothing: not yet, or not any more."""
        for item in self.all():
            key, process = keys.status(item.id), item.process
            is_told = process is not None and item.status and not process.asked_to_stop
            if not is_told and keys.matches(question.key, key):
                payload = json.dumps(_how_it_is(item)).encode()
                yield Answer(key=key, payload=payload, encoding=JSON)

    def _say_refused(self, stream: str, error: PipelineError) -> None:
        said = {"stream": stream, "state": "refused", "time_ns": time.time_ns(),
                "problem": {"code": error.code, "detail": str(error)}}  # fmt: skip
        self._put_status(stream, said)

    def _put_status(self, stream: str, said: Mapping[str, Any]) -> None:
        if self._bus is not None:
            with contextlib.suppress(BusError):
                self._bus.put(keys.status(stream), json.dumps(said).encode(), encoding=JSON)


def _how_it_is(item: Stream) -> dict[str, Any]:
    return {"stream": item.id, "run": item.run, "state": item.state.value,
            "time_ns": time.time_ns(), "problem": item.problem}  # fmt: skip


def check_views(manifest: LiveManifest, max_views: int) -> None:
    """Refuse a source whose views cannot be named on the bus, or are too many.

    Raises
    ------
    SceneError
    """
    if len(manifest.view_ids) > max_views:
        raise SceneError(f"views: {len(manifest.view_ids)}; up to {max_views} are taken")
    for view_id in manifest.view_ids:
        if not keys.is_view(view_id):
            raise SceneError("id: cannot stand in a key (no * $ ? # /)", view=view_id)


def watched_as(stream: str) -> tuple[str, str]:
    """Return the names of a stream's broadcasts: the result, and the observed views."""
    return f"streams/{stream}", f"streams/{stream}/before"


def _plain(config: BusConfig) -> dict[str, Any]:
    return {
        name: str(value) if isinstance(value, Path) else value
        for name, value in asdict(config).items()
    }
