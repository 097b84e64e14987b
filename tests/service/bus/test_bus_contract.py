"""What a bus does, whether it is zenoh or its twin in memory."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from service.bus.bus import JPEG, JSON, Answer, Bus, BusError
from service.bus.config import BusConfig
from service.bus.memory import MemoryNetwork
from service.bus.zenoh_bus import ZenohBus
from tests.support.waiting import PATIENCE, until


@pytest.fixture(params=["memory", "zenoh"])
def buses(request) -> Iterator[tuple[Bus, Bus]]:
    """Two buses that hear each other."""
    if request.param == "memory":
        network = MemoryNetwork()
        with network.connect() as one, network.connect() as two:
            yield one, two
        return
    with (
        ZenohBus(BusConfig(mode="router", listen=("tcp/127.0.0.1:0",))) as router,
        ZenohBus(BusConfig(connect=router.listening)) as one,
        ZenohBus(BusConfig(connect=router.listening)) as two,
    ):
        yield one, two


def meet(publisher, heard):
    """Send until it is heard: a subscription may still be on its way, and then nobody is told."""
    until(lambda: publisher.put(b"there?") or b"there?" in heard)
    publisher.put(b"there")
    until(lambda: b"there" in heard)
    heard.clear()


def test_messages_come_in_order_with_all_that_belongs_to_them(buses):
    one, two = buses
    got, heard = [], []

    def hear(item):
        data = item.read()
        heard.append(data)
        got.append((item, data))

    two.subscribe("depthsr/*/out/**", hear)
    publisher = one.publisher("depthsr/a/out/sbs", encoding=JPEG, urgent=True)
    meet(publisher, heard)
    got.clear()
    for number in range(20):
        publisher.put(bytes([number]) * (number + 1), attachment=b"%d" % number)
        until(lambda number=number: len(got) == number + 1)
    one.put("depthsr/a/status", b"{}", encoding=JSON)
    until(lambda: len(got) == 20)
    assert [item.attachment for item, _ in got] == [b"%d" % number for number in range(20)]
    assert {(item.key, item.encoding) for item, _ in got} == {("depthsr/a/out/sbs", JPEG)}
    assert all(data == bytes([n]) * (n + 1) and item.size == n + 1
               for n, (item, data) in enumerate(got))  # fmt: skip


def test_a_subscription_ends(buses):
    one, two = buses
    got = []
    subscription = two.subscribe("depthsr/a/status", lambda item: got.append(item.read()))
    publisher = one.publisher("depthsr/a/status", encoding=JSON)
    meet(publisher, got)
    publisher.put(b"1")
    until(lambda: got == [b"1"])
    assert publisher.has_subscribers
    subscription.close()
    subscription.close()
    until(lambda: not publisher.has_subscribers)
    publisher.put(b"2")
    assert got == [b"1"]


def test_that_nobody_listens_is_known(buses):
    """What is asked for by nobody is not encoded."""
    one, two = buses
    publisher = one.publisher("depthsr/a/out/left", encoding=JPEG)
    until(lambda: not publisher.has_subscribers)
    subscription = two.subscribe("depthsr/a/out/left", lambda item: None)
    until(lambda: publisher.has_subscribers)
    subscription.close()
    until(lambda: not publisher.has_subscribers)


def test_questions_are_answered_by_everybody_they_meet(buses):
    one, two = buses

    def answer(question):
        yield Answer(
            key="depthsr/a/info", payload=question.parameters.encode(), encoding=JSON,
            attachment=b"x",
        )  # fmt: skip

    assert list(one.ask("depthsr/a/info")) == []
    two.answer("depthsr/a/info", answer)
    until(lambda: one.ask("depthsr/a/info"))
    (found,) = one.ask("depthsr/a/info?limit=3;b=c", timeout=PATIENCE)
    assert (found.read(), found.encoding, found.attachment) == (b"limit=3;b=c", JSON, b"x")
    assert len(one.ask("depthsr/*/info", timeout=PATIENCE)) == 1
    assert list(one.ask("depthsr/b/info")) == []


def test_who_lives_is_seen_and_missed(buses):
    one, two = buses
    token = two.live("depthsr/a/alive")
    until(lambda: list(one.who_lives("depthsr/*/alive")) == ["depthsr/a/alive"])
    seen = []
    one.watch_lives("depthsr/*/alive", lambda key, there: seen.append((key, there)))
    until(lambda: seen == [("depthsr/a/alive", True)])
    token.close()
    until(lambda: seen[-1] == ("depthsr/a/alive", False))
    assert list(one.who_lives("depthsr/*/alive")) == []
    two.live("depthsr/@service")
    until(lambda: one.who_lives("depthsr/@service"))
    assert list(one.who_lives("depthsr/**")) == []


def test_what_a_closed_bus_is_asked_is_an_error(buses):
    one, _ = buses
    one.close()
    one.close()
    with pytest.raises(BusError):
        one.put("depthsr/a/status", b"", encoding=JSON)


def test_an_endpoint_that_cannot_be_had_is_told_in_one_line():
    with ZenohBus(BusConfig(mode="router", listen=("tcp/127.0.0.1:0",))) as router:
        endpoint = router.listening[0]
        with pytest.raises(BusError, match="in use") as caught:
            ZenohBus(BusConfig(mode="router", listen=(endpoint,)))
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value)
    with pytest.raises(BusError, match="Unable to connect"):
        ZenohBus(BusConfig(connect=(endpoint,)))


def test_a_message_larger_than_allowed_goes_nowhere_and_harms_nobody():
    router = ZenohBus(BusConfig(mode="router", listen=("tcp/127.0.0.1:0",), max_message=2 << 20))
    with (
        router,
        ZenohBus(BusConfig(connect=router.listening)) as rude,
        ZenohBus(BusConfig(connect=router.listening)) as polite,
        ZenohBus(BusConfig(connect=router.listening)) as listener,
    ):
        got, heard = [], []

        def hear(item):
            got.append((item.key, item.size))
            heard.append(item.read())

        listener.subscribe("depthsr/*/in/*/*", hear)
        large = rude.publisher("depthsr/a/in/x/color", encoding=JPEG)
        small = polite.publisher("depthsr/b/in/x/color", encoding=JPEG)
        meet(large, heard)
        meet(small, heard)
        got.clear()
        large.put(bytes(20 << 20))
        for number in range(5):
            small.put(b"ok")
            until(lambda number=number: len(got) == number + 1)
        assert set(got) == {("depthsr/b/in/x/color", 2)}
        until(lambda: large.put(b"later") or ("depthsr/a/in/x/color", 5) in got)
