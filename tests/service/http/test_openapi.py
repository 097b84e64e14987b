"""schemathesis over the whole description: no 5xx, nothing that is not declared."""

from __future__ import annotations

import hypothesis
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


@schemathesis.serializer("application/offset+octet-stream")
def _as_bytes(ctx, value):
    data = getattr(value, "data", value)
    return data if isinstance(data, bytes) else str(data).encode()


def test_every_answer_is_declared(make_service):
    service = make_service("--workers", "0")
    schema = schemathesis.openapi.from_url(f"{service.url}/api/openapi.json")
    tried = 0
    for found in schema.get_all_operations():
        operation = found.ok()

        @hypothesis.settings(max_examples=8, suppress_health_check=[*hypothesis.HealthCheck])
        @hypothesis.given(case=operation.as_strategy())
        def ask(case):
            case.call_and_validate(checks=CHECKS)

        ask()
        tried += 1
    assert tried > 15


def test_every_operation_says_what_it_does(tmp_path):
    description = create_app(ServiceConfig(data=tmp_path / "data")).openapi()
    for where, methods in description["paths"].items():
        for method, operation in methods.items():
            assert operation["description"], (method, where)
            if where.startswith("/api/v1/jobs"):
                assert "401" in operation["responses"]
    assert description["components"]["schemas"]["JobRequest"]["examples"]
