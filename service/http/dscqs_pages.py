"""The pages of subjective tests: static files, under a policy that lets in nothing foreign."""

from __future__ import annotations

import mimetypes
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Response
from fastapi import Path as InPath

import dscqs
from service.http.files import TAGGED, Known, send_file
from service.http.problems import ProblemError, responses

router = APIRouter(prefix="/dscqs", tags=["subjective tests: pages"])

FOLDER = Path(dscqs.__file__).parent / "page"

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; media-src 'self' blob:; connect-src 'self'; font-src 'self'; "
    "worker-src 'self'; base-uri 'none'; frame-ancestors 'none'; form-action 'none'",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Permissions-Policy": "fullscreen=(self), xr-spatial-tracking=(self), "
    "screen-wake-lock=(self), camera=(), microphone=(), geolocation=()",
}
"""Isolated from other origins, so that the page's clock is fine enough to time frames."""

MEDIA_TYPES = {".js": "text/javascript", ".mjs": "text/javascript", ".css": "text/css"}


def media_type_of(path: Path) -> str:
    """Return what a file is sent as."""
    guessed = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    return MEDIA_TYPES.get(path.suffix, guessed)


def _smallest() -> dict[str, Path]:
    """Return the smallest file of each media type."""
    files = sorted(filter(Path.is_file, FOLDER.rglob("*")), key=lambda path: -path.stat().st_size)
    return {media_type_of(path): path for path in files}


@router.get(
    "/pages/{name:path}",
    response_class=Response,
    responses={
        200: {
            **TAGGED,
            "content": {
                kind: {
                    "schema": {"type": "string"},
                    "example": path.read_text(encoding="utf-8"),
                }
                for kind, path in _smallest().items()
            },
        },
        304: {"description": "Unchanged"},
        **responses(404),
    },
)
def page(
    name: Annotated[str, InPath(max_length=200, examples=["enter.html"])],
    if_none_match: Known = None,
) -> Response:
    """Return a page, or what belongs to one."""
    try:
        path = (FOLDER / name).resolve()
        known = path.is_relative_to(FOLDER.resolve()) and path.is_file()
    except (OSError, ValueError):
        known = False
    if not known:
        raise ProblemError("not-found", "there is no such page")
    answer = send_file(path, if_none_match, media_type_of(path))
    answer.headers.update(HEADERS)
    return answer
