"""Exports over HTTP: from a finished job, and with it."""

from __future__ import annotations

import io
import json
import zipfile
from contextlib import closing
from fractions import Fraction

import httpx
import numpy as np

from pipeline.media.decode import VideoReader
from pipeline.media.encode import write_segment
from pipeline.media.join import join_segments
from pipeline.media.video_format import VideoFormat
from pipeline.stereo import StereoLayout
from service.cli import main
from service.config import ServiceConfig
from tests.support.on_air import OnAir
from tests.support.service_api import follow, is_problem
from tests.support.waiting import PATIENCE

BODY = {"scene": "tiny", "input": {"frames": ":2"}, "output": {"segment_length": 1}}


def _names(api, job):
    return {item["name"] for item in api.get(f"/api/v1/jobs/{job}/results").json()}


def test_a_finished_job_is_exported_in_other_forms(api):
    job = api.post("/api/v1/jobs", json=BODY).json()["id"]
    follow(api, job)
    where = f"/api/v1/jobs/{job}/exports"
    made = []
    for form in (
        {"container": "mp4", "layout": "half-sbs"},
        {"container": "mkv", "codec": "ffv1", "layout": "tab"},
        {"video": False, "frames": True},
    ):
        answer = api.post(where, json=form)
        assert answer.status_code == 202, answer.text
        made.append(answer.json()["id"])
        assert answer.headers["location"] == f"/api/v1/jobs/{made[-1]}"
        assert follow(api, made[-1])[-1]["kind"] == "succeeded"
    assert _names(api, made[0]) == {"tiny_3D_HSBS_LR.mp4"}
    assert _names(api, made[1]) == {"tiny_3D_TAB.mkv"}
    pictures = {f"frames/{eye}-00000{n}.png" for eye in ("left", "right") for n in range(2)}
    assert _names(api, made[2]) == pictures
    packed = api.get(f"/api/v1/jobs/{made[2]}/archive")
    with zipfile.ZipFile(io.BytesIO(packed.content)) as archive:
        assert set(archive.namelist()) == pictures
        for name in pictures:
            there = api.get(f"/api/v1/jobs/{made[2]}/results/{name}").content
            assert archive.read(name) == there
    head = api.head(f"/api/v1/jobs/{made[2]}/archive")
    assert head.headers["content-type"] == "application/zip"
    assert "content-length" not in head.headers  # it is not known before it is made
    is_problem(api.get(f"/api/v1/jobs/{'0' * 32}/archive"), 404, "not-found")
    listed = api.get(where).json()["jobs"]
    assert [item["id"] for item in listed] == made[::-1]
    assert listed[0]["request"]["of"] == job
    is_problem(api.post(where, json={"container": "webm", "codec": "h264"}), 422,
               "configuration-error")  # fmt: skip
    for not_of_a_pair in ({"layout": "views"}, {"view_at": 0.5}):
        is_problem(api.post(where, json=not_of_a_pair), 422, "invalid")
    is_problem(api.post(f"/api/v1/jobs/{made[0]}/exports", json={}), 409, "conflict")
    assert api.delete(f"/api/v1/jobs/{job}").status_code == 204
    assert _names(api, made[0]) == {"tiny_3D_HSBS_LR.mp4"}


def test_the_command_fetches_a_form_of_a_finished_job(api, live_service, tmp_path, capsys):
    body = {**BODY, "input": {"frames": ":1"}}
    job = api.post("/api/v1/jobs", json=body).json()["id"]
    follow(api, job)
    server = ("--server", live_service.url)
    video, pictures = tmp_path / "tv.mp4", tmp_path / "pictures.zip"
    assert main(["export", job, *server, "-o", str(video), "--layout", "half-sbs"]) == 0
    with closing(VideoReader(video)) as read:
        assert (read.num_frames, read.picture(0).luma.shape) == (1, (72, 96))
    assert main(["export", job, *server, "-o", str(pictures)]) == 0
    with zipfile.ZipFile(pictures) as archive:
        assert archive.namelist() == ["frames/left-000000.png", "frames/right-000000.png"]
    assert capsys.readouterr().out.count("wrote ") == 2
    assert main(["export", job, *server, "-o", "tv.mkv", "--layout", "views"]) == 2
    assert "anaglyph" in capsys.readouterr().err  # which can be had
    assert main(["export", job, *server, "-o", "tv.avi"]) == 1
    assert "container" in capsys.readouterr().err


def test_the_commands_find_a_job_again(api, live_service, tmp_path, capsys):
    """One that was sent without waiting for it."""
    job = api.post("/api/v1/jobs", json={**BODY, "name": "again"}).json()["id"]
    server = ("--server", live_service.url)
    video, everything = tmp_path / "out.mkv", tmp_path / "all.zip"
    assert main(["fetch", job, *server, "-o", str(video)]) == 0
    assert main(["fetch", job, *server, "-o", str(everything)]) == 0
    with zipfile.ZipFile(everything) as archive:
        assert archive.read("again_3D_SBS_LR.mkv") == video.read_bytes()
    assert main(["cancel", job, *server]) == 1
    assert "succeeded" in capsys.readouterr().err
    assert main(["jobs", *server, "--state", "succeeded"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [job, "succeeded", "2", "of", "2", "again"] in rows
    assert main(["fetch", job, *server, "-o", str(tmp_path / "out.mp4")]) == 1
    assert "has made again_3D_SBS_LR.mkv" in capsys.readouterr().err
    assert not (tmp_path / "out.mp4").exists()


def test_the_commands_cancel_a_job_fetch_nothing_of_it_and_retry_it(tmp_path, tiny_scene, capsys):
    """By a service that does none: another might be done with it first."""
    roots = (tiny_scene.parent,)
    config = ServiceConfig(data=tmp_path / "data", workers=0, zenoh="off", roots=roots)
    with OnAir(config) as idle:
        server = ("--server", f"http://{idle.address}")
        made = httpx.post(f"{server[1]}/api/v1/jobs", json=BODY, timeout=PATIENCE)
        unwanted = made.json()["id"]
        assert main(["cancel", unwanted, *server]) == 0
        assert capsys.readouterr().out == "cancelled\n"
        assert main(["fetch", unwanted, *server, "-o", str(tmp_path / "none.mkv")]) == 1
        assert f"job {unwanted} cancelled" in capsys.readouterr().err
        assert main(["retry", unwanted, *server]) == 0
        assert capsys.readouterr().out == "queued\n"
        assert main(["retry", unwanted, *server]) == 1
        assert "queued" in capsys.readouterr().err


def test_forms_asked_for_at_the_start_come_with_the_results(api):
    forms = [{"container": "webm", "layout": "anaglyph"}, {"container": "mp4", "layout": "tab"}]
    job = api.post("/api/v1/jobs", json={**BODY, "exports": forms}).json()["id"]
    assert follow(api, job)[-1]["kind"] == "succeeded"
    assert _names(api, job) == {
        "tiny_3D_SBS_LR.mkv", "tiny_anaglyph.webm", "tiny_3D_TAB.mp4", "report.json"
    }  # fmt: skip


def test_eyes_that_stay_squeezed_are_exported_in_their_shape(api, tmp_path):
    squeezed = tmp_path / "a_3D_HSBS_LR.mkv"
    form = VideoFormat.for_path(squeezed, layout=StereoLayout.HALF_SBS, fps=Fraction(5))
    eyes = np.random.default_rng(7).integers(0, 256, (2, 32, 96, 3), np.uint8)
    write_segment(tmp_path / "segment.mkv", form, [tuple(eyes)], first_frame=0)
    join_segments([tmp_path / "segment.mkv"], squeezed, form)
    asked = {"settings": {"magnification": "2"}, "exports": [{"layout": "tab", "container": "mp4"}]}
    files = [("files", (squeezed.name, squeezed.read_bytes()))]
    job = api.post("/api/v1/jobs", files=files, data={"job": json.dumps(asked)}).json()["id"]
    assert follow(api, job)[-1]["kind"] == "succeeded"
    shapes = {}
    for item in api.get(f"/api/v1/jobs/{job}/results").json():
        if item["name"].startswith("a_"):
            path = tmp_path / item["name"]
            path.write_bytes(api.get(item["url"]).content)
            with closing(VideoReader(path)) as video:
                shapes[path.suffix] = (video.width, video.height, video.pixel_aspect)
    assert shapes == {".mkv": (192, 64, 2), ".mp4": (96, 128, 2)}


def test_what_cannot_be_written_is_refused_at_once(api):
    twice = [{"container": "mkv", "layout": "sbs"}]
    is_problem(api.post("/api/v1/jobs", json={**BODY, "exports": twice}), 422, "invalid")
    bare = {**BODY, "output": {"master": False}, "exports": [{"layout": "tab"}]}
    is_problem(api.post("/api/v1/jobs", json=bare), 422, "invalid")


def test_without_a_master_there_is_nothing_to_export_from(api):
    job = api.post("/api/v1/jobs", json={**BODY, "output": {"master": False}}).json()["id"]
    where = f"/api/v1/jobs/{job}/exports"
    follow(api, job)
    is_problem(api.post(where, json={"layout": "tab"}), 409, "conflict")
