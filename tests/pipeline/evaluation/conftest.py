from __future__ import annotations

import pytest

from pipeline.config import Settings
from pipeline.evaluation.subjects import Subject
from pipeline.synthetic import SampleScene


@pytest.fixture(scope="session")
def subject() -> Subject:
    """The rendered scene, small: three views of 128×96."""
    return Subject(
        name="sample", frame=None, sample=SampleScene(width=128, height=96, num_views=3),
        settings=Settings(),
    )  # fmt: skip


@pytest.fixture
def browser_page(chromium):
    """A page of a real browser, and the list of what went wrong on it."""
    page = chromium.new_page(viewport={"width": 1280, "height": 900})
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on(
        "console",
        lambda said: troubles.append(said.text) if said.type == "error" else None,
    )
    yield page, troubles
    page.close()
