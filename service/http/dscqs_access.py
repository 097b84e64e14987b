"""Operators of subjective tests: a token once, then a cookie that outlives a restart.

Where the service has a token file, tokens of the scope ``assess`` log in. Without one there is a
token all the same, in ``operator.token`` of the data folder: whoever reaches the service may
send jobs then, but assessors who reach it must not read a test.
"""

from __future__ import annotations

import hmac
import secrets
import time
from pathlib import Path
from typing import Annotated

from fastapi import Depends, Request

from service.http.auth import Tokens
from service.http.problems import ProblemError

COOKIE = "dscqs_operator"
COOKIE_SECONDS = 12 * 3600
SCOPE = "assess"
TOKEN_FILE = "operator.token"


class Operators:
    """Who may operate tests.

    Parameters
    ----------
    tokens : Tokens
        Of the service.
    data : Path
        The data folder; ``operator.token`` is made in it where the service has no tokens.
    key : bytes
        Signs the cookies.
    """

    def __init__(self, tokens: Tokens, data: Path, key: bytes) -> None:
        self._tokens = tokens
        self._key = key
        self._own = None if tokens.are_needed else _own_token(data / TOKEN_FILE)

    def name_of(self, token: str) -> str | None:
        """Return whose token it is, if it may operate tests."""
        if self._own is not None:
            return "operator" if hmac.compare_digest(token.encode(), self._own.encode()) else None
        client = self._tokens.client_of(token)
        return client.name if client is not None and SCOPE in client.scopes else None

    def cookie(self, name: str) -> str:
        """Return a cookie for an operator."""
        said = f"{name}.{int(time.time()) + COOKIE_SECONDS}"
        return f"{said}.{self._mac(said)}"

    def of_cookie(self, cookie: str) -> str | None:
        """Return whose cookie it is, if it is still good."""
        said, _, mac = cookie.rpartition(".")
        name, _, expires = said.rpartition(".")
        if not hmac.compare_digest(mac.encode(), self._mac(said).encode()):
            return None
        return name if int(expires) > time.time() else None

    def _mac(self, said: str) -> str:
        return hmac.new(self._key, f"operator\n{said}".encode(), "sha256").hexdigest()


def operator(request: Request) -> str:
    """Return the name of the operator who asks.

    Raises
    ------
    ProblemError
        ``unauthorized``.
    """
    operators: Operators = request.app.state.operators
    kind, _, token = request.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        name = operators.name_of(token.strip())
    else:
        name = operators.of_cookie(request.cookies.get(COOKIE, ""))
    if name is None:
        raise ProblemError("unauthorized", "log in as an operator")
    return name


Operating = Annotated[str, Depends(operator)]


def _own_token(path: Path) -> str:
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    try:
        token = path.read_text(encoding="ascii").strip()
    except FileNotFoundError:
        token = ""
    if len(token) < 32:
        token = secrets.token_hex(32)
        path.touch(mode=0o600)
        path.write_text(token + "\n", encoding="ascii")
    return token
