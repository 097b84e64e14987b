"""Who may publish into which stream, and who may watch it: zenoh's access control. Pure.

A file of YAML or JSON has an entry for each name: a user of the password file, or ``CN=`` and
the common name of a certificate; whoever is not named may do nothing.

::

    ann:         {publish: [stage]}
    CN=camera-1: {publish: [stage, hall]}
    screen:      {watch: ["*"]}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.errors import ConfigurationError
from service.bus import keys

CERTIFICATE = "CN="
"""Before the common name of a certificate."""

EVERY = "*"
"""Stands for every stream."""

TALK = ("put", "delete", "declare_subscriber", "query", "reply", "declare_queryable",
        "liveliness_token", "liveliness_query", "declare_liveliness_subscriber")  # fmt: skip
"""Every kind of message that zenoh knows rules for."""


@dataclass(frozen=True, kw_only=True)
class Rights:
    """What one name may do."""

    who: str
    publish: tuple[str, ...] = ()
    """Streams, or ``*``."""
    watch: tuple[str, ...] = ()


def parse_rights(content: object) -> tuple[Rights, ...]:
    """Return the rights that a file states.

    Raises
    ------
    ConfigurationError

    Examples
    --------
    >>> parse_rights({"ann": {"publish": ["stage"]}})
    (Rights(who='ann', publish=('stage',), watch=()),)
    """
    if not isinstance(content, Mapping):
        raise ConfigurationError("must hold rights by name")
    found = []
    for who, said in content.items():
        if not isinstance(who, str) or not who.removeprefix(CERTIFICATE):
            raise ConfigurationError(f"{who!r} is no name")
        if not isinstance(said, Mapping) or not set(said) <= {"publish", "watch"}:
            raise ConfigurationError(f"{who}: may have 'publish' and 'watch'")
        streams = {}
        for right, names in said.items():
            if not isinstance(names, list) or not all(_is_stream(name) for name in names):
                raise ConfigurationError(f"{who}: {right}: must be a list of streams")
            streams[right] = tuple(names)
        found.append(Rights(who=who, **streams))
    return tuple(found)


def _is_stream(name: object) -> bool:
    return isinstance(name, str) and (name == EVERY or keys.is_stream(name))


def access_control(rights: Sequence[Rights], trusted: Mapping[str, Sequence[str]]) -> Any:
    """Return zenoh's ``access_control``: everything else is refused.

    Parameters
    ----------
    rights : sequence of Rights
    trusted : mapping
        Fields of the subject that may do everything: the service's own workers.
    """
    rules = [_rule("everything", TALK, ("ingress", "egress"), ("**", keys.SERVICE))]
    subjects: list[dict[str, Any]] = [{"id": "workers", **trusted}]
    policies = [{"rules": ["everything"], "subjects": ["workers"]}]
    for number, item in enumerate(rights):
        name = f"name-{number}"
        kind = "cert_common_names" if item.who.startswith(CERTIFICATE) else "usernames"
        subjects.append({"id": name, kind: [item.who.removeprefix(CERTIFICATE)]})
        made = [*_of_sources(name, item.publish), *_of_watchers(name, item.publish + item.watch)]
        rules += made
        policies.append({"rules": [rule["id"] for rule in made], "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _of_sources(name: str, streams: Sequence[str]) -> list[dict[str, Any]]:
    if not streams:
        return []
    said = [f"{keys.ROOT}/{stream}/in/**" for stream in streams]
    asked = [*said, keys.MANIFESTS]
    return [
        _rule(f"{name}-puts", ("put", "declare_queryable", "reply"), ("ingress",), said),
        _rule(f"{name}-is-asked", ("query", "declare_subscriber"), ("egress",), asked),
    ]


def _of_watchers(name: str, streams: Sequence[str]) -> list[dict[str, Any]]:
    """Who publishes into a stream may watch it too: it has to know how it goes."""
    if not streams:
        return []
    ends = ("out/**", "status", "info", "history", "alive")
    heard = [f"{keys.ROOT}/{stream}/{end}" for stream in streams for end in ends]
    heard.append(keys.SERVICE)
    asks = ("declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query")
    gets = ("put", "reply", "declare_queryable", "liveliness_token")
    return [
        _rule(f"{name}-listens", asks, ("ingress",), heard),
        _rule(f"{name}-hears", gets, ("egress",), heard),
    ]


def _rule(
    name: str, messages: Sequence[str], flows: Sequence[str], key_exprs: Sequence[str]
) -> dict[str, Any]:
    return {
        "id": name,
        "messages": list(messages),
        "flows": list(flows),
        "permission": "allow",
        "key_exprs": list(key_exprs),
    }
