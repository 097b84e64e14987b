from __future__ import annotations

import pytest

from pipeline.errors import ConfigurationError
from service.cli import main
from service.config import format_config, load_config


def test_later_wins_and_the_origin_is_told(tmp_path):
    file = tmp_path / "depthsr.yaml"
    file.write_text("port: 1000\nworkers: 2\nroots: [/a, /b]\n")
    loaded = load_config(
        file=file,
        environment={"DEPTHSR_PORT": "2000", "DEPTHSR_LEASE": "7.5"},
        flags={"port": 3000},
    )
    assert (loaded.config.port, loaded.config.workers, loaded.config.lease) == (3000, 2, 7.5)
    assert loaded.origins["port"] == "flag --port"
    assert loaded.origins["lease"] == "environment DEPTHSR_LEASE"
    assert loaded.origins["workers"] == f"file {file}"
    assert loaded.origins["host"] == "default"
    assert "/a,/b" in format_config(loaded)


@pytest.mark.parametrize(
    ("text", "said"),
    [("prot: 1", "no setting 'prot'"), ("port: many", "port"), ("- 1", "by name"), ("[", "read")],
)
def test_what_is_wrong_in_a_file_is_said(tmp_path, text, said):
    file = tmp_path / "depthsr.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=said):
        load_config(file=file)


def test_out_of_range_is_refused():
    with pytest.raises(ConfigurationError, match="--max-attempts: must be 1 to 100, not 0"):
        load_config(environment={"DEPTHSR_MAX_ATTEMPTS": "0"})


def test_the_command_prints_them(capsys):
    assert main(["settings", "--port", "9"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["port", "9", "flag", "--port"] in rows
