"""Every problem that clients may meet, in one table; loads nothing, for workers name them too."""

from __future__ import annotations

import errno
from dataclasses import dataclass
from typing import Any

DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
"""Numbers of an :class:`OSError` that mean ``disk-full``."""


@dataclass(frozen=True)
class Kind:
    """One kind of problem."""

    status: int
    title: str


KINDS = {
    "bad-request": Kind(400, "The request cannot be understood"),
    "unauthorized": Kind(401, "A bearer token is needed"),
    "forbidden": Kind(403, "The token does not allow this"),
    "not-found": Kind(404, "There is no such thing"),
    "method-not-allowed": Kind(405, "The resource does not know this method"),
    "too-slow": Kind(408, "The body did not come in time"),
    "conflict": Kind(409, "The state does not allow this"),
    "in-progress": Kind(409, "The same request is being worked on"),
    "gone": Kind(410, "The thing is no more"),
    "precondition-failed": Kind(412, "A needed header is missing or has another value"),
    "too-large": Kind(413, "The body is larger than allowed"),
    "unsupported-media-type": Kind(415, "The body has a type that is not read here"),
    "range-not-satisfiable": Kind(416, "The file has no such bytes"),
    "invalid": Kind(422, "The request says something that cannot be done"),
    "configuration-error": Kind(422, "A setting is out of range, or contradicts another"),
    "scene-error": Kind(422, "The scene cannot be read"),
    "key-reused": Kind(422, "The idempotency key belongs to another request"),
    "too-many": Kind(429, "Too many unfinished jobs, or streams"),
    "internal": Kind(500, "The service has a fault"),
    "output-error": Kind(507, "The result cannot be written"),
    "disk-full": Kind(507, "No space is left for this"),
    "worker-lost": Kind(500, "The worker died or hung at every attempt"),
    "cluster-error": Kind(503, "The cluster cannot compute this now"),
    "memory-limit": Kind(507, "The job needs more memory than a worker may have"),
    "unavailable": Kind(503, "The service cannot do this now"),
}
"""By the last part of the problem's ``type``."""


def problem(kind: str, detail: str, **more: Any) -> dict[str, Any]:
    """Return the members of a problem of a kind of the table."""
    known = KINDS.get(kind, KINDS["internal"])
    return {
        "type": f"urn:depthsr:problem:{kind}",
        "title": known.title,
        "status": known.status,
        "detail": detail,
        **more,
    }
