"""A client of subjective tests, for operators."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpx

from dscqs.errors import DscqsError

API = "/dscqs/api"


class DscqsClientError(DscqsError):
    """The service refused; the message is the service's."""

    def __init__(self, status: int, code: str, message: str) -> None:
        super().__init__(message)
        self.status = status
        self.code = code  # type: ignore[misc]  # that of the service's error


def ask(http: httpx.Client, method: str, path: str, json: Any = None) -> httpx.Response:
    """Send a request and return the answer.

    Raises
    ------
    DscqsClientError
        If the service refuses.
    """
    try:
        answer = http.request(method, path, json=json, follow_redirects=False)
    except httpx.TransportError as error:
        raise DscqsClientError(503, "unavailable", f"{http.base_url}: {error}") from error
    if answer.status_code >= 400:
        try:
            said = answer.json()
        except ValueError:
            said = {}
        message = said.get("message") or said.get("detail") or f"status {answer.status_code}"
        raise DscqsClientError(answer.status_code, said.get("code", ""), message)
    return answer


def entry(link: str, browser: str) -> dict[str, str]:
    """Return what the page behind a link sends to let its browser in."""
    return {"link": link.partition("#")[2], "browser": browser}


@dataclass(kw_only=True)
class OperatorClient:
    """Makes tests and watches over them; ``http`` sends the operator's token."""

    http: httpx.Client

    def login(self, token: str) -> None:
        """Get the operator's cookie."""
        ask(self.http, "POST", f"{API}/operator/login", {"token": token})

    def make_test(self, plan: Mapping[str, Any]) -> str:
        """Make a test of a plan; return its id."""
        made = ask(self.http, "POST", f"{API}/operator/tests", dict(plan)).json()
        return str(made["test"])

    def invite(self, test: str, assessor: str, display: str, language: str = "en") -> str:
        """Return a link into the session of an assessor."""
        asked = {"assessor": assessor, "display": display, "language": language}
        answer = ask(self.http, "POST", f"{API}/operator/tests/{test}/links", asked)
        return str(answer.json()["link"])

    def invite_group(
        self, test: str, assessors: Sequence[str], display: str, language: str = "en"
    ) -> tuple[str, dict[str, str]]:
        """Return the link of a screen, and those of the telephones before it."""
        asked = {"assessors": list(assessors), "display": display, "language": language}
        made = ask(self.http, "POST", f"{API}/operator/tests/{test}/groups", asked).json()
        return str(made["screen"]), dict(made["phones"])

    def progress(self, test: str) -> list[dict[str, Any]]:
        """Return where the sessions stand."""
        return list(ask(self.http, "GET", f"{API}/operator/tests/{test}/progress").json())

    def act(self, test: str, session: str, action: str) -> None:
        """Pause, resume, withdraw or erase."""
        ask(self.http, "POST", f"{API}/operator/tests/{test}/sessions/{session}/{action}")

    def votes_csv(self, test: str) -> str:
        """Return the votes as tidy CSV."""
        return ask(self.http, "GET", f"{API}/operator/tests/{test}/export?format=csv").text

    def document(self, test: str) -> dict[str, Any]:
        """Return everything that was recorded."""
        answer = ask(self.http, "GET", f"{API}/operator/tests/{test}/export?format=json")
        return dict(answer.json())


@contextmanager
def operator_client(server: str, token: str | None) -> Iterator[OperatorClient]:
    """Give an operator's client that is logged in."""
    with httpx.Client(base_url=server, timeout=60) as http:
        client = OperatorClient(http=http)
        client.login(token or "")
        yield client
