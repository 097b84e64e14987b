"""What Prometheus reads: queue, workers, frames, stages, requests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.metrics_core import GaugeMetricFamily
from prometheus_client.registry import Collector

from service.scheduler import Scheduler
from service.store import Store
from service.streams.numbers import StreamCollector
from service.streams.streams import Streams


class Metrics:
    """The numbers of one service, in a registry of their own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "depthsr_http_requests", "Requests", ["method", "status"], registry=self.registry
        )
        self.seconds = Histogram(
            "depthsr_http_seconds", "Time to the first byte of an answer", registry=self.registry,
            buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.2, 0.5, 1, 5),
        )  # fmt: skip
        self.bytes_in = Counter("depthsr_http_bytes_in", "Bytes taken", registry=self.registry)
        self.frames = Counter("depthsr_frames", "Frames super-resolved", registry=self.registry)
        self.segments = Counter("depthsr_segments", "Segments finished", registry=self.registry)
        self.warnings = Counter("depthsr_warnings", "Warnings of jobs", registry=self.registry)
        self.stages = Counter(
            "depthsr_stage_seconds", "Seconds in each stage of finished jobs", ["stage"],
            registry=self.registry,
        )  # fmt: skip
        self.free = Gauge("depthsr_disk_free_bytes", "Space left", registry=self.registry)

    def watch(self, store: Store, scheduler: Scheduler) -> None:
        """Add the jobs of the store and the workers."""
        self.registry.register(_Jobs(store, scheduler))

    def watch_streams(self, streams: Streams) -> None:
        """Add the streams."""
        self.registry.register(StreamCollector(streams))

    def of_worker(self, kind: str, data: dict[str, Any]) -> None:
        """Count what a worker said."""
        counters = {
            "FrameFinished": self.frames, "SegmentFinished": self.segments, "Warned": self.warnings
        }  # fmt: skip
        if kind in counters:
            counters[kind].inc()
        if kind == "JobFinished":
            for stage, seconds in data["timings"].items():
                self.stages.labels(stage).inc(seconds)

    def text(self) -> bytes:
        """Return the page that Prometheus reads."""
        return generate_latest(self.registry)


class _Jobs(Collector):
    def __init__(self, store: Store, scheduler: Scheduler) -> None:
        self._store, self._scheduler = store, scheduler

    def collect(self) -> Iterable[GaugeMetricFamily]:
        jobs = GaugeMetricFamily("depthsr_jobs", "Jobs by state", labels=["state"])
        for state, count in self._store.counts().items():
            jobs.add_metric([state.value], count)
        yield jobs
        yield GaugeMetricFamily(
            "depthsr_workers_busy", "Workers at work", value=self._scheduler.busy
        )
