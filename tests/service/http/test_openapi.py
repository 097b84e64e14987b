"""schemathesis over the whole description: no 5xx, nothing that is not declared."""

from __future__ import annotations

import hypothesis
import pytest
import schemathesis
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from service.app import create_app
from service.config import ServiceConfig

CHECKS = [
    not_a_server_error, status_code_conformance, content_type_conformance,
    response_schema_conformance,
]  # fmt: skip


@pytest.fixture(scope="module")
def schema(tmp_path_factory):
    return load(tmp_path_factory.mktemp("openapi"))


def load(folder):
    app = create_app(ServiceConfig(data=folder / "data", workers=0))
    return schemathesis.openapi.from_asgi("/api/openapi.json", app)


lazy = schemathesis.pytest.from_fixture("schema")


@lazy.parametrize()
@hypothesis.settings(
    max_examples=15, deadline=None, suppress_health_check=list(hypothesis.HealthCheck)
)
def test_every_answer_is_declared(case):
    case.call_and_validate(checks=CHECKS)


def test_every_operation_says_what_it_does(tmp_path):
    description = create_app(ServiceConfig(data=tmp_path / "data")).openapi()
    for where, methods in description["paths"].items():
        for method, operation in methods.items():
            assert operation["description"], (method, where)
            if where.startswith("/api/v1/jobs"):
                assert "401" in operation["responses"]
    assert description["components"]["schemas"]["JobRequest"]["examples"]
