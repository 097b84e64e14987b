"""Several sinks at once, for a job that is written in more than one way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from pipeline.fan_out import fan_out
from pipeline.job import Segment
from pipeline.results import FrameResult
from pipeline.sink import Sink


class TeeSink:
    """Gives every frame to every sink, each in a thread of its own: see :class:`Sink`.

    Parameters
    ----------
    main : Sink
        Its files have the names they have without us; its account of the stages is returned.
    others : mapping of str to Sink
        By a name, which is put into the names of their files in the work folder, and under
        which their seconds are told.
    """

    def __init__(self, main: Sink, others: Mapping[str, Sink]) -> None:
        self._main = main
        self._others = dict(others)

    def prepare(self) -> None:
        """Find out whether everything can be written, and clear away what killed runs left."""
        for sink in self._sinks.values():
            sink.prepare()

    def write_segment(
        self, segment: Segment, stem: Path, results: Iterable[FrameResult]
    ) -> dict[str, float]:
        """Write the frames of a segment in every way; return the seconds by stage."""

        def writer(name: str, sink: Sink) -> Callable[[Iterator[FrameResult]], dict[str, float]]:
            return lambda frames: sink.write_segment(segment, _marked(stem, name), frames)

        timings = fan_out(results, {name: writer(name, sink) for name, sink in self._sinks.items()})
        told = dict(timings.pop(""))
        return told | {name: sum(stages.values()) for name, stages in timings.items()}

    def files_of(self, segment: Segment, stem: Path) -> Sequence[Path]:
        """Return the files that :meth:`write_segment` leaves."""
        return [
            path
            for name, sink in self._sinks.items()
            for path in sink.files_of(segment, _marked(stem, name))
        ]

    def join(self, stems: Sequence[Path]) -> Sequence[Path]:
        """Put the segments together in every way; return what the main sink has written."""
        for name, sink in self._others.items():
            sink.join([_marked(stem, name) for stem in stems])
        return self._main.join(stems)

    @property
    def _sinks(self) -> dict[str, Sink]:
        return {"": self._main, **self._others}


def _marked(stem: Path, name: str) -> Path:
    return stem.with_name(f"{stem.name}-{name}") if name else stem
