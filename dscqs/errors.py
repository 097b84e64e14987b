"""What can go wrong in a subjective test, as one tree.

::

    DscqsError
    ├── PlanError      the plan contradicts itself or lacks something
    ├── DisplayError   a display's profile contradicts itself or lacks something
    ├── GradesError    grades are malformed, or not of what was asked
    ├── StimulusError  a stimulus is missing, damaged or unlike its partner
    │   └── StimulusLost  … after the test was made
    ├── NotLoggedIn    the request shows no cookie of a session
    ├── VotesError     votes cannot be read, or contradict one another
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


class DisplayError(DscqsError):
    """A display's profile contradicts itself or lacks something; the message names the field."""

    code = "display-error"
    exit_status = 2


class GradesError(DscqsError):
    """The grades are malformed, out of range, or not of what was asked; nothing was changed."""

    code = "grades-error"
    exit_status = 2


class StimulusError(DscqsError):
    """A stimulus is missing, damaged, or unlike the others of its content; the message names it."""

    code = "stimulus-error"
    exit_status = 2


class StimulusLost(StimulusError):
    """A stored stimulus cannot be read, or was changed after the test was made."""

    code = "stimulus-lost"
    exit_status = 1


class NotLoggedIn(DscqsError):
    """The request shows no cookie of a session; open a link of the operator."""

    code = "not-logged-in"


class VotesError(DscqsError):
    """The votes cannot be read; the message names file, line and column where known."""

    code = "votes-error"
    exit_status = 2

    def __init__(
        self,
        message: str | None = None,
        *,
        path: object = None,
        line: int | None = None,
        column: str | None = None,
    ) -> None:
        self.said = message or str(self.__class__.__doc__)
        self.column = column
        where = [
            *([f"{path}"] if path is not None else []),
            *([f"line {line}"] if line is not None else []),
            *([f"column {column!r}"] if column is not None else []),
        ]
        super().__init__(f"{', '.join(where)}: {self.said}" if where else self.said)

    def at(self, *, path: object, line: int | None = None) -> VotesError:
        """Return the same error with the place where it was found."""
        return VotesError(self.said, path=path, line=line, column=self.column)


class OrderError(DscqsError):
    """The request does not fit the present step of the session; nothing was changed."""

    code = "out-of-order"


class NotFound(DscqsError):
    """There is no such test, session or stimulus."""

    code = "not-found"


class UsedUp(DscqsError):
    """A link or address that works once was used before."""

    code = "used-up"
