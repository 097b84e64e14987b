"""What every request meets first: limits, the same-origin rule, headers, the access log."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import time
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.bus.config import is_loopback
from service.config import MIB, ServiceConfig
from service.http import uploads
from service.http.problems import ProblemError, answer

log = logging.getLogger("service.access")

JSON_LIMIT = MIB
"""Largest body that is not a file, bytes."""

SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; "
    "media-src 'self' blob:; worker-src 'self' blob:; style-src 'self' 'unsafe-inline'; "
    "object-src 'none'; base-uri 'none'; frame-ancestors 'none'; form-action 'self'",
}
PROTOCOL_HEADERS = {uploads.router.prefix: {"Tus-Resumable": uploads.VERSION}}
"""What every answer under an address has, problems too."""

PRIVATE = ("/api/", "/dscqs/api/")
"""Answers under these are never kept by a cache."""

BODY_PATIENCE = 60.0
"""Longest pause within a body, seconds."""

OVERRIDES = ("PATCH", "DELETE", "HEAD")
"""Methods of tus that a client which cannot send them names in X-HTTP-Method-Override."""

SAFE = ("GET", "HEAD", "OPTIONS")


class Guards:
    """ASGI middleware; it keeps no body in memory."""

    def __init__(self, app: ASGIApp, config: ServiceConfig) -> None:
        self.app = app
        self.config = config
        self._is_for_this_machine = config.token_file is None and is_loopback(config.host)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check the request, count its body, finish the headers of the answer."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if scope["type"] == "websocket":
            if self._is_misled(headers):
                await send({"type": "websocket.close", "code": 1008})
            else:
                await self.app(scope, receive, send)
            return
        meant = headers.get("x-http-method-override", "").upper()
        if meant in OVERRIDES and scope["path"].startswith(uploads.router.prefix):
            scope = {**scope, "method": meant}
        begin = time.perf_counter()
        metrics = scope["app"].state.metrics
        status = 0
        taken = 0
        is_complete = False
        kind = headers.get("content-type", "").partition(";")[0]
        files = ("multipart/form-data", "application/offset+octet-stream")
        limit = self.config.max_body * MIB if kind in files else JSON_LIMIT

        async def counted() -> Message:
            nonlocal taken, is_complete
            if is_complete:  # what is awaited now is the end of the connection
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), BODY_PATIENCE)
            except TimeoutError:
                raise ProblemError(
                    "too-slow", f"nothing of the body came for {BODY_PATIENCE:g} seconds"
                ) from None
            is_complete = not message.get("more_body", False)
            taken += len(message.get("body", b""))
            if taken > limit:
                raise ProblemError("too-large", f"the body is longer than {limit} bytes")
            return message

        async def finished(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                made = MutableHeaders(scope=message)
                for name, value in SECURITY_HEADERS.items():
                    made.setdefault(name, value)
                for place, headers_there in PROTOCOL_HEADERS.items():
                    if scope["path"].startswith(place):
                        made.update(headers_there)
                if scope["path"].startswith(PRIVATE):
                    made.setdefault("Cache-Control", "no-store")
                metrics.seconds.observe(time.perf_counter() - begin)
            await send(message)

        refused = self._refusal(scope, headers, limit)
        try:
            if refused is not None:
                kind, detail = refused
                refusal = answer(kind, detail, path=scope["path"])
                await refusal(scope, receive, finished)
            else:
                await self.app(scope, counted, finished)
        finally:
            metrics.requests.labels(scope["method"], str(status)).inc()
            metrics.bytes_in.inc(taken)
            log.info(
                "request",
                extra={
                    "method": scope["method"],
                    "path": scope["path"],
                    "status": status,
                    "seconds": round(time.perf_counter() - begin, 4),
                },
            )

    def _is_misled(self, headers: Headers) -> bool:
        """Tell whether a page elsewhere has had its own name mean this machine (DNS rebinding).

        Its requests are of its own origin then, and nothing else would keep it out where no
        token is asked for.
        """
        return self._is_for_this_machine and not names_this_machine(headers.get("host", ""))

    def _refusal(self, scope: Scope, headers: Headers, limit: int) -> tuple[str, str] | None:
        if self._is_misled(headers):
            return (
                "forbidden",
                "without tokens this is for localhost and addresses only, not for other names; "
                "use --token-file",
            )
        length = headers.get("content-length", "0")
        if length.isascii() and length.isdigit() and int(length[:18]) > limit:
            return "too-large", f"the body is longer than {limit} bytes"
        origin = headers.get("origin")
        if origin and scope["method"] not in SAFE:
            try:
                same = urlsplit(origin).netloc == headers.get("host")
            except ValueError:
                same = False
            if not same:
                return "forbidden", "pages of another origin may not do this"
        return None


def names_this_machine(host: str) -> bool:
    """Tell whether a Host header has a name that nobody else can make mean this machine.

    >>> [names_this_machine(host) for host in ("localhost:8000", "[::1]:80", "evil.example", "")]
    [True, True, False, True]
    """
    try:
        name = urlsplit(f"//{host}").hostname or ""
        if not host or name == "localhost":
            return True
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
