"""Threads that give way: who does, who does not, and what comes back of them."""

from __future__ import annotations

import os
import sys
import threading

import pytest

from pipeline.background import BEHIND, LEAST, give_way, giving_way
from pipeline.channel import Ahead
from pipeline.fan_out import fan_out

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux has a priority for each thread"
)


def _priority():
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


def _behind():
    return min(_priority() + BEHIND, LEAST)


def test_who_gives_way_takes_along_whom_he_begins_and_nobody_else():
    def begin_another():
        found = []
        thread = threading.Thread(target=lambda: found.append(_priority()))
        thread.start()
        thread.join()
        return _priority(), *found

    before, behind = _priority(), _behind()
    assert giving_way(begin_another) == (behind, behind)
    assert _priority() == before


def test_it_gives_way_only_so_far():
    def again():
        for _ in range(3):
            give_way()
        return _priority()

    assert giving_way(again) == LEAST


def test_an_error_reaches_who_asked():
    with pytest.raises(KeyError, match="lost"):
        giving_way(lambda: {}["lost"])


@pytest.mark.parametrize("gives_way", [False, True])
def test_what_is_made_ahead_gives_way_where_that_is_asked(gives_way):
    ahead = Ahead((_priority() for _ in range(1)), name="maker", gives_way=gives_way)
    assert list(ahead) == [_behind() if gives_way else _priority()]
    ahead.close()


@pytest.mark.parametrize("gives_way", [False, True])
def test_takers_give_way_where_that_is_asked(gives_way):
    def taker(items):
        return [_priority() for _ in items]

    found = fan_out(range(2), {"a": taker, "b": taker}, give_way_to_others=gives_way)
    wanted = [_behind() if gives_way else _priority()] * 2
    assert found == {"a": wanted, "b": wanted}
