"""Where the stimuli of a plan may lie: under an allowed root, links resolved."""

from __future__ import annotations

from pathlib import Path

from dscqs.errors import PlanError
from service.config import ServiceConfig


def folder_of(config: ServiceConfig, folder: str) -> Path:
    """Return the folder that a plan names, absolute or relative to a root.

    Raises
    ------
    PlanError
        If it is not under an allowed root.
    """
    for root in config.roots:
        try:
            path = (root / folder).resolve()
            if path.is_relative_to(root.resolve()) and path.is_dir():
                return path
        except (OSError, ValueError):
            continue
    raise PlanError(f"folder: no {folder!r} lies under an allowed root (--roots)")
