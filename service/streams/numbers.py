"""The numbers of streams for Prometheus, read from what their workers said last."""

from __future__ import annotations

from collections.abc import Iterable

from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from service.streams.states import State
from service.streams.streams import Stream, Streams

DROPS = (
    "malformed", "too_large", "too_many", "frames_behind", "frames_incomplete",
    "frames_crowded_out", "frames_missing", "parts_late", "parts_duplicate", "parts_unknown",
)  # fmt: skip
"""Counts that are told by reason."""


class StreamCollector(Collector):
    """All streams of a service; counts of a stream begin anew with its worker, as the run says."""

    def __init__(self, streams: Streams) -> None:
        self._streams = streams

    def collect(self) -> Iterable[Metric]:
        """Yield everything."""
        items = self._streams.all()
        states = GaugeMetricFamily("depthsr_streams", "Streams by state", labels=["state"])
        for state in State:
            states.add_metric([state.value], sum(item.state is state for item in items))
        yield states
        yield GaugeMetricFamily(
            "depthsr_zenoh_open", "1 where the bus of streams is open",
            value=float(not self._streams.problem),
        )  # fmt: skip
        yield CounterMetricFamily(
            "depthsr_manifests_refused", "Manifests not taken", value=self._streams.refused
        )
        yield CounterMetricFamily(
            "depthsr_stream_workers_lost", "Workers that died or hung", value=self._streams.losses
        )
        yield from _of_each(items)


def _of_each(items: list[Stream]) -> Iterable[Metric]:
    label = ["stream"]
    rate_in = GaugeMetricFamily("depthsr_stream_fps_in", "Whole frames a second", labels=label)
    rate_out = GaugeMetricFamily("depthsr_stream_fps_out", "Results a second", labels=label)
    run = GaugeMetricFamily("depthsr_stream_run", "Workers so far", labels=label)
    frames = CounterMetricFamily("depthsr_stream_frames", "Frames of this run", labels=label)
    size = CounterMetricFamily("depthsr_stream_bytes_out", "Video of this run", labels=label)
    drops = CounterMetricFamily(
        "depthsr_stream_dropped", "Messages, parts and frames not used", labels=["stream", "reason"]
    )
    latency = GaugeMetricFamily(
        "depthsr_stream_latency_seconds", "Of the last frames",
        labels=["stream", "stage", "quantile"],
    )  # fmt: skip
    for item in items:
        run.add_metric([item.id], item.run)
        status = item.status
        if not status:
            continue
        rate_in.add_metric([item.id], status["fps_in"])
        rate_out.add_metric([item.id], status["fps_out"])
        frames.add_metric([item.id], status["frames_done"])
        size.add_metric([item.id], status["bytes_out"])
        dropped = {**status["counts"], "frames_too_late": status["frames_too_late"]}
        for reason in (*DROPS, "frames_too_late"):
            drops.add_metric([item.id, reason], dropped[reason])
        for stage, values in status["latency"].items():
            for quantile, name in (("0.5", "median_ms"), ("0.95", "p95_ms")):
                latency.add_metric([item.id, stage, quantile], values[name] / 1000)
    yield from (rate_in, rate_out, run, frames, size, drops, latency)
