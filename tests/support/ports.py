"""Ports for servers that must be known before they listen, or come back where they were."""

from __future__ import annotations

import contextlib
import os
import random
import socket

PORTS = range(20_000, 32_000)
"""Below those that the kernel gives to connections: none of them can be in the way."""

SHARES = 8
"""Into so many parts they are divided among processes."""


def free_port() -> int:
    """Return a port of this machine that nobody listens on.

    No two processes of one run of the tests draw from the same ports, since what was free may be
    listened on a while later only.
    """
    number = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % SHARES
    chance = random.SystemRandom()
    while True:
        port = chance.choice(PORTS[number::SHARES])
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
