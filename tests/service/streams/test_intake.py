from __future__ import annotations

from dataclasses import replace

from service.bus import keys
from service.bus.bus import JPEG, PNG, Sample
from service.bus.keys import Part
from service.streams.assembly import Expected
from service.streams.intake import Intake, RateLimit
from service.streams.messages import InputHeader, write_input_header

EXPECTED = Expected(
    color=frozenset("ab"), depth=frozenset(), needed=frozenset("ab"), interval=0.1, wait=0.05
)


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def sample(view, frame, *, size=3, encoding=PNG, read=None, attachment=None):
    header = InputHeader(frame_index=frame, capture_time_ns=frame)
    return Sample(
        key=keys.input_key("s", view, Part.COLOR),
        encoding=encoding,
        size=size,
        read=read or (lambda: bytes(size)),
        attachment=write_input_header(header) if attachment is None else attachment,
    )


def make(clock, **more):
    return Intake(EXPECTED, **{"max_payload": 100, "max_rate": 10.0, "clock": clock, **more})


def test_only_the_newest_whole_frame_waits():
    clock = Clock()
    intake = make(clock)
    for frame in range(3):
        intake.hear(sample("a", frame))
        intake.hear(sample("b", frame))
    assert intake.take(0).frame_index == 2
    assert intake.counts()["frames_behind"] == 2
    assert intake.take(0) is None


def test_time_lets_a_frame_go_while_nothing_comes():
    intake = Intake(replace(EXPECTED, needed=frozenset("a")), max_payload=9, max_rate=10.0)
    intake.hear(sample("a", 1))
    assert intake.take(0.2) is None
    assert intake.counts()["frames_incomplete"] == 1


def test_what_is_refused_is_not_even_read():
    def read():
        raise AssertionError("the payload was copied")

    clock = Clock()
    intake = make(clock)
    intake.hear(sample("a", 1, size=101, read=read))
    intake.hear(sample("a", 1, encoding="text/plain", read=read))
    intake.hear(sample("a", 1, attachment=b"no", read=read))
    for _ in range(40):
        intake.hear(sample("a", 1, attachment=b"no", read=read))
    counts = intake.counts()
    assert counts["too_large"] == 1
    assert counts["too_many"] == 43 - 20  # ten frames of two parts
    assert counts["malformed"] == 19
    assert counts["messages"] == 43
    assert "attachment" in intake.last_wrong


def test_a_waiting_worker_is_woken():
    intake = make(Clock())
    intake.wake()
    assert intake.take(60) is None


def test_the_rate_recovers():
    limit = RateLimit(rate=2)
    assert [limit.allows(at) for at in (0, 0, 0, 0.4, 0.6, 0.7)] == [
        True, True, False, False, True, False
    ]  # fmt: skip


def test_raw_pictures_need_their_size():
    intake = make(Clock())
    intake.hear(sample("a", 1, encoding="video/raw"))
    assert "raw pictures need width" in intake.last_wrong
    intake.hear(sample("a", 1, encoding=JPEG + ";quality=90"))
    assert intake.counts()["malformed"] == 1
