"""Files by whole, ranges, head and tag; what goes wrong is a problem as everywhere."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Header
from fastapi.responses import FileResponse
from fastapi.routing import APIRoute
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Message, Receive, Scope, Send

from service.http.problems import answer

Known = Annotated[
    str | None,
    Header(
        alias="If-None-Match",
        description="ETag of what the client has: 304 where it is that",
        examples=['"4caac27b40f20b80b610d78a"'],
    ),
]
"""The parameter of what can be asked for again."""

TAGGED: dict[str, Any] = {
    "headers": {"ETag": {"schema": {"type": "string"}, "description": "for If-None-Match"}}
}
"""Declares that an answer has a tag."""

BYTES: dict[str, Any] = {"schema": {"type": "string", "format": "binary"}}
"""Declares content that is not text."""


def add_heads(router: APIRouter) -> None:
    """Let every address of a router that can be got be asked for its head."""
    for route in [item for item in router.routes if isinstance(item, APIRoute)]:
        if route.methods == {"GET"}:
            router.add_api_route(
                route.path.removeprefix(router.prefix),
                route.endpoint,
                methods=["HEAD"],
                response_model=route.response_model,
                include_in_schema=False,
            )


class RangedFile(FileResponse):
    """A file whose bad ranges are answered with a problem."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file, or what is wrong with the range; heads and other units have none."""
        unit = Headers(scope=scope).get("range", "").partition("=")[0].strip().lower()
        if scope["method"] != "GET" or unit != "bytes":
            kept = [item for item in scope["headers"] if item[0] != b"range"]
            scope = {**scope, "headers": kept}
        refused: dict[str, str] | None = None
        status = 0

        async def watched(message: Message) -> None:
            nonlocal refused, status
            if message["type"] == "http.response.start" and message["status"] in (400, 416):
                status = message["status"]
                said = Headers(raw=message["headers"]).get("content-range")
                refused = {"Content-Range": said} if said else {}
            if refused is None:
                await send(message)

        await super().__call__(scope, receive, watched)
        if refused is not None:
            kind = "range-not-satisfiable" if status == 416 else "bad-request"
            problem = answer(
                kind, "Range: the file has no such bytes", path=scope["path"], headers=refused
            )
            await problem(scope, receive, send)


def tag_of(text: str) -> str:
    """Return an entity tag."""
    return f'"{hashlib.sha256(text.encode()).hexdigest()[:24]}"'


def matches(wanted: str | None, tag: str) -> bool:
    """Tell whether an If-None-Match header names the tag."""
    if wanted is None:
        return False
    tags = [item.strip().removeprefix("W/") for item in wanted.split(",")]
    return tag in tags or "*" in tags


def unchanged(tag: str) -> Response:
    """Return the answer that nothing is new."""
    return Response(status_code=304, headers={"ETag": tag})


def send_file(path: Path, if_none_match: str | None, media_type: str) -> Response:
    """Return a file, or that it is the one the client has."""
    status = path.stat()
    tag = tag_of(f"{path}-{status.st_mtime_ns}-{status.st_size}")
    if matches(if_none_match, tag):
        return unchanged(tag)
    return RangedFile(
        path,
        media_type=media_type,
        headers={"ETag": tag, "Cache-Control": "private, no-cache"},
        stat_result=status,
    )
