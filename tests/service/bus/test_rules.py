"""Who may publish and watch what, with real sessions of zenoh."""

from __future__ import annotations

import pytest

from pipeline.errors import ConfigurationError
from service.bus import keys
from service.bus.bus import JSON, Answer
from service.bus.config import BusConfig
from service.bus.keys import Output, Part
from service.bus.rules import access_control, parse_rights
from service.bus.zenoh_bus import ZenohBus
from service.config import ServiceConfig
from tests.service.streams.conftest import free_endpoint
from tests.support.waiting import until

NAMES = ("camera", "screen", "wall", "stranger", "worker")
RIGHTS = {
    "camera": {"publish": ["stage"]}, "screen": {"watch": ["stage"]}, "wall": {"watch": ["*"]},
}  # fmt: skip
COLOR = keys.input_key("stage", "cam0", Part.COLOR)
SBS = keys.output("stage", Output.SBS)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    """A router that knows everybody, and a session of each; of "service" the router's own."""
    users = tmp_path_factory.mktemp("rules") / "users"
    users.write_text("".join(f"{name}:secret of {name}\n" for name in NAMES))
    endpoint = free_endpoint()
    made = {
        "service": ZenohBus(
            BusConfig(
                mode="router", listen=(endpoint,), users_file=users, rights=parse_rights(RIGHTS),
                workers_user="worker",
            )
        )
    }  # fmt: skip
    for name in NAMES:
        made[name] = ZenohBus(
            BusConfig(connect=(endpoint,), user=name, password=f"secret of {name}")
        )
    yield made
    for bus in reversed(made.values()):
        bus.close()


def test_each_is_heard_where_it_may_speak_and_hears_what_it_may(sessions):
    heard = []

    def listen(name, expression):
        sessions[name].subscribe(expression, lambda s: heard.append((name, s.key, s.read())))

    for name in NAMES[1:]:
        listen(name, SBS)
    for name in ("screen", "stranger", "worker"):
        listen(name, keys.inputs("stage"))
    listen("screen", keys.output("hall", Output.SBS))
    listen("wall", keys.output("hall", Output.SBS))
    listen("service", keys.MANIFESTS)
    sessions["worker"].answer(SBS, lambda question: [Answer(key=SBS, payload=b"a", encoding=JSON)])
    until(lambda: len(sessions["screen"].ask(SBS)) == 1)

    def say(name, key):
        sessions[name].put(key, name.encode(), encoding=JSON)

    def say_all():
        for name in ("screen", "stranger", "camera"):
            say(name, COLOR)
            say(name, keys.manifest("stage"))
        say("camera", keys.manifest("hall"))
        for name in ("camera", "stranger", "worker"):
            say(name, SBS)
        say("worker", keys.output("hall", Output.SBS))

    expected = {
        ("worker", COLOR, b"camera"),
        ("service", keys.manifest("stage"), b"camera"),
        ("screen", SBS, b"worker"),
        ("wall", SBS, b"worker"),
        ("wall", keys.output("hall", Output.SBS), b"worker"),
    }

    def others():
        """What came from another session than one's own: zenoh hands a put to its own at once."""
        return {item for item in heard if item[0].encode() != item[2]}

    def all_is_heard():
        """Said again and again: a router that is held up knows late who listens, and drops."""
        say_all()
        return expected <= others()

    until(all_is_heard)
    assert others() == expected
    until(lambda: len(sessions["wall"].ask(SBS)) == 1)
    assert list(sessions["stranger"].ask(SBS, timeout=1)) == []


def test_a_source_is_asked_for_its_manifest(sessions):
    key = keys.manifest("stage")
    sessions["camera"].answer(key, lambda q: [Answer(key=key, payload=b"m", encoding=JSON)])
    (answer,) = until(lambda: sessions["service"].ask(keys.MANIFESTS))
    assert answer.read() == b"m"


def test_who_lives_is_for_those_who_watch(sessions):
    sessions["worker"].live(keys.alive("stage"))
    until(lambda: sessions["screen"].who_lives(keys.alive("stage")))
    assert list(sessions["stranger"].who_lives(keys.alive("stage"), timeout=1)) == []


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (["ann"], "by name"),
        ({"": {}}, "no name"),
        ({"CN=": {}}, "no name"),
        ({"ann": {"read": ["stage"]}}, "'publish' and 'watch'"),
        ({"ann": {"watch": "stage"}}, "list of streams"),
        ({"ann": {"watch": ["a/b"]}}, "list of streams"),
    ],
)
def test_what_is_wrong_in_a_file_is_said(content, says):
    with pytest.raises(ConfigurationError, match=says):
        parse_rights(content)


def test_a_certificate_is_known_by_its_name():
    made = access_control(parse_rights({"CN=camera": {"publish": ["stage"]}}), {})
    assert made["subjects"][1]["cert_common_names"] == ["camera"]
    assert made["default_permission"] == "deny"


def test_rights_without_names_are_refused(tmp_path):
    (tmp_path / "rights.yaml").write_text("ann: {watch: [stage]}\n")
    with pytest.raises(ConfigurationError, match="need names"):
        ServiceConfig(zenoh_rights=tmp_path / "rights.yaml")
