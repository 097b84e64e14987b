"""Several sinks at once: each writes what it would write alone."""

from __future__ import annotations

from fractions import Fraction

import pytest

from pipeline.grid import Grid, Sampling
from pipeline.job import OutputOptions, Segment
from pipeline.sink import MemorySink, OutputPlan
from pipeline.tee_sink import TeeSink


class _Result:
    def __init__(self, frame_index):
        self.frame_index = frame_index


def _sink(path):
    plan = OutputPlan(
        options=OutputOptions(output=path), targets=("a", "b"), left="a", right="b",
        hr_shape=(4, 6), fps=Fraction(5), bit_depth=8, is_color=False,
        grid=Grid(magnification_x=2, magnification_y=2, sampling=Sampling.AREA),
    )  # fmt: skip
    return MemorySink(plan)


@pytest.fixture
def tee(tmp_path):
    main, other = _sink(tmp_path / "main.txt"), _sink(tmp_path / "other.txt")
    return TeeSink(main, {"copy": other})


def test_each_sink_writes_its_own_files(tee, tmp_path):
    segments = [Segment(index=0, start=3, stop=5), Segment(index=1, start=5, stop=6)]
    stems = [tmp_path / segment.name for segment in segments]
    tee.prepare()
    for segment, stem in zip(segments, stems, strict=True):
        frames = [_Result(number) for number in range(segment.start, segment.stop)]
        assert tee.write_segment(segment, stem, frames) == {"encode": 0.0, "copy": 0.0}
        files = tee.files_of(segment, stem)
        assert len(set(files)) == 2
        assert all(path.is_file() for path in files)
    assert tee.join(stems) == [tmp_path / "main.txt"]
    assert (tmp_path / "main.txt").read_text() == "3\n4\n5\n"
    assert (tmp_path / "other.txt").read_text() == "3\n4\n5\n"


def test_what_the_frames_raise_passes(tee, tmp_path):
    def frames():
        yield _Result(0)
        raise OSError("lost")

    segment = Segment(index=0, start=0, stop=2)
    with pytest.raises(OSError, match="lost"):
        tee.write_segment(segment, tmp_path / segment.name, frames())
    assert not any(path.is_file() for path in tee.files_of(segment, tmp_path / segment.name))
