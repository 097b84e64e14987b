from __future__ import annotations

import threading

import pytest

from pipeline.channel import Ahead, Channel, ChannelClosedError
from tests.support.waiting import PATIENCE


def _in_thread(function) -> threading.Thread:
    thread = threading.Thread(target=function)
    thread.start()
    return thread


def test_items_arrive_in_order_and_the_producer_is_paced():
    channel: Channel[int] = Channel(2)
    waiting = []

    def produce() -> None:
        for number in range(50):
            channel.put(number)
            waiting.append(number)
        channel.finish()

    thread = _in_thread(produce)
    taken = []
    for item in channel:
        assert len(waiting) <= item + 4  # two wait, one is in the hand, one is being put
        taken.append(item)
    thread.join(PATIENCE)
    assert taken == list(range(50))


def test_the_producers_error_reaches_the_consumer_after_its_items():
    channel: Channel[int] = Channel(3)
    channel.put(1)
    channel.finish(ValueError("broken"))
    assert channel.take() == 1
    with pytest.raises(ValueError, match="broken"):
        channel.take()


def test_closing_frees_a_producer_that_waits():
    channel: Channel[int] = Channel(1)
    channel.put(0)
    ended = []

    def produce() -> None:
        with pytest.raises(ChannelClosedError):
            channel.put(1)
        ended.append(True)

    thread = _in_thread(produce)
    channel.close()
    channel.close()
    thread.join(PATIENCE)
    assert ended == [True]
    assert list(channel) == []


def test_closing_frees_a_consumer_that_waits():
    channel: Channel[int] = Channel(1)
    ended = []

    def consume() -> None:
        with pytest.raises(ChannelClosedError):
            channel.take()
        ended.append(True)

    thread = _in_thread(consume)
    channel.close()
    thread.join(PATIENCE)
    assert ended == [True]


def test_what_is_made_ahead_arrives_in_order_and_its_error_after_it():
    def items():
        yield from range(5)
        raise ValueError("broken")

    ahead = Ahead(items(), name="maker")
    assert [next(ahead) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(ValueError, match="broken"):
        next(ahead)
    ahead.close()


def test_no_more_is_made_ahead_than_may_wait():
    made = []

    def items():
        for number in range(100):
            made.append(number)
            yield number

    ahead = Ahead(items(), name="maker", capacity=2)
    for item in ahead:
        assert len(made) <= item + 5  # two wait, one is in the hand, one is being put
        if item == 20:
            break
    ahead.close()
    assert len(made) < 30
    assert list(ahead) == []


def test_closing_ends_the_thread():
    ahead = Ahead(iter(int, 1), name="endless")
    assert next(ahead) == 0
    ahead.close()
    ahead.close()
    assert "endless" not in [thread.name for thread in threading.enumerate()]
