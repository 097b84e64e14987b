"""What can be said of the containers without starting them."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
import yaml
from distributed.cli import dask_scheduler, dask_worker

from service.cli import make_parser
from service.config import load_config

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"


@pytest.fixture(scope="module")
def compose():
    return yaml.safe_load((DOCKER / "compose.yaml").read_text())


@pytest.fixture(scope="module")
def instructions():
    """The Dockerfile as (instruction, arguments), lines joined, comments left out."""
    text = (DOCKER / "Dockerfile").read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [tuple(line.split(maxsplit=1)) for line in lines]


def _resolved(value: str) -> str:
    """Return what compose makes of a value where no variable is set."""
    return re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", value)


def test_compose_is_hardened_and_stays_on_this_machine(compose):
    assert {"service", "zenoh", "scheduler", "worker"} <= set(compose["services"])
    for name, part in compose["services"].items():
        assert part["read_only"] is True, name
        assert part["cap_drop"] == ["ALL"], name
        assert "no-new-privileges:true" in part["security_opt"], name
        assert "privileged" not in part, name
        assert all(port.startswith("127.0.0.1:") for port in part.get("ports", ())), name
        for volume in part.get("volumes", ()):
            source = volume.partition(":")[0]
            assert source in compose["volumes"] or source.startswith("$"), name
        assert set(part.get("depends_on", ())) <= set(compose["services"]), name
        image = part["image"]
        assert image == "depthsr" or re.fullmatch(r"[\w/]+:\d+\.\d+\.\d+", image), name


@pytest.mark.parametrize("cluster", ["", "tcp://scheduler:8786"])
def test_the_service_understands_its_command_and_its_variables(compose, cluster):
    part = compose["services"]["service"]
    arguments = make_parser().parse_args(part["command"])
    assert arguments.host == "0.0.0.0"
    environment = {name: _resolved(value) for name, value in part["environment"].items()}
    assert environment["DEPTHSR_CLUSTER"] == ""
    loaded = load_config(environment={**environment, "DEPTHSR_CLUSTER": cluster})
    named = {name for name in environment if name.startswith("DEPTHSR_")}
    read = {origin.split()[1] for origin in loaded.origins.values() if " " in origin}
    assert read == named  # no variable that nobody reads
    assert loaded.config.cluster == (cluster or None)
    compile(part["healthcheck"]["test"][3], "healthcheck", "exec")


def test_dask_understands_its_commands(compose):
    for name, command in (("scheduler", dask_scheduler.main), ("worker", dask_worker.main)):
        program, what, *words = compose["services"][name]["entrypoint"]
        assert (program, what) == ("dask", name)
        command.make_context(name, words)
    workers = compose["services"]["worker"]["volumes"]
    assert workers == compose["services"]["service"]["volumes"]  # the same paths for all


def test_the_image_is_built_from_what_is_there_and_locked(instructions):
    kinds = [kind for kind, _ in instructions]
    assert kinds[0] == "FROM"
    assert re.search(r":\d+\.\d+", instructions[0][1])
    assert "ADD" not in kinds
    wanted = [
        line for line in (DOCKER / "Dockerfile.dockerignore").read_text().splitlines() if line
    ]
    assert wanted[0] == "*"
    for kind, text in instructions:
        if kind == "COPY":
            for source in shlex.split(text)[:-1]:
                assert (ROOT / source).exists(), source
                assert f"!{source.removeprefix('./')}" in wanted, source
        if kind == "RUN" and "pip install" in text:
            assert "--require-hashes" in text or "--no-deps" in text, text
        if kind == "RUN":
            assert "sudo" not in text
            assert "apt-get" not in text or "rm -rf /var/lib/apt/lists" in text
        if kind == "WORKDIR":
            assert text.startswith("/")


def test_the_image_runs_without_rights_and_with_its_kernels(instructions):
    kinds = [kind for kind, _ in instructions]
    last = dict(instructions)
    assert last["USER"] not in ("root", "0")
    assert kinds.index("USER") < kinds.index("ENTRYPOINT")
    assert json.loads(last["ENTRYPOINT"]) == ["depthsr"]
    make_parser().parse_args(["compile", "--quiet"])
    compiled = next(n for n, (kind, text) in enumerate(instructions) if "depthsr compile" in text)
    assert compiled < kinds.index("USER")
