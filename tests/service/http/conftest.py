"""What tests of the HTTP doors share."""

from __future__ import annotations

import httpx
import pytest

from tests.support.waiting import PATIENCE


@pytest.fixture(scope="module")
def api(live_service):
    """A client of the service that runs beside the tests."""
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as client:
        yield client
