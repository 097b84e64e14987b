"""Ports for servers that must be known before they listen, or come back where they were."""

from __future__ import annotations

import contextlib
import random
import socket

PORTS = range(20_000, 32_000)
"""Below those that the kernel gives to connections: none of them can be in the way."""


def free_port() -> int:
    """Return a port of this machine that nobody listens on."""
    chance = random.SystemRandom()
    while True:
        port = chance.choice(PORTS)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
