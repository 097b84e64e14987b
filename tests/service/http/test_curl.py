"""The curl lines of docs/api.md, as they stand, against a real service."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "api.md"


def _lines():
    text = PAGE.read_text(encoding="utf-8").replace("\\\n", " ")
    return re.findall(r"^curl .*$", text, re.M)


@pytest.mark.parametrize("line", _lines(), ids=range(len(_lines())))
def test_it_does_what_the_page_says(line, live_service, tmp_path, tiny_scene):
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
    words = shlex.split(line.replace("http://127.0.0.1:8000", live_service.url))
    done = subprocess.run(
        [*words, "-sS", "--fail-with-body"], cwd=tmp_path, capture_output=True, text=True,
        check=False, timeout=30,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert '"state":"queued"' in done.stdout or '"state":"waiting"' in done.stdout


def test_there_are_some():
    assert len(_lines()) >= 2
