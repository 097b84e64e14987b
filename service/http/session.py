"""A cookie for browsers, whose pictures and videos cannot send a bearer token."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict

from service.http.auth import COOKIE, Client, identify, require
from service.http.files import add_heads
from service.http.problems import responses

router = APIRouter(prefix="/api/v1/session", tags=["session"])


class Session(BaseModel):
    """Who asks, and what they may do."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"name": "ann", "scopes": ["read", "submit"]}]}
    )

    name: str
    scopes: list[str]


@router.get("")
def show(client: Annotated[Client, require("read")]) -> Session:
    """Tell who asks."""
    return Session(name=client.name, scopes=sorted(client.scopes))


@router.post("", responses=responses(401))
def begin(request: Request, response: Response) -> Session:
    """Turn the bearer token into a cookie that scripts cannot read."""
    client = identify(request)
    token = request.headers.get("authorization", "").partition(" ")[2].strip()
    if token and request.app.state.tokens.are_needed:
        response.set_cookie(
            COOKIE, token, httponly=True, samesite="strict", secure=request.url.scheme == "https",
        )  # fmt: skip
    return Session(name=client.name, scopes=sorted(client.scopes))


@router.delete("", status_code=204)
def end(response: Response) -> None:
    """Forget the cookie."""
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")


add_heads(router)
