"""What can be said of the containers without starting them."""

from __future__ import annotations

from pathlib import Path

import yaml

from service.cli import make_parser

DOCKER = Path(__file__).parents[2] / "docker"


def test_compose_is_hardened_and_stays_on_this_machine():
    content = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    assert {"service", "zenoh", "scheduler", "worker"} <= set(content["services"])
    for name, part in content["services"].items():
        assert part["read_only"] is True, name
        assert part["cap_drop"] == ["ALL"], name
        assert "no-new-privileges:true" in part["security_opt"], name
        assert all(port.startswith("127.0.0.1:") for port in part.get("ports", ())), name
        for volume in part.get("volumes", ()):
            source = volume.partition(":")[0]
            assert source in content["volumes"] or source.startswith("$"), name


def test_the_command_of_the_container_is_understood():
    content = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    arguments = make_parser().parse_args(content["services"]["service"]["command"])
    assert arguments.host == "0.0.0.0"


def test_the_image_runs_without_rights():
    lines = (DOCKER / "Dockerfile").read_text().splitlines()
    assert lines.index("USER depthsr") < lines.index('ENTRYPOINT ["depthsr"]')
