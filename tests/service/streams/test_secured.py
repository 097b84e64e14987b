"""Who may connect: certificates of both sides, names and passwords; the worker still gets in."""

from __future__ import annotations

import json

import pytest
import trustme

from service.bus import keys
from service.bus.bus import JSON, BusError
from service.bus.config import BusConfig
from service.bus.zenoh_bus import ZenohBus
from tests.support.waiting import PATIENCE, until


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """Folder of an authority, and certificates of a server and of a client."""
    folder = tmp_path_factory.mktemp("certificates")
    authority = trustme.CA()
    authority.cert_pem.write_to_path(str(folder / "ca.pem"))
    for name, issued in (
        ("server", authority.issue_cert("localhost", "127.0.0.1")),
        ("client", authority.issue_cert("camera")),
        ("stranger", trustme.CA().issue_cert("camera")),
    ):
        issued.private_key_pem.write_to_path(str(folder / f"{name}.key"))
        issued.cert_chain_pems[0].write_to_path(str(folder / f"{name}.pem"))
    (folder / "users").write_text("ann:a long password\n")
    (folder / "password").write_text("a long password\n")
    (folder / "rights.yaml").write_text("ann: {publish: [tiny]}\n")
    return folder


def test_certificates_and_passwords_let_in_whom_they_should(
    make_stage, certificates, tiny_scene, tmp_path
):
    folder = certificates
    tls = {"ca": folder / "ca.pem", "certificate": folder / "client.pem",
           "key": folder / "client.key", "mutual_tls": True}  # fmt: skip
    ann = {"user": "ann", "password": "a long password"}
    stage = make_stage(
        "--zenoh-ca", str(folder / "ca.pem"), "--zenoh-certificate", str(folder / "server.pem"),
        "--zenoh-key", str(folder / "server.key"), "--zenoh-mutual-tls",
        "--zenoh-users", str(folder / "users"), "--zenoh-rights", str(folder / "rights.yaml"),
        kind="tls", host="localhost",
        words=("--ca", str(folder / "ca.pem"), "--certificate", str(folder / "client.pem"),
               "--key", str(folder / "client.key"), "--user", "ann",
               "--password-file", str(folder / "password")),
    )  # fmt: skip
    stranger = {"certificate": folder / "stranger.pem", "key": folder / "stranger.key"}
    for wrong in (
        {**tls, "user": "ann", "password": "another password"},
        {**tls},
        {**tls, **stranger, **ann},
        {"ca": folder / "ca.pem", **ann},
    ):
        with pytest.raises(BusError, match="Unable to connect"):
            ZenohBus(BusConfig(connect=(stage.endpoint,), **wrong))
    stage.run("publish", str(tiny_scene), "--stream", "tiny", "--rate", "4", "--loop")
    target = tmp_path / "out.mp4"
    receiver = stage.run("subscribe", "tiny", "-o", str(target), "--frames", "3")
    _, said = receiver.communicate(timeout=PATIENCE)
    assert receiver.returncode == 0, said
    assert target.stat().st_size > 1000
    with ZenohBus(BusConfig(connect=(stage.endpoint,), **tls, **ann)) as bus:
        (answer,) = until(lambda: bus.ask(keys.info("tiny")))
        assert json.loads(answer.read())["stream"] == "tiny"
        manifest = {"format": "depthsr-scene/1", "views": [{"id": "a"}, {"id": "b"}]}
        bus.put(keys.manifest("other"), json.dumps(manifest).encode(), encoding=JSON)
        (answer,) = until(lambda: bus.ask(keys.SERVICE))
        assert [item["stream"] for item in json.loads(answer.read())] == ["tiny"]
