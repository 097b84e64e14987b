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


@router.get(
    "/pages/{name:path}",
    response_class=Response,
    responses={
        200: {
            **TAGGED,
            "content": {
                "text/html": {
                    "schema": {"type": "string"},
                    "example": (FOLDER / "enter.html").read_text(encoding="utf-8"),
                }
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
    guessed = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    media_type = MEDIA_TYPES.get(path.suffix, guessed)
    answer = send_file(path, if_none_match, media_type)
    answer.headers.update(HEADERS)
    return answer
