"""A subscriber that stands still holds up neither the publisher nor the other subscribers."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import time

from service.bus.bus import JPEG
from service.bus.config import BusConfig
from service.bus.zenoh_bus import ZenohBus

FRAME = bytes(1_200_000)
"""As large as a JPEG of 4096×1536."""

FRAMES = 40

HELD_UP = 5.0
"""So long a publisher that waits is held up, and all others with it, seconds."""

SUBSCRIBER = """
import sys, time
from service.bus.config import BusConfig
from service.bus.zenoh_bus import ZenohBus
with ZenohBus(BusConfig(connect=(sys.argv[1],))) as bus:
    bus.subscribe("depthsr/a/out/left", lambda item: print(item.size, flush=True))
    print("ready", flush=True)
    time.sleep(600)
"""


def test_a_stalled_subscriber_slows_nobody():
    """One frame after the other: of what comes too fast a busy machine drops much."""
    with (
        ZenohBus(BusConfig(mode="router", listen=("tcp/127.0.0.1:0",))) as router,
        ZenohBus(BusConfig(connect=router.listening)) as sender,
        ZenohBus(BusConfig(connect=router.listening)) as fast,
        subprocess.Popen(
            [sys.executable, "-c", SUBSCRIBER, router.listening[0]],
            stdout=subprocess.PIPE, text=True,
        ) as stalled,
    ):  # fmt: skip
        assert stalled.stdout is not None
        arrived: queue.Queue[tuple[int, float]] = queue.Queue()
        publisher = sender.publisher("depthsr/a/out/left", encoding=JPEG, urgent=True)
        begins: list[float] = []
        puts: list[float] = []
        numbers: list[int] = []
        delays: list[float] = []

        def send() -> None:
            """Send one frame, and wait a little for it."""
            number = len(begins)
            begins.append(time.monotonic())
            publisher.put(FRAME, b"%d" % number)
            puts.append(time.monotonic() - begins[-1])
            with contextlib.suppress(queue.Empty):
                while not numbers or numbers[-1] < number:
                    came, at = arrived.get(timeout=0.2)
                    numbers.append(came)
                    delays.append(at - begins[came])

        try:
            assert stalled.stdout.readline() == "ready\n"
            fast.subscribe(
                "depthsr/a/out/left",
                lambda item: arrived.put((int(item.attachment), time.monotonic())),
            )
            while not numbers:
                send()
            os.kill(stalled.pid, signal.SIGSTOP)
            while len(numbers) < FRAMES:
                send()
        finally:
            stalled.kill()
    assert numbers == sorted(set(numbers))
    assert max(puts) < HELD_UP
    assert max(delays) < HELD_UP
