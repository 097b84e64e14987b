"""One stream at work: frames from the intake, super-resolved, out through the outlets.

Runs in the stream's worker process. What a source sends is decoded here and
nowhere else.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from pipeline.config import Settings
from pipeline.effort import FULL, Effort, depth_looked_at, looked_at
from pipeline.errors import Interrupted, PipelineError, SceneError
from pipeline.frames import MultiViewFrame
from pipeline.media.live_frames import LiveFrames
from pipeline.media.live_manifest import LiveManifest
from pipeline.psf_search import search_psf
from pipeline.realtime import Choice, Controller, Rung, find_motions
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.rehearsal import as_far_as_it_goes
from pipeline.results import FrameResult
from pipeline.worker import Worker
from service.bus import keys
from service.bus.bus import JSON, Bus, Question, answer_json
from service.bus.keys import Part
from service.streams.assembly import AssembledFrame, Expected, named
from service.streams.intake import Intake
from service.streams.latency import Latency, Rate
from service.streams.options import Rule, StreamOptions
from service.streams.outlets import FinishedFrame, Outlets
from service.streams.rehearsal import rehearse
from service.streams.sequences import Sequences
from service.streams.stills import Wish

log = logging.getLogger(__name__)

KEEP_HISTORY = 100
"""Frames whose account is kept for those who ask."""

STATUS_INTERVAL = 1.0
"""Seconds between two messages of how it goes."""

QUIET = 3.0
"""Silence after which a stream counts as idle, seconds."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a source may do."""

    max_pixels: int = 1 << 25
    max_payload: int = 64 << 20
    """Bytes of one picture."""
    max_rate: float = 60.0
    """Frames a second."""


@dataclass(kw_only=True)
class Progress:
    """What a session has done so far."""

    frames_done: int = 0
    frames_failed: int = 0
    """That could not be decoded or computed."""
    pictures_refused: int = 0
    bytes_out: int = 0
    size: tuple[int, int] | None = None
    """(width, height) of both eyes side by side."""
    problem: str = ""
    """The last thing that went wrong."""
    arrivals: Rate = field(default_factory=Rate)
    departures: Rate = field(default_factory=Rate)


class StreamSession:
    """One stream, from its manifest on.

    Parameters
    ----------
    bus : Bus
        Where the source and the subscribers are; the caller closes it.
    stream : str
    manifest : LiveManifest
    settings : Settings
        Of the method.
    options : StreamOptions
    limits : Limits
    run : int
        Which worker of this stream this is, from 1.
    sequences : Sequences, optional
        Numbers of its messages; from 0 unless they go on.
    to_service : callable
        Takes (kind, bytes) for browsers.
    on_status : callable
        Told how it goes, once a second.
    clock, wall : callable
        Monotonic seconds; nanoseconds since the epoch.
    """

    def __init__(
        self,
        bus: Bus,
        stream: str,
        manifest: LiveManifest,
        *,
        settings: Settings,
        options: StreamOptions,
        limits: Limits,
        run: int = 1,
        sequences: Sequences | None = None,
        to_service: Callable[[str, bytes], None] = lambda kind, data: None,
        on_status: Callable[[dict[str, Any]], None] = lambda status: None,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        self.stream, self.manifest = stream, manifest
        self.settings, self.options = settings, options
        self._bus, self._run = bus, run
        self._clock, self._wall = clock, wall
        self._on_status = on_status
        self._frames = LiveFrames(manifest, max_pixels=limits.max_pixels)
        self._controller = Controller(
            rate=float(manifest.fps),
            num_views=len(manifest.view_ids),
            has_depth=manifest.depth_ids == set(manifest.view_ids),
        )
        self._latency = Latency()
        self._history: deque[dict[str, Any]] = deque(maxlen=KEEP_HISTORY)
        self._progress = Progress()
        self._began = clock()
        self._stopping = threading.Event()
        self._worker: Worker | None = None
        self._capture_delay: float | None = None
        self._expected = expected_of(manifest, options, limits)
        self.intake = Intake(
            self._expected, max_payload=limits.max_payload, max_rate=limits.max_rate, clock=clock
        )
        self._outlets = Outlets(
            bus,
            stream,
            run=run,
            sequences=sequences or Sequences(run=run),
            fps=manifest.fps,
            quality=options.quality,
            jpeg_quality=options.jpeg_quality,
            to_service=to_service,
            clock=clock,
        )
        self._status_out = bus.publisher(keys.status(stream), encoding=JSON)
        key = keys.status(stream)
        bus.answer(key, answer_json(key, lambda question: self.status()))
        key = keys.info(stream)
        bus.answer(key, answer_json(key, lambda question: self.info()))
        key = keys.history(stream)
        bus.answer(key, answer_json(key, self._asked_history))

    def prepare(self) -> None:
        """Do all that a frame may need once, so that none has to wait for it."""
        rungs = self._controller.rungs if self.options.real_time else (Rung(),)
        efforts = [rung.effort for rung in rungs]
        with suppress(Interrupted), as_far_as_it_goes():
            rehearse(self._frames, self.settings, efforts, self._stopping.is_set)

    def run(self) -> None:
        """Work until :meth:`stop`."""
        self._bus.live(keys.alive(self.stream))
        self._bus.subscribe(keys.inputs(self.stream), self.intake.hear)
        teller = threading.Thread(target=self._tell, name="depthsr-status", daemon=True)
        teller.start()
        try:
            while not self._stopping.is_set():
                frame = self.intake.take(0.5)
                if frame is not None:
                    self._work(frame)
        finally:
            self._stopping.set()
            teller.join(2 * STATUS_INTERVAL)
            self._outlets.close()
            self._say()

    def wish(self, wish: Wish) -> None:
        """Show browsers what they want; for any thread."""
        self._outlets.wish(wish)

    def stop(self) -> None:
        """End after the frame at work."""
        self._stopping.set()
        self.intake.wake()

    @property
    def state(self) -> str:
        """``starting`` before the first result, ``idle`` when nothing comes, else ``live``."""
        if self._stopping.is_set():
            return "stopping"
        heard = self.intake.last_heard
        if heard is None or self._clock() - heard > QUIET:
            return "idle"
        return "live" if self._progress.frames_done else "starting"

    def status(self) -> dict[str, Any]:
        """Return how it goes: state, rates, counts, latency."""
        now = self._clock()
        progress = self._progress
        counts = self.intake.counts()
        heard = self.intake.last_heard
        return {
            "stream": self.stream,
            "run": self._run,
            "state": self.state,
            "time_ns": self._wall(),
            "uptime_s": round(now - self._began, 1),
            "silent_s": None if heard is None else round(now - heard, 1),
            "fps_in": progress.arrivals.value(now),
            "fps_out": progress.departures.value(now),
            "frames_done": progress.frames_done,
            "frames_failed": progress.frames_failed,
            "frames_too_late": self._controller.dropped if self.options.real_time else 0,
            "frames_by_effort": dict(self._controller.account.frames_by_rung),
            "pictures_refused": progress.pictures_refused,
            "bytes_out": progress.bytes_out,
            "width": None if progress.size is None else progress.size[0],
            "height": None if progress.size is None else progress.size[1],
            "counts": counts,
            "latency": self._latency.summary(),
            "capture_to_arrival_ms": self._capture_delay,
            "problem": progress.problem or None,
            "last_malformed": self.intake.last_wrong or None,
        }

    def info(self) -> dict[str, Any]:
        """Return what the stream is."""
        size = self._progress.size
        left, right = self.manifest.pair
        return {
            "stream": self.stream,
            "run": self._run,
            "manifest": self.manifest.content,
            "fps": f"{self.manifest.fps.numerator}/{self.manifest.fps.denominator}",
            "left": left,
            "right": right,
            "width": None if size is None else size[0],
            "height": None if size is None else size[1],
            "layout": "sbs",
            "magnification": self.settings.magnification,
            "outputs": {str(which): keys.output(self.stream, which) for which in keys.Output},
            "status": keys.status(self.stream),
            "history": keys.history(self.stream),
        }

    def _asked_history(self, question: Question) -> list[dict[str, Any]]:
        limit = KEEP_HISTORY
        for item in question.parameters.split(";"):
            name, _, value = item.partition("=")
            if name == "limit" and value.isascii() and value.isdigit():
                limit = min(limit, int(value[:6]))
        kept = list(self._history)
        return kept[len(kept) - min(limit, len(kept)) :]

    def _work(self, assembled: AssembledFrame) -> None:
        progress = self._progress
        marks = [assembled.last_arrived, self._clock()]
        progress.arrivals.add(marks[-1])
        self._capture_delay = round((self._wall() - assembled.capture_time_ns) / 1e6, 1)
        try:
            choice = self._controller.begin(marks[1] - marks[0])
            if choice.drop and self.options.real_time:
                self._account(assembled, {}, problem="too late")
                return
            is_whole = choice.begins_anew or not self.options.real_time
            frame = self._decoded(assembled, FULL if is_whole else choice.rung.effort)
            marks.append(self._clock())
            result = self._superresolved(frame, choice)
            marks.append(self._clock())
            sent = self._outlets.send(self._finished(result, frame, assembled))
        except Interrupted:
            return
        except MemoryError:
            raise  # of the whole process: the next worker begins with more room
        except Exception as error:
            if not isinstance(error, PipelineError):
                log.warning("a frame failed", exc_info=True, extra={"stream": self.stream})
            progress.frames_failed += 1
            progress.problem = str(error) or type(error).__name__
            self._account(assembled, {}, problem=progress.problem)
            return
        end = self._clock()
        seconds = {
            "wait": marks[1] - marks[0],
            "decode": marks[2] - marks[1],
            "superresolve": marks[3] - marks[2],
            **sent.seconds,
            "total": end - sent.seconds["pictures"] - marks[0],
        }
        self._controller.end(choice, end - marks[1], seconds["superresolve"])
        progress.frames_done += 1
        progress.bytes_out += sent.bytes
        progress.size = sent.size
        progress.departures.add(end)
        self._latency.add(seconds)
        self._account(assembled, seconds, effort=self._words(choice))
        self._find_motions(frame, choice, marks[0])

    def _decoded(self, assembled: AssembledFrame, effort: Effort) -> MultiViewFrame:
        """Return the frame; pictures that cannot be used are left out as if they had not come.

        Parameters
        ----------
        effort : Effort
            Only what that looks at is decoded.
        """
        color, depth = (
            {view: item.content for (view, kind), item in assembled.parts.items() if kind is part}
            for part in Part
        )
        view_ids, pair = self.manifest.view_ids, self.manifest.pair
        looked = looked_at(effort, view_ids, pair, assembled.frame_index)
        deep = depth_looked_at(effort, view_ids, pair)
        decoded, refused = self._frames.decode(
            {view: color[view] for view in looked if view in color},
            {view: depth[view] for view in deep if view in depth},
            colour=pair if self.settings.chroma == "bicubic" else None,
        )
        for item in refused:
            self._progress.pictures_refused += 1
            key = keys.input_key(self.stream, item.view_id, Part(item.part))
            self.intake.refuse(key, item.reason)
        missing = assembled.missing | {(item.view_id, Part(item.part)) for item in refused}
        if not self._expected.is_usable(missing):
            raise SceneError(
                f"cannot be used: {', '.join(named(frozenset(missing)))}",
                frame=assembled.frame_index,
            )
        return self._frames.frame(assembled.frame_index, decoded, depth=deep)

    def _superresolved(self, frame: MultiViewFrame, choice: Choice) -> FrameResult:
        """Return the result with the effort chosen; all of it where no rate is to be held."""
        if self._worker is None:
            self._worker = self._made_worker(frame)
        if not self.options.real_time:
            return self._worker.take(frame)
        result = self._worker.take(frame, effort=choice.rung.effort)
        self._controller.look_at(self._worker)
        return result

    def _find_motions(self, frame: MultiViewFrame, choice: Choice, arrived: float) -> None:
        """Find motions anew that a cut has left missing, while no frame waits.

        Parameters
        ----------
        arrived : float
            When the last picture of the frame did.
        """
        if self._worker is None or not self.options.real_time:
            return
        try:
            if choice.begins_anew:
                self._worker.begin_anew(frame, choice.rung.effort)
            left = arrived + self._controller.budget - self._clock()
            find_motions(self._worker, self._controller, left, self._clock)
        except Interrupted:
            return
        except MemoryError:
            raise
        except Exception:
            # the frame is sent, and the next one starts a new chain
            log.warning("no motions were found anew", exc_info=True, extra={"stream": self.stream})

    def _made_worker(self, first: MultiViewFrame) -> Worker:
        """Return the worker, with the PSF of the first frame where it is to be estimated."""
        more = {}
        if self.settings.psf == "auto":
            curve = search_psf(first, self.settings)[0]
            more["psf"] = GaussianPsf.of(curve.sigma, curve.support)
        return Worker(self.settings, targets=self.manifest.pair, stop=self._stopping.is_set, **more)

    def _words(self, choice: Choice) -> str:
        """Return what was left out of a frame."""
        return str(choice.rung) if self.options.real_time else str(Rung())

    def _finished(
        self, result: FrameResult, frame: MultiViewFrame, assembled: AssembledFrame
    ) -> FinishedFrame:
        """Return the pictures of both eyes."""
        left, right = self.manifest.pair
        return FinishedFrame(
            left=result.images[left],
            right=result.images[right],
            observed=(frame.view(left), frame.view(right)) if self.options.before else None,
            frame_index=assembled.frame_index,
            position=assembled.position,
            capture_time_ns=assembled.capture_time_ns,
        )

    def _account(
        self,
        assembled: AssembledFrame,
        seconds: dict[str, float],
        *,
        problem: str | None = None,
        effort: str | None = None,
    ) -> None:
        self._history.append(
            {
                "frame_index": assembled.frame_index,
                "position": assembled.position,
                "capture_time_ns": assembled.capture_time_ns,
                "assembly_ms": round(1000 * (assembled.last_arrived - assembled.first_arrived), 1),
                "missing": named(assembled.missing),
                "stages_ms": {name: round(1000 * value, 1) for name, value in seconds.items()},
                "effort": effort,
                "problem": problem,
            }
        )

    def _tell(self) -> None:
        while not self._stopping.wait(STATUS_INTERVAL):
            self._say()

    def _say(self) -> None:
        status = self.status()
        self._status_out.put(json.dumps(status).encode())
        self._on_status(status)


def expected_of(manifest: LiveManifest, options: StreamOptions, limits: Limits) -> Expected:
    """Return what belongs to a frame of this source."""
    parts = len(manifest.view_ids) + len(manifest.depth_ids)
    return Expected(
        color=frozenset(manifest.view_ids),
        depth=manifest.depth_ids,
        needed=frozenset(manifest.pair),
        interval=float(1 / manifest.fps),
        wait=options.wait,
        window=options.window,
        max_bytes=min(512 << 20, parts * limits.max_payload * (options.window + 1)),
        max_skew=options.max_skew,
        missing_view=Rule(options.missing_view),
        missing_depth=Rule(options.missing_depth),
        skewed=Rule(options.skewed),
    )
