"""What can go wrong in a subjective test, as one tree.

::

    DscqsError
    ├── PlanError      the plan contradicts itself or lacks something
    ├── OrderError     a request does not fit the present step of the session
    ├── NotFound       there is no such test, session or stimulus
    └── UsedUp         a link or address that works once was used before
"""

from __future__ import annotations

from typing import ClassVar


class DscqsError(Exception):
    """The subjective test cannot go on."""

    code: ClassVar[str] = "dscqs-error"
    exit_status: ClassVar[int] = 1

    def __init__(self, message: str | None = None) -> None:
        super().__init__(message or self.__class__.__doc__)


class PlanError(DscqsError):
    """The plan contradicts itself or lacks something; the message names the field."""

    code = "plan-error"
    exit_status = 2


class OrderError(DscqsError):
    """The request does not fit the present step of the session; nothing was changed."""

    code = "out-of-order"


class NotFound(DscqsError):
    """There is no such test, session or stimulus."""

    code = "not-found"


class UsedUp(DscqsError):
    """A link or address that works once was used before."""

    code = "used-up"
