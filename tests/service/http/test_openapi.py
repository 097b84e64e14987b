"""schemathesis over the whole description: no 5xx, nothing that is not declared."""

from __future__ import annotations

import hypothesis
import jsonschema_rs
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
from service.http.dscqs_pages import FOLDER, media_type_of

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


@pytest.fixture(scope="module")
def description(tmp_path_factory):
    return create_app(ServiceConfig(data=tmp_path_factory.mktemp("app") / "data")).openapi()


def test_every_operation_says_what_it_does(description):
    for where, methods in description["paths"].items():
        for method, operation in methods.items():
            assert operation["description"], (method, where)
            if where.startswith("/api/v1/jobs"):
                assert "401" in operation["responses"]
    assert description["components"]["schemas"]["JobRequest"]["examples"]


def _examples(item, schemas):
    """Return the examples of a parameter or of the content of a body."""
    schema = item.get("schema", {})
    schema = schemas.get(schema.get("$ref", "").rpartition("/")[2], schema)
    if schema.get("type") == "array":
        return [[found] for found in _examples({"schema": schema["items"]}, schemas)]
    named = [found["value"] for found in item.get("examples", {}).values()]
    alone = [item["example"]] if "example" in item else []
    given = [schema["default"]] if "default" in schema else []
    fields = [
        (name, found[0])
        for name, field in schema.get("properties", {}).items()
        if (found := _examples({"schema": field}, {}))
    ]
    whole = [dict(fields)] if fields and len(fields) == len(schema["properties"]) else []
    return named + alone + schema.get("examples", []) + schema.get("enum", []) + given + whole


def _parts(description):
    """Yield the name and the schema holder of each parameter, body and answer, bytes left out."""
    for where, methods in description["paths"].items():
        for method, operation in methods.items():
            for item in operation.get("parameters", []):
                yield f"{method} {where}: {item['name']}", item
            answers = [item for status, item in operation["responses"].items() if status < "3"]
            for holder in (operation.get("requestBody", {}), *answers):
                for kind, item in holder.get("content", {}).items():
                    if item.get("schema", {}).get("format") != "binary":
                        yield f"{method} {where}: {kind}", item


def test_everything_asked_for_or_answered_has_an_example_that_fits(description):
    schemas = description["components"]["schemas"]
    without, wrong = [], []
    for name, item in _parts(description):
        found = _examples(item, schemas)
        without += [] if found else [name]
        schema = {**item.get("schema", {}), "components": description["components"]}
        wrong += [name for example in found if not jsonschema_rs.is_valid(schema, example)]
    assert (without, wrong) == ([], [])


def test_every_format_that_can_be_asked_for_is_declared_with_an_example(description):
    """Text formats have an example of their own name, or a media type alone."""
    asked = 0
    for where, methods in description["paths"].items():
        for method, operation in methods.items():
            for item in operation.get("parameters", []):
                if item["name"] != "format":
                    continue
                content = operation["responses"]["200"]["content"]
                named = {name for held in content.values() for name in held.get("examples", {})}
                endings = {kind.rpartition("/")[2] for kind in content}
                assert set(item["schema"]["enum"]) <= named | endings, (method, where)
                asked += 1
    assert asked


def test_everything_a_page_of_subjective_tests_is_made_of_is_declared(description):
    operation = description["paths"]["/dscqs/pages/{name}"]["get"]
    files = [path for path in FOLDER.rglob("*") if path.is_file()]
    assert {media_type_of(path) for path in files} == set(operation["responses"]["200"]["content"])
