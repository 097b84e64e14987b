"""The pages: static files under a policy that lets in nothing foreign; data comes by the API."""

from __future__ import annotations

import mimetypes
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Header, Response
from fastapi import Path as InPath

from service import pages
from service.http.files import send_file
from service.http.problems import ProblemError, responses

router = APIRouter(include_in_schema=False)

FOLDER = Path(pages.__file__).parent

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob:; media-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; frame-ancestors 'none'; form-action 'none'",
    "Permissions-Policy": "fullscreen=(self), camera=(), microphone=(), geolocation=()",
}

MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}

PAGES = {
    "/": "dashboard.html",
    "/login": "login.html",
    "/jobs/{name}": "job.html",
    "/watch/jobs/{name}": "watch.html",
    "/watch/streams/{name}": "watch.html",
    "/api/docs": "api.html",
}
"""Which file is behind which address; the name is read by the page's own script."""

Tag = Annotated[str | None, Header()]


def _page(file: str) -> object:
    def show(if_none_match: Tag = None, name: str = "") -> Response:
        return _sent(FOLDER / file, if_none_match)

    return show


for _address, _file in PAGES.items():
    router.add_api_route(_address, _page(_file), methods=["GET", "HEAD"])  # type: ignore[arg-type]


@router.api_route("/static/{name:path}", methods=["GET", "HEAD"], responses=responses(404))
def static(name: Annotated[str, InPath(max_length=200)], if_none_match: Tag = None) -> Response:
    """Return what belongs to a page."""
    try:
        path = (FOLDER / name).resolve()
        known = path.is_relative_to(FOLDER.resolve()) and path.is_file()
    except (OSError, ValueError):
        known = False
    if not known or path.suffix not in MEDIA_TYPES:
        raise ProblemError("not-found", "there is no such file")
    return _sent(path, if_none_match)


@router.api_route("/favicon.ico", methods=["GET", "HEAD"])
def favicon(if_none_match: Tag = None) -> Response:
    """Return the sign of the house to browsers that ask by habit."""
    return _sent(FOLDER / "icon.svg", if_none_match)


def _sent(path: Path, if_none_match: str | None) -> Response:
    kind = MEDIA_TYPES.get(path.suffix) or mimetypes.guess_type(path.name)[0]
    answer = send_file(path, if_none_match, kind or "application/octet-stream")
    answer.headers.update(HEADERS)
    return answer
