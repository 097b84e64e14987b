"""The curl lines of docs/api.md, as they stand, against a real service."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import zipfile
from pathlib import Path

import httpx
import pytest

from tests.support.service_api import follow
from tests.support.waiting import PATIENCE

PAGE = Path(__file__).parents[3] / "docs" / "api.md"


def _lines():
    text = PAGE.read_text(encoding="utf-8").replace("\\\n", " ")
    return re.findall(r"^curl .*$", text, re.M)


@pytest.fixture(scope="module")
def job(live_service):
    """Id of a finished job."""
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:
        body = {"scene": "tiny", "input": {"frames": ":1"}}
        found = api.post("/api/v1/jobs", json=body).json()["id"]
        assert follow(api, found)[-1]["kind"] == "succeeded"
    return found


def _curl(line, live_service, folder):
    words = shlex.split(line.replace("http://127.0.0.1:8000", live_service.url))
    done = subprocess.run(
        [*words, "-sS", "--fail-with-body"], cwd=folder, capture_output=True, text=True,
        check=False, timeout=PATIENCE,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("line", [line for line in _lines() if "/ID" not in line])
def test_what_begins_something_does_what_the_page_says(line, live_service, tmp_path, tiny_scene):
    (tmp_path / "scene.json").write_text(
        json.dumps(
            {
                "format": "depthsr-scene/1",
                "views": [
                    {"id": "left", "color": "left.png"}, {"id": "right", "color": "right.png"}
                ],
            }
        )
    )  # fmt: skip
    for name, view in (("left", "cam0"), ("right", "cam1")):
        picture = sorted((tiny_scene / view).glob("color*"))[0]
        shutil.copy(picture, tmp_path / f"{name}.png")
    said = _curl(line, live_service, tmp_path)
    assert '"state":"queued"' in said or '"state":"waiting"' in said


SAID = {
    "events": "event: succeeded", "watch": '"state":"ended"', "index.m3u8": "#EXT-X-ENDLIST",
    "results": "tiny_3D_SBS_LR.mkv", "exports": '"state":"queued"',
}  # fmt: skip
"""What is in the answer, by the end of the address."""


@pytest.mark.parametrize("line", [line for line in _lines() if "/ID" in line])
def test_what_asks_for_a_job_does_what_the_page_says(line, live_service, job, tmp_path):
    said = _curl(line.replace("/ID", f"/{job}"), live_service, tmp_path)
    end = re.search(r"/ID\S*?([^/ ]+)(?= |$)", line)[1]
    if end == "latest.jpg":
        assert (tmp_path / end).read_bytes()[:2] == b"\xff\xd8"
    elif end == "archive":
        with zipfile.ZipFile(tmp_path / "results.zip") as archive:
            assert archive.testzip() is None
            assert archive.namelist() == ["report.json", "tiny_3D_SBS_LR.mkv"]
    else:
        assert SAID[end] in said


def test_there_are_some():
    assert len(_lines()) >= 11
