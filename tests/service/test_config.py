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
    assert ["roots", "none", "default"] in rows
    assert ["cluster", "none", "default"] in rows


TLS = {"zenoh_certificate": "server.pem", "zenoh_key": "server.key", "zenoh_ca": "ca.pem"}


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ({"zenoh_listen": "tls/0.0.0.0:1"}, "needs a certificate"),
        ({"zenoh_mutual_tls": True}, "an endpoint of TLS"),
        ({"zenoh_mutual_tls": True, "zenoh_listen": "tls/0.0.0.0:1,tcp/0.0.0.0:2", **TLS},
         "other machines reach: tcp/0.0.0.0:2"),
        ({"zenoh_mutual_tls": True, "zenoh_listen": "tls/0.0.0.0:1", **TLS, "zenoh_ca": None},
         "certificate of an authority"),
    ],
)  # fmt: skip
def test_tls_that_would_guard_nothing_is_refused(tmp_path, monkeypatch, flags, said):
    monkeypatch.chdir(tmp_path)
    for name in TLS.values():
        (tmp_path / name).touch()
    with pytest.raises(ConfigurationError, match=said):
        load_config(flags=flags)


def test_roots_that_are_not_there_are_told(tmp_path):
    absent = tmp_path / "scenes"
    (sentence,) = load_config(flags={"roots": f"{tmp_path},{absent}"}).config.missing_roots()
    assert str(absent) in sentence


def test_doors_that_ask_for_nothing_are_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("tokens", "users", *TLS.values()):
        (tmp_path / name).touch()

    def doors(**flags):
        return load_config(flags=flags).config.open_doors()

    assert doors() == ()
    open_to_all = {"host": "0.0.0.0", "zenoh_listen": "tcp/127.0.0.1:1,tcp/[::]:2"}
    first, second = doors(**open_to_all)
    assert "--token-file" in first
    assert "tcp/[::]:2" in second
    assert doors(**open_to_all, token_file="tokens", zenoh_users="users") == ()
    assert doors(zenoh_mutual_tls=True, zenoh_listen="tls/0.0.0.0:1", **TLS) == ()
    assert doors(host="::1", zenoh="off", zenoh_listen="tcp/0.0.0.0:1") == ()
