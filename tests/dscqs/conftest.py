"""What the tests of subjective tests share: the folder of public raw scores."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.support.needed import absent


@pytest.fixture(scope="session")
def subjective_dir() -> Path:
    """Folder of public raw scores: DEPTHSR_SUBJECTIVE, or ``subjective`` beside DEPTHSR_SCENES.

    Without it: skipped; under CI=true: failed.
    """
    named = os.environ.get("DEPTHSR_SUBJECTIVE", "")
    scenes = os.environ.get("DEPTHSR_SCENES", "")
    place = Path(named) if named else Path(scenes).parent / "subjective" if scenes else None
    if place is not None and (place / "expected.json").is_file():
        return place
    reason = (
        f"{place}: no expected.json there"
        if place is not None
        else "neither DEPTHSR_SUBJECTIVE (public raw scores) nor DEPTHSR_SCENES is set"
    )
    absent(reason)
