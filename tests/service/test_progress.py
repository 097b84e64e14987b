from __future__ import annotations

import io

import pytest

from pipeline.errors import Interrupted, OutputError, SceneError
from pipeline.events import Compiling, FrameFinished, JobFinished, JobStarted, Warned
from service.console import one_line, report_error
from service.progress import Progress, duration, progress_text


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


STARTED = JobStarted(
    frames_total=4, frames_done=1, num_views=8, targets=("cam3", "cam4"), lr_shape=(20, 30),
    hr_shape=(40, 60),
)  # fmt: skip


def _show(stream: io.StringIO, *, quiet: bool = False, seconds: float = 20.0) -> str:
    times = iter(range(0, 10_000))
    progress = Progress(stream, quiet=quiet, clock=lambda: next(times) * seconds)
    progress(STARTED)
    progress(Compiling())
    for done in (2, 3, 4):
        progress(FrameFinished(frame_index=done, done=done, total=4))
    progress(Warned(text="view 'cam7' sees nothing"))
    progress(JobFinished(seconds=3.0))
    progress.close()
    return stream.getvalue()


def test_plain_lines_where_there_is_no_terminal():
    lines = _show(io.StringIO()).splitlines()
    assert lines[0] == (
        "depthsr: 8 views of 30×20 → cam3 and cam4 of 60×40, 4 frames, 1 of them done before"
    )
    assert "compiling" in lines[1]
    assert lines[2].startswith("depthsr: frame 2 of 4, 20.00 s a frame, 0:40 left")
    assert lines[-1] == "depthsr: warning: view 'cam7' sees nothing"
    assert not any("\r" in line for line in lines)


def test_plain_lines_are_few():
    lines = _show(io.StringIO(), seconds=0.01).splitlines()
    assert len([line for line in lines if "frame " in line and "of 4," in line]) == 1


def test_a_bar_on_a_terminal_that_leaves_nothing_behind():
    shown = _show(_Terminal())
    assert "\r[###" in shown
    last_line = shown.rsplit("\n", 1)[1]
    assert last_line.replace("\r", "").strip() == "" or last_line.endswith("\r")


def test_quiet_shows_warnings_only():
    assert _show(io.StringIO(), quiet=True) == "depthsr: warning: view 'cam7' sees nothing\n"


def test_rates_and_spans():
    assert progress_text(1, 10, 1, 0.02) == "frame 1 of 10, 50.0 frames a second, 0:00 left"
    assert progress_text(3, 9, 0, 5.0) == "frame 3 of 9"
    assert duration(59.6) == "1:00"


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (SceneError("cut\n  short", path="x.png", frame=3), 2, "x.png, frame 3: cut short"),
        (OutputError("out.mkv: is a folder"), 2, "out.mkv: is a folder"),
        (MemoryError(), 1, "not enough memory"),
        (OSError(5, "Input/output error", "x"), 1, "Input/output error"),
        (ValueError("odd"), 1, "unexpected ValueError: odd (run again with -v"),
    ],
)
def test_errors_are_one_line_with_their_status(error, status, said):
    stream = io.StringIO()
    assert report_error(error, verbose=False, stream=stream) == status
    (line,) = stream.getvalue().splitlines()
    assert line.startswith("depthsr: error: ")
    assert said in line


@pytest.mark.parametrize("error", [Interrupted(), KeyboardInterrupt()])
def test_interruption_is_status_130(error):
    stream = io.StringIO()
    assert report_error(error, verbose=True, stream=stream) == 130
    assert "Traceback" not in stream.getvalue()


def test_a_traceback_only_of_the_unexpected_and_only_when_asked_for():
    for error, wanted in ((ValueError("odd"), True), (SceneError("cut short"), False)):
        stream = io.StringIO()
        try:
            raise error
        except Exception as caught:
            report_error(caught, verbose=True, stream=stream)
        assert ("Traceback" in stream.getvalue()) is wanted
    assert one_line(" a \n\n b\t c ") == "a b c"
