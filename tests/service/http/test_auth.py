from __future__ import annotations

import io
import time
import zipfile
from urllib.parse import quote

import httpx
import pytest

from pipeline.errors import ConfigurationError
from service.cli import main
from service.config import ServiceConfig
from service.http import auth
from service.http.auth import Tokens
from tests.support.on_air import OnAir
from tests.support.waiting import PATIENCE

FILE = """# who may do what
anna submit,read anna-secret-0123456789
bert submit,read bert-secret-0123456789
rita read rita-secret-0123456789
otto operate,submit,read otto-secret-0123456789
"""


def _bearer(name):
    return {"Authorization": f"Bearer {name}-secret-0123456789"}


@pytest.fixture
def tokens(tmp_path):
    file = tmp_path / "tokens"
    file.write_text(FILE)
    return file


def test_scopes_owners_cookies_and_signed_addresses(make_service, tokens, tiny_scene):
    service = make_service("--token-file", str(tokens), "--roots", str(tiny_scene.parent))
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as api:
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "Basic x"}):
            answer = api.get("/api/v1/jobs", headers=headers)
            assert answer.status_code == 401
            assert answer.headers["www-authenticate"] == "Bearer"
        assert api.get("/healthz").status_code == 200
        assert api.get("/metrics").status_code == 401
        body = {"scene": "tiny", "name": "Łódź, 休日", "input": {"frames": ":1"}}
        assert api.post("/api/v1/jobs", json=body, headers=_bearer("rita")).status_code == 403
        job = api.post("/api/v1/jobs", json=body, headers=_bearer("anna")).json()["id"]
        where = f"/api/v1/jobs/{job}"
        assert api.get(where, headers=_bearer("bert")).status_code == 404
        assert api.get(where, headers=_bearer("otto")).status_code == 200
        assert api.get("/api/v1/jobs", headers=_bearer("bert")).json()["jobs"] == []
        stream = {**_bearer("anna"), "Accept": "text/event-stream"}
        assert '"succeeded"' in api.get(f"{where}/events", headers=stream).text
        files = api.get(f"{where}/results", headers=_bearer("anna")).json()
        names = ["report.json", "Łódź--休日_3D_SBS_LR.mkv"]
        assert [item["name"] for item in files] == names
        for item in files:
            assert item["url"].isascii()
            assert len(api.get(item["url"]).content) == item["size"]
        packed = api.get(f"{where}/archive", headers=_bearer("anna"))
        assert quote("Łódź--休日") in packed.headers["content-disposition"]
        assert zipfile.ZipFile(io.BytesIO(packed.content)).namelist() == names
        url = files[0]["url"]
        assert api.get(url[:-1] + "x").status_code == 401
        assert api.get(url.replace("report.json", "other")).status_code == 401
        assert api.delete(f"{where}?{url.partition('?')[2]}").status_code == 401
        made = api.post("/api/v1/session", headers=_bearer("anna"))
        cookie = made.headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie
        assert api.get(where).status_code == 200  # by the cookie
    service.end()
    assert "secret" not in (service.data.parent / "data.log").read_text()


def test_a_command_that_is_not_let_in_is_told_what_to_give(tmp_path, tokens, capsys, monkeypatch):
    monkeypatch.delenv("DEPTHSR_TOKEN", raising=False)
    config = ServiceConfig(data=tmp_path / "data", workers=0, zenoh="off", token_file=tokens)
    with OnAir(config) as service:
        for token, said in (
            ([], "401: give a token with --token or DEPTHSR_TOKEN"),
            (["--token", "x"], "401: it does not know this token; give another with --token or"),
        ):
            for words in (["jobs"], ["fetch", "x", "-o", "x.mkv"]):  # that one follows events
                assert main([*words, "--server", f"http://{service.address}", *token]) == 1
                assert said in capsys.readouterr().err


def test_signatures_run_out(tokens, monkeypatch):
    known = Tokens(tokens, key=b"k" * 32)
    path, _, query = known.sign("/x", "anna").partition("?")
    values = dict(pair.split("=") for pair in query.split("&"))
    assert known.signed_client(path, values).name == "anna"
    later = time.time() + auth.LINK_SECONDS + 1
    monkeypatch.setattr(auth.time, "time", lambda: later)
    assert known.signed_client(path, values) is None


@pytest.mark.parametrize("line", ["anna read", "anna fly secret-0123456789", "anna read short"])
def test_a_wrong_line_is_named_without_its_token(tmp_path, line):
    file = tmp_path / "tokens"
    file.write_text(f"\n{line}\n")
    with pytest.raises(ConfigurationError, match="line 2") as caught:
        Tokens(file)
    assert "secret" not in str(caught.value)


def test_a_name_that_was_made_to_mean_this_machine_opens_nothing(live_service):
    """A page whose name is resolved anew has the origin that it asks (DNS rebinding)."""
    port = live_service.url.rpartition(":")[2]
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:
        for host, status in (
            (f"evil.example:{port}", 403),
            (f"127.0.0.1.evil.example:{port}", 403),
            (f"localhost:{port}", 202),
            (f"[::1]:{port}", 202),
        ):
            headers = {"Host": host, "Origin": f"http://{host}"}
            body = {"scene": "tiny", "input": {"frames": ":1"}}
            answer = api.post("/api/v1/jobs", json=body, headers=headers)
            assert answer.status_code == status, answer.text
            if status == 403:
                assert api.get("/api/v1/jobs", headers=headers).status_code == 403
            else:
                api.post(f"{answer.headers['location']}/cancel")
