"""One stream for several takers: order, errors of either side, nobody left waiting."""

from __future__ import annotations

import threading

import pytest

from pipeline.channel import ChannelClosedError
from pipeline.fan_out import fan_out


def test_everybody_gets_everything_in_order():
    assert fan_out(range(50), {"a": list, "b": sum}) == {"a": list(range(50)), "b": 1225}


def test_an_error_of_the_source_reaches_the_caller_and_no_taker_takes_it_for_the_end():
    seen = []

    def source():
        yield 1
        raise KeyError("source")

    def taker(items):
        try:
            return list(items)
        except ChannelClosedError:
            seen.append("closed")
            raise

    with pytest.raises(KeyError, match="source"):
        fan_out(source(), {"a": taker, "b": taker})
    assert seen == ["closed", "closed"]


def test_an_error_of_a_taker_ends_the_others():
    def fails(items):
        next(items)
        raise ValueError("full")

    before = set(threading.enumerate())
    with pytest.raises(ValueError, match="full"):
        fan_out(iter(range(10**9)), {"a": list, "b": fails})
    assert set(threading.enumerate()) <= before
