from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.bus import keys
from service.bus.keys import InputKey, Output, Part

STREAMS = st.from_regex(keys.STREAM_ID, fullmatch=True)
VIEWS = st.text(min_size=1, max_size=64).filter(keys.is_view)


@given(stream=STREAMS, view=VIEWS, part=st.sampled_from(Part))
def test_a_built_key_is_parsed_back(stream, view, part):
    key = keys.input_key(stream, view, part)
    assert keys.parse_input(key) == InputKey(stream=stream, view=view, part=part)
    assert keys.matches(keys.inputs(stream), key)
    assert keys.parse_manifest(keys.manifest(stream)) == stream
    assert keys.matches(keys.MANIFESTS, keys.manifest(stream))


@given(key=st.text(max_size=80))
def test_what_is_no_key_of_ours_is_told_from_one(key):
    assert keys.parse_manifest(key) is None
    assert keys.parse_input(key) is None


@pytest.mark.parametrize("name", ["", "a/b", "*", "a b", "@x", "-x", "x" * 65, "ä", "a\n"])
def test_names_that_no_stream_may_have(name):
    assert not keys.is_stream(name)
    with pytest.raises(ValueError, match="cannot be called"):
        keys.manifest(name)


def test_outputs_of_one_stream_differ_and_lie_below_it():
    found = {keys.output("stage", which) for which in Output}
    found |= {keys.status("stage"), keys.info("stage"), keys.history("stage"), keys.alive("stage")}
    assert len(found) == len(Output) + 4
    assert all(keys.matches("depthsr/stage/**", key) for key in found)


@pytest.mark.parametrize(
    ("expression", "key", "expected"),
    [
        ("a/*/c", "a/b/c", True), ("a/*/c", "a/b/d", False), ("a/*", "a/b/c", False),
        ("a/**", "a", True), ("a/**/c", "a/x/y/c", True), ("**", "a/@b", False),
        ("a/@b", "a/@b", True), ("a/*", "a/@b", False),
    ],
)  # fmt: skip
def test_matching(expression, key, expected):
    assert keys.matches(expression, key) is expected
