"""A subscriber that stands still holds up neither the publisher nor the other subscribers."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time

from service.bus.bus import JPEG
from service.bus.config import BusConfig
from service.bus.zenoh_bus import ZenohBus

FRAME = bytes(1_200_000)
"""As large as a JPEG of 4096×1536."""

RATE = 15.0
FRAMES = 60

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
        try:
            assert stalled.stdout.readline() == "ready\n"
            arrived: list[tuple[int, float]] = []
            fast.subscribe(
                "depthsr/a/out/left",
                lambda item: arrived.append((int(item.attachment), time.monotonic())),
            )
            publisher = sender.publisher("depthsr/a/out/left", encoding=JPEG, urgent=True)
            pause = threading.Event()
            while not arrived:
                publisher.put(FRAME, b"-1")
                pause.wait(0.2)
            os.kill(stalled.pid, signal.SIGSTOP)
            arrived.clear()
            puts = []
            for number in range(FRAMES):
                begin = time.monotonic()
                publisher.put(FRAME, b"%d" % number)
                puts.append(time.monotonic() - begin)
                pause.wait(max(0.0, 1 / RATE - puts[-1]))
            pause.wait(1.0)
        finally:
            stalled.kill()
    numbers = [number for number, _ in arrived]
    times = [at for _, at in arrived]
    gaps = [later - earlier for earlier, later in itertools.pairwise(times)]
    assert numbers == sorted(numbers)
    assert len(numbers) > 0.8 * FRAMES
    assert max(puts) < 1.0
    assert max(gaps) < 1.5  # a publisher that waits is held up for 5 s, and all others with it
