"""What a subscriber is told of losses and of workers started anew."""

from __future__ import annotations

import threading

import pytest

from service.bus import keys
from service.bus.bus import H264
from service.bus.keys import Output
from service.bus.memory import MemoryNetwork
from service.streams.messages import OutputHeader
from service.streams.receiver import Receiver

BEFORE = [(1, 0, True), (1, 1, False)]
"""Messages as (run, sequence, whether decoding can begin with it)."""


def received(messages):
    """Return the units that a receiver makes of the messages that come."""
    network = MemoryNetwork()
    receiver = Receiver(network.connect(), "s")
    bus = network.connect()
    for run, sequence, key in messages:
        header = OutputHeader(
            sequence=sequence, run=run, frame_index=sequence, position=sequence, fps="15/1",
            capture_time_ns=0, published_time_ns=0, width=8, height=4, layout="sbs", key=key,
        )  # fmt: skip
        bus.put(keys.output("s", Output.SBS), b"x", encoding=H264, attachment=header.encoded())
    return list(receiver.units(stop=threading.Event(), timeout=0.0))


@pytest.mark.parametrize(
    ("after", "first", "missed"),
    [
        ([(2, 2, True)], 2, 0),
        ([(2, 3, False), (2, 4, False), (2, 5, True)], 5, 1),  # its first, the key, was lost
        ([(2, 3, False), (2, 5, True)], 5, 2),
    ],
)
def test_a_new_run_is_told_with_its_first_unit_that_can_be_used(after, first, missed):
    unit = received(BEFORE + after)[len(BEFORE)]
    assert (unit.sequence, unit.missed, unit.is_new_run) == (first, missed, True)


def test_what_is_lost_is_told_once_and_nothing_is_given_until_a_key_frame():
    lost = [(1, 3, False), (1, 4, False), (1, 6, True), (1, 7, False), (1, 7, False)]
    units = received(BEFORE + lost)
    assert [(unit.sequence, unit.missed) for unit in units] == [(0, 0), (1, 0), (6, 2), (7, 0)]
    assert not any(unit.is_new_run for unit in units)
