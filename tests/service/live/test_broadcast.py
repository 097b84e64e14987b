"""Fragments stored once, viewers at their own pace: order, gaps, joins, ends, threads."""

from __future__ import annotations

import asyncio
import re
import threading
from contextlib import aclosing
from fractions import Fraction

import numpy as np
import pytest

from pipeline.media.live_encode import LiveEncoder
from pipeline.stereo import StereoLayout
from service.live import broadcast as module
from service.live.broadcast import Broadcast, Broadcasts, Gap
from service.live.fragments import Fragment, Init, Splitter
from tests.support.waiting import PATIENCE

FPS = Fraction(15)


def _coded(count: int, *, height: int = 32) -> list[bytes]:
    """Return the bytes of each frame of a video that never ends (15 a second)."""
    encoder = LiveEncoder(fps=FPS, layout=StereoLayout.SBS)
    picture = np.random.default_rng(5).integers(0, 256, (height, 64, 3), np.uint8)
    pieces = []
    for number in range(count):
        encoder.encode(np.roll(picture, number, 1), number)
        pieces.append(encoder.take_mp4())
    encoder.close()
    return pieces


@pytest.fixture(scope="module")
def coded() -> list[bytes]:
    """120 frames: 119 fragments, a key frame every 15."""
    return _coded(120)


def _broadcast(**options) -> Broadcast:
    return Broadcast(fps=FPS, layout=StereoLayout.SBS, **options)


def _watch(broadcast: Broadcast):
    """Return all that a viewer gets until the end."""

    async def collect():
        async with aclosing(broadcast.watch()) as parts:
            return [part async for part in parts]

    return asyncio.run(collect())


def test_who_joins_late_begins_at_the_newest_key_frame(coded):
    broadcast = _broadcast()
    for piece in coded[:40]:
        broadcast.feed(piece)
    broadcast.close()
    init, *rest = _watch(broadcast)
    assert isinstance(init, Init)
    assert [part.start * 15 // init.timescale for part in rest] == list(range(30, 39))
    assert rest[0].is_key


def test_a_viewer_gets_every_fragment_of_a_feeding_thread_once_and_in_order(coded):
    broadcast = _broadcast()

    async def collect():
        broadcast.feed(coded[0])
        broadcast.feed(coded[1])
        async with aclosing(broadcast.watch()) as parts:
            got = [await anext(parts), await anext(parts)]
            thread = threading.Thread(target=lambda: [broadcast.feed(x) for x in coded[2:]])
            thread.start()
            await asyncio.to_thread(thread.join)
            broadcast.close()
            return got + [part async for part in parts]

    _, *parts = asyncio.run(collect())
    whole = b"".join(coded)
    expected = [part for part in Splitter().feed(whole) if isinstance(part, Fragment)]
    gaps = [part for part in parts if isinstance(part, Gap)]
    kept = [part for part in parts if isinstance(part, Fragment)]
    assert sum(gap.fragments for gap in gaps) + len(kept) == len(expected) == broadcast.fragments
    assert kept[0] == expected[0]
    assert kept[-1] == expected[-1]
    starts = [part.start for part in kept]
    assert starts == sorted(set(starts))


def test_a_viewer_within_its_patience_misses_nothing_and_a_slow_one_goes_on_at_a_key_frame(coded):
    broadcast = _broadcast()

    async def watch():
        broadcast.feed(coded[0])
        broadcast.feed(coded[1])
        async with aclosing(broadcast.watch()) as parts:
            got = [await anext(parts), await anext(parts)]
            for piece in coded[2:25]:  # 1.6 seconds: patience is 2
                broadcast.feed(piece)
            got += [await anext(parts) for _ in range(23)]
            for piece in coded[25:]:  # 6.3 seconds
                broadcast.feed(piece)
            broadcast.close()
            return got, [part async for part in parts]

    (_, *got), (gap, *rest) = asyncio.run(watch())
    frame = 15360 // 15
    assert [part.start // frame for part in got] == list(range(24))
    assert gap == Gap(fragments=105 - 24)
    assert rest[0].is_key
    assert [part.start // frame for part in rest] == list(range(105, 119))
    assert broadcast.left_out == 81


def test_viewers_share_the_bytes(coded):
    broadcast = _broadcast()
    for piece in coded[:20]:
        broadcast.feed(piece)
    broadcast.close()
    one, other = _watch(broadcast), _watch(broadcast)
    assert len(one) > 1
    assert all(a is b for a, b in zip(one, other, strict=True))
    newest = int(re.findall(r"segment-(\d+)", broadcast.playlist())[-1])
    assert all(a is b.data for a, b in zip(broadcast.segment(newest), one[1:], strict=True))


def test_the_ring_is_bounded_and_the_playlist_lists_whole_segments(coded):
    broadcast = _broadcast(keep=4.0)
    seen = []
    for piece in coded:
        broadcast.feed(piece)
        seen.append(broadcast.playlist())
    numbers = [int(found) for found in re.findall(r"segment-(\d+)", seen[-1])]
    assert numbers == [5, 6]  # seconds 5 and 6; 7 still grows
    assert "#EXT-X-MEDIA-SEQUENCE:5" in seen[-1]
    assert "#EXT-X-PLAYLIST-TYPE" not in seen[-1]
    assert broadcast.segment(1) is None
    assert broadcast.segment(7) is None
    data = broadcast.init(0).data + b"".join(b"".join(broadcast.segment(n)) for n in numbers)
    _, *parts = Splitter().feed(data)
    assert len(parts) == 30
    assert parts[0].is_key
    broadcast.close()
    assert broadcast.playlist().endswith("segment-000007.m4s\n#EXT-X-ENDLIST\n")
    assert len(broadcast.segment(7)) == 14


def test_another_kind_of_video_brings_its_init_segment(coded):
    broadcast = _broadcast()
    for piece in [*coded[:16], *_coded(32, height=48)]:
        broadcast.feed(piece)
    broadcast.close()
    listed = broadcast.playlist()
    assert listed.index("init-0.mp4") < listed.index("#EXT-X-DISCONTINUITY\n")
    assert listed.index("#EXT-X-DISCONTINUITY\n") < listed.index("init-1.mp4")
    assert broadcast.newest_init == broadcast.init(1) != broadcast.init(0)
    assert _watch(broadcast)[0] is broadcast.init(1)


def test_a_viewer_meets_the_change_where_it_happens(coded):
    broadcast = _broadcast()

    async def watch():
        for piece in coded[:10]:
            broadcast.feed(piece)
        async with aclosing(broadcast.watch()) as parts:
            got = [await anext(parts)]
            for piece in _coded(10, height=48):
                broadcast.feed(piece)
            broadcast.close()
            return got + [part async for part in parts]

    got = asyncio.run(watch())
    places = [place for place, part in enumerate(got) if isinstance(part, Init)]
    assert places == [0, 10]
    assert got[11].is_key


def test_stills_skip_for_the_slow():
    broadcast = _broadcast()

    async def watch():
        broadcast.show(b"0")
        async with aclosing(broadcast.stills()) as stills:
            first = await anext(stills)
            for number in range(1, 5):
                broadcast.show(b"%d" % number)
            broadcast.close()
            return [first, *[still async for still in stills]]

    assert [still.jpeg for still in asyncio.run(watch())] == [b"0", b"4"]


def test_viewers_are_counted_and_leave():
    broadcast = _broadcast()

    async def come_and_go():
        async with aclosing(broadcast.stills()) as stills:
            waiting = asyncio.ensure_future(anext(stills))
            await asyncio.sleep(0)
            assert broadcast.viewers == 1
            broadcast.show(b"x")
            await waiting
        return broadcast.viewers

    assert asyncio.run(come_and_go()) == 0


def test_broadcasts_by_name(coded):
    broadcasts = Broadcasts()
    first = broadcasts.open("streams/a", fps=FPS, layout=StereoLayout.SBS)
    second = broadcasts.open("streams/a", fps=FPS, layout=StereoLayout.SBS)
    assert first.ended
    assert broadcasts.get("streams/a") is second
    assert broadcasts.get("streams/b") is None
    broadcasts.stop()
    assert second.ended
    broadcasts.close("streams/a")
    assert broadcasts.all() == {}


class Maker:
    """Makes a still when it is asked for one; each with its number."""

    def __init__(self):
        self.asked = 0
        self.answer = self.show
        self.is_there = True

    def __call__(self):
        self.asked += 1
        if self.is_there:
            threading.Timer(0.01, self.answer).start()
        return self.is_there

    def show(self):
        self.broadcast.show(b"%d" % self.asked)


@pytest.fixture
def maker(monkeypatch):
    monkeypatch.setattr(module, "FRESH", 0.0)
    maker = Maker()
    maker.broadcast = _broadcast(ask_still=maker)
    return maker


def _still(broadcast):
    """Return the still that is had for the asking."""
    found = asyncio.run(broadcast.still())
    return None if found is None else found.jpeg


def test_a_still_is_made_for_who_asks(maker):
    assert [_still(maker.broadcast) for _ in range(3)] == [b"1", b"2", b"3"]
    assert maker.broadcast.viewers == 0
    maker.answer = maker.broadcast.confirm
    assert _still(maker.broadcast) == b"3"
    maker.is_there = False
    assert _still(maker.broadcast) == b"3"
    maker.broadcast.lose_still()
    assert _still(maker.broadcast) is None
    maker.is_there, maker.answer = True, maker.show
    assert _still(maker.broadcast) == b"7"
    maker.broadcast.close()
    assert _still(maker.broadcast) == b"7"
    assert maker.asked == 7


def test_those_who_ask_at_once_share_a_still(maker, monkeypatch):
    monkeypatch.setattr(module, "FRESH", PATIENCE)

    async def ask():
        return [await maker.broadcast.still() for _ in range(20)]

    assert {still.jpeg for still in asyncio.run(ask())} == {b"1"}
    assert maker.asked == 1


def test_an_old_still_is_not_shown_for_want_of_an_answer(maker, monkeypatch):
    monkeypatch.setattr(module, "ANSWERED_WITHIN", 0.05)
    maker.show()
    maker.answer = lambda: None
    assert _still(maker.broadcast) is None

    async def watch():
        async with aclosing(maker.broadcast.stills()) as stills:
            first = asyncio.ensure_future(anext(stills))
            done, _ = await asyncio.wait([first], timeout=0.2)
            assert not done
            assert maker.broadcast.viewers_of_stills == 1
            maker.broadcast.show(b"new")
            return (await first).jpeg

    assert asyncio.run(watch()) == b"new"


def test_who_comes_to_look_on_gets_the_newest_first(maker):
    maker.show()

    async def watch():
        async with aclosing(maker.broadcast.stills()) as stills:
            return (await anext(stills)).jpeg

    assert asyncio.run(watch()) == b"1"
    assert maker.broadcast.viewers_of_stills == 0


def test_the_end_answers_all_who_ask(maker):
    maker.answer = maker.broadcast.stop
    assert _still(maker.broadcast) is None


def test_a_video_that_paused_is_not_shown_and_goes_on_with_new_numbers(coded):
    broadcast = _broadcast()
    for piece in coded[:40]:
        broadcast.feed(piece)
    known = broadcast.newest_init
    numbers = [int(found) for found in re.findall(r"segment-(\d+)", broadcast.playlist())]
    broadcast.pause()
    assert broadcast.newest_init is known
    assert "segment" not in broadcast.playlist()

    async def watch():
        async with aclosing(broadcast.watch()) as parts:
            first = asyncio.ensure_future(anext(parts))
            await asyncio.sleep(0)
            for piece in coded[:10]:
                broadcast.feed(piece)
            found = [await first, await anext(parts)]
            for piece in coded[10:20]:
                broadcast.feed(piece)
            return found

    init, part = asyncio.run(watch())
    assert (init, part.start, part.is_key) == (broadcast.init(1), 0, True)
    (following,) = re.findall(r"segment-(\d+)", broadcast.playlist())
    assert int(following) > max(numbers)


def test_a_video_is_asked_for_by_who_watches(coded):
    def begin():
        for piece in coded[:40]:
            broadcast.feed(piece)

    broadcast = _broadcast(ask_video=lambda: threading.Timer(0.01, begin).start())
    assert not broadcast.is_watched
    asyncio.run(broadcast.filled())
    assert broadcast.is_watched
    assert "segment" in broadcast.playlist()

    broadcast = _broadcast(ask_video=lambda: threading.Timer(0.01, begin).start())

    async def watch():
        async with aclosing(broadcast.watch()) as parts:
            found = [await anext(parts), await anext(parts)]
            assert broadcast.is_watched
            return found

    assert [type(part) for part in asyncio.run(watch())] == [Init, Fragment]
    assert not broadcast.is_watched
