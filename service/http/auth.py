"""Who may do what: bearer tokens with scopes, a cookie or a signed address for media.

The token file has a line for each token: ``NAME SCOPE,SCOPE TOKEN``; lines that begin with
``#`` are remarks. Without a token file everybody who reaches the service may do everything,
which is why it listens on the loopback address unless told otherwise.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fastapi import Depends, Request, WebSocket
from fastapi.requests import HTTPConnection

from pipeline.errors import ConfigurationError
from service.http.problems import ProblemError

SCOPES = ("submit", "read", "operate", "assess")
COOKIE = "depthsr_token"
LINK_SECONDS = 3600
"""How long a signed address is good."""

MIN_TOKEN = 16
"""Shortest token that is taken, characters."""


@dataclass(frozen=True, kw_only=True)
class Client:
    """Somebody who uses the service."""

    name: str
    scopes: frozenset[str]

    @property
    def sees_all(self) -> bool:
        """True for who may see and change the jobs of others."""
        return "operate" in self.scopes


ANYBODY = Client(name="anybody", scopes=frozenset(SCOPES))


class Tokens:
    """The tokens of a file, and the key that signs addresses.

    Raises
    ------
    ConfigurationError
        If the file cannot be read or a line of it is wrong; no token is shown.
    """

    def __init__(self, file: Path | None, *, key: bytes | None = None) -> None:
        self.are_needed = file is not None
        self._key = key or secrets.token_bytes(32)
        self._clients = [] if file is None else _read(file)

    def client_of(self, token: str) -> Client | None:
        """Return whose token it is; takes the same time for every wrong token."""
        digest = hashlib.sha256(token.encode()).digest()
        found = None
        for known, client in self._clients:
            if hmac.compare_digest(digest, known):
                found = client
        return found

    def sign(self, path: str, client: str) -> str:
        """Return the path with a signature that lets anybody read it for a while."""
        if not self.are_needed:
            return quote(path)
        expires = int(time.time()) + LINK_SECONDS
        signature = self._mac(path, client, expires)
        return f"{quote(path)}?client={client}&expires={expires}&signature={signature}"

    def signed_client(self, path: str, query: Any) -> Client | None:
        """Return who signed the address, if it is still good."""
        name, expires, given = (query.get(key, "") for key in ("client", "expires", "signature"))
        if not given or not expires.isascii() or not expires.isdigit() or len(expires) > 12:
            return None
        good = hmac.compare_digest(self._mac(path, name, int(expires)).encode(), given.encode())
        if not good or int(expires) < time.time():
            return None
        return Client(name=name, scopes=frozenset({"read"}))

    def _mac(self, path: str, client: str, expires: int) -> str:
        text = f"{path}\n{client}\n{expires}"
        return hmac.new(self._key, text.encode(), "sha256").hexdigest()


def require(scope: str) -> Any:
    """Return a dependency that lets only clients with the scope pass, and names them."""

    def check(connection: HTTPConnection) -> Client:
        client = identify(connection)
        if scope not in client.scopes:
            raise ProblemError("forbidden", f"the token has no scope {scope}")
        return client

    return Depends(check)


def identify(connection: HTTPConnection | WebSocket | Request) -> Client:
    """Return who asks: by bearer token, cookie or (reading only) signed address."""
    tokens: Tokens = connection.app.state.tokens
    if not tokens.are_needed:
        return ANYBODY
    kind, _, token = connection.headers.get("authorization", "").partition(" ")
    if kind.lower() != "bearer":
        token = connection.cookies.get(COOKIE, "")
    client = tokens.client_of(token.strip()) if token else None
    if client is None and connection.scope.get("method", "GET") in ("GET", "HEAD"):
        client = tokens.signed_client(connection.url.path, connection.query_params)
    if client is None:
        raise ProblemError(
            "unauthorized",
            "send Authorization: Bearer TOKEN",
            headers={"WWW-Authenticate": "Bearer"},
        )
    return client


def _read(file: Path) -> list[tuple[bytes, Client]]:
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"--token-file: {file} cannot be read: {error}") from error
    found = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        scopes = frozenset(words[1].split(",")) if len(words) == 3 else frozenset()
        if not scopes or not scopes <= set(SCOPES) or len(words[2]) < MIN_TOKEN:
            raise ConfigurationError(
                f"{file}, line {number}: must be NAME SCOPE,SCOPE TOKEN with scopes of "
                f"{', '.join(SCOPES)} and a token of {MIN_TOKEN} or more characters"
            )
        client = Client(name=words[0], scopes=scopes)
        found.append((hashlib.sha256(words[2].encode()).digest(), client))
    return found
