"""What can go wrong in the pipeline, as one tree.

::

    PipelineError
    ├── SceneError          the input is not what it says it is
    ├── ConfigurationError  a setting is out of range or contradicts another
    ├── OutputError         the result cannot be written
    ├── ClusterError        the machines that compute cannot be used
    └── Interrupted         somebody asked the work to stop

The default message of an error is its own docstring, so that each class has
to be explained to exist. Every class carries a stable ``code`` for machines
and the ``exit_status`` of the command line. An unlucky patch or view is *not*
an error: it is a value with a reason (see ``verification``).
"""

from __future__ import annotations

from typing import ClassVar


class PipelineError(Exception):
    """The super-resolution pipeline cannot go on."""

    code: ClassVar[str] = "pipeline-error"
    exit_status: ClassVar[int] = 1

    def __init__(self, message: str | None = None) -> None:
        super().__init__(message or self.__class__.__doc__)


class SceneError(PipelineError):
    """The scene cannot be read; the message names file, view and frame where known."""

    code = "scene-error"
    exit_status = 2

    def __init__(
        self,
        message: str | None = None,
        *,
        path: object = None,
        view: str | None = None,
        frame: int | None = None,
    ) -> None:
        where = [
            text
            for text in (
                f"{path}" if path is not None else "",
                f"view {view!r}" if view is not None else "",
                f"frame {frame}" if frame is not None else "",
            )
            if text
        ]
        said = message or str(self.__class__.__doc__)
        super().__init__(f"{', '.join(where)}: {said}" if where else said)


class ConfigurationError(PipelineError):
    """A setting is out of range, or contradicts another; the message names it."""

    code = "configuration-error"
    exit_status = 2


class OutputError(PipelineError):
    """The output cannot be written; the message names the path and what to do."""

    code = "output-error"
    exit_status = 2


class ClusterError(PipelineError):
    """The machines that compute cannot be used; the message names them and what to do."""

    code = "cluster-error"


class Interrupted(PipelineError):
    """The work was asked to stop; what was finished is kept."""

    code = "interrupted"
    exit_status = 130
