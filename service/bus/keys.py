"""Every key expression of the bus, built and parsed here and nowhere else. Pure.

::

    depthsr/<stream>/in/manifest            what the source is
    depthsr/<stream>/in/<view>/color        one picture
    depthsr/<stream>/in/<view>/depth        one depth map
    depthsr/<stream>/out/sbs                H.264 access units, both eyes side by side
    depthsr/<stream>/out/sbs/jpeg           the same as JPEG
    depthsr/<stream>/out/left, …/right      one eye as JPEG
    depthsr/<stream>/status                 how it goes
    depthsr/<stream>/info                   what it is (to be asked for)
    depthsr/<stream>/history                its last frames (to be asked for)
    depthsr/<stream>/alive                  liveliness token of the stream's worker
    depthsr/@service                        liveliness token of the service; its streams
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

ROOT = "depthsr"
SERVICE = f"{ROOT}/@service"
"""The ``@`` keeps it out of what ``*`` matches."""

STREAM_ID = r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}"
"""Pattern of a stream's name."""

MANIFESTS = f"{ROOT}/*/in/manifest"
STATUSES = f"{ROOT}/*/status"
"""Selects the manifests of all streams."""

_VIEW = re.compile(r"[^\x00-\x1f\x7f*$?#/]{1,64}")
_STREAM = re.compile(STREAM_ID)


class Part(StrEnum):
    """The two things that a view sends."""

    COLOR = "color"
    DEPTH = "depth"


class Output(StrEnum):
    """The pictures that a stream gives."""

    SBS = "sbs"
    SBS_JPEG = "sbs/jpeg"
    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, kw_only=True)
class InputKey:
    """What a key below ``in`` names."""

    stream: str
    view: str
    part: Part


def is_stream(name: str) -> bool:
    """Tell whether a stream may be called that.

    >>> is_stream("stage-1"), is_stream("a/b"), is_stream("*"), is_stream("")
    (True, False, False, False)
    """
    return _STREAM.fullmatch(name) is not None


def is_view(name: str) -> bool:
    """Tell whether a view's id can stand in a key."""
    return _VIEW.fullmatch(name) is not None and not name.startswith("@")


def manifest(stream: str) -> str:
    """Return the key of a stream's manifest."""
    return f"{ROOT}/{_checked(stream)}/in/manifest"


def inputs(stream: str) -> str:
    """Return the expression that selects all pictures and depth maps of a stream."""
    return f"{ROOT}/{_checked(stream)}/in/*/*"


def input_key(stream: str, view: str, part: Part) -> str:
    """Return the key of a view's pictures or depth maps."""
    if not is_view(view):
        raise ValueError(f"view id {view!r} cannot stand in a key")
    return f"{ROOT}/{_checked(stream)}/in/{view}/{part}"


def output(stream: str, which: Output) -> str:
    """Return the key of one of a stream's outputs."""
    return f"{ROOT}/{_checked(stream)}/out/{which}"


def status(stream: str) -> str:
    """Return the key of a stream's status."""
    return f"{ROOT}/{_checked(stream)}/status"


def info(stream: str) -> str:
    """Return the key of a stream's description."""
    return f"{ROOT}/{_checked(stream)}/info"


def history(stream: str) -> str:
    """Return the key of the account of a stream's last frames."""
    return f"{ROOT}/{_checked(stream)}/history"


def alive(stream: str) -> str:
    """Return the key of a stream's liveliness token."""
    return f"{ROOT}/{_checked(stream)}/alive"


def parse_manifest(key: str) -> str | None:
    """Return the stream whose manifest the key names; None where it names none.

    >>> parse_manifest("depthsr/stage/in/manifest"), parse_manifest("depthsr/a b/in/manifest")
    ('stage', None)
    """
    parts = key.split("/")
    if len(parts) != 4 or parts[0] != ROOT or parts[2:] != ["in", "manifest"]:
        return None
    return parts[1] if is_stream(parts[1]) else None


def parse_input(key: str) -> InputKey | None:
    """Return what a key below ``in`` names; None where it is none of ours.

    >>> parse_input("depthsr/stage/in/cam0/depth")
    InputKey(stream='stage', view='cam0', part=<Part.DEPTH: 'depth'>)
    """
    chunks = key.split("/")
    if len(chunks) != 5 or chunks[0] != ROOT or chunks[2] != "in" or not is_stream(chunks[1]):
        return None
    if not is_view(chunks[3]) or chunks[4] not in list(Part):
        return None
    return InputKey(stream=chunks[1], view=chunks[3], part=Part(chunks[4]))


def matches(expression: str, key: str) -> bool:
    """Tell whether a key expression selects a key (``*``: one chunk, ``**``: any number).

    Chunks that begin with ``@`` are selected by themselves only.

    >>> matches("depthsr/*/in/manifest", "depthsr/a/in/manifest"), matches("a/**", "a/@b")
    (True, False)
    """
    return _match(expression.split("/"), key.split("/"))


def _match(expression: list[str], key: list[str]) -> bool:
    if not expression:
        return not key
    head, rest = expression[0], expression[1:]
    if head == "**":
        if _match(rest, key):
            return True
        return bool(key) and not key[0].startswith("@") and _match(expression, key[1:])
    if not key:
        return False
    hit = head == key[0] or (head == "*" and not key[0].startswith("@"))
    return hit and _match(rest, key[1:])


def _checked(stream: str) -> str:
    if not is_stream(stream):
        raise ValueError(
            f"a stream cannot be called {stream!r}: up to 64 of A-Z a-z 0-9 . _ -, "
            "a letter or digit first"
        )
    return stream
