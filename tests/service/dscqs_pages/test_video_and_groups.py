"""Lossless video through the whole chain, and a group of telephones before one screen."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dscqs.pixel_hash import hash_frames
from tests.service.dscqs.support import CONDITIONS, CONTENTS, REFERENCE
from tests.service.dscqs_pages.conftest import TIMING
from tests.service.dscqs_pages.exports import given, logs_of, votes_of
from tests.support.accessibility import problems
from tests.support.waiting import PATIENCE

COUNT, RATE = 4, 4
"""Frames of a clip, and those of a second: slow enough for a processor that does all the work."""


def clip_of(content: int, condition: int) -> np.ndarray:
    """(4, 24, 64, 3): every frame of every clip has a colour of its own."""
    frames = np.empty((COUNT, 24, 64, 3), np.uint8)
    for index in range(COUNT):
        frames[index] = 30 + 60 * index, 40 + 80 * condition, 90 + 100 * content
    return frames


@pytest.fixture(scope="module")
def clips(served: Any) -> dict[str, np.ndarray]:
    folder = Path(served.root) / "clips"
    folder.mkdir()
    made = {}
    for number, content in enumerate(CONTENTS):
        for place, condition in enumerate((REFERENCE, *CONDITIONS)):
            frames = clip_of(number, place)
            made[f"{content}/{condition}"] = frames
            subprocess.run(
                [
                    "ffmpeg", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "64x24",
                    "-r", str(RATE), "-i", "-", "-c:v", "libvpx-vp9", "-lossless", "1",
                    "-pix_fmt", "gbrp", str(folder / f"{content}-{condition}.webm"),
                ],
                input=frames.tobytes(), check=True, timeout=PATIENCE,
            )  # fmt: skip
    return made


def test_every_frame_of_a_video_is_shown_in_its_order(enter, make_test, operator, plan, clips):
    test = make_test({
        **plan, "kind": "video", "folder": "clips", "dummies": 0,
        "stimuli": {key: key.replace("/", "-") + ".webm" for key in clips},
        "timing": {**TIMING, "show_s": COUNT / RATE},
    })  # fmt: skip
    seat = enter(test)
    seat.come_to_vote()
    seat.vote(70, 60)
    seat.wait_until_sent()
    (vote,) = votes_of(operator, test)
    shown = logs_of(operator, test)[-1]["log"]
    names = [REFERENCE, vote["condition"]]
    if vote["reference_side"] == "B":
        names.reverse()
    pair = [clips[f"{vote['content']}/{name}"] for name in names]
    colours = [list(frame[0, 0]) for frames in pair for frame in frames]
    assert [item["rgb"] for item in seat.drawn[0] if item["stereo"]] == colours
    assert shown["pixels"] == dict(zip("AB", map(hash_frames, pair), strict=True))
    assert [item["frames"] for item in shown["intervals"] if item["what"] != "grey"] == [COUNT] * 2


def test_a_group_votes_on_telephones(make_tab, make_test, operator, plan, served, desk):
    test = make_test({**plan, "dummies": 0})
    asked = {"display": desk, "language": "en", "assessors": ["g1", "g2"]}
    links = operator.http.post(f"/dscqs/api/operator/tests/{test}/groups", json=asked).json()
    screen = make_tab().open(served.url + links["screen"])
    phones = [
        make_tab(viewport={"width": 360, "height": 740}, has_touch=True).open(served.url + link)
        for link in links["phones"].values()
    ]
    for phone in phones:
        phone.wait_for("phone-wait")
    assert problems(phones[0].page) == []
    for index in range(2):
        while screen.wait_for("ready", "failed", "group-vote") != "group-vote":
            screen.press_main()
        assert problems(screen.page) == []
        screen.page.evaluate("document.querySelector('main h1').id = 'past'")
        for number, phone in enumerate(phones):
            phone.wait_for("vote")
            assert problems(phone.page) == []
            phone.vote(80 - 10 * number, 20 + 10 * index)
            phone.wait_until_sent()
        screen.page.wait_for_selector("main:not(:has(#past))", state="attached")
    votes = votes_of(operator, test)
    for name, phone in zip(("g1", "g2"), phones, strict=True):
        assert given([vote for vote in votes if vote["assessor"] == name]) == phone.clicked
