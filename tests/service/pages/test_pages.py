"""The pages in a real browser: they play to the end, show what they say, and shut nobody out."""

from __future__ import annotations

import base64
import io
import json

import av
import httpx
import numpy as np
import pytest

from pipeline.baselines import bicubic
from pipeline.grid import Grid, Sampling
from pipeline.media.video_format import CODECS
from pipeline.stereo import anaglyph
from service.config import ServiceConfig
from tests.support.on_air import OnAir
from tests.support.service_api import follow
from tests.support.waiting import PATIENCE, until
from tests.support.watch_page import canvas_pixels, opened, until_page

FRAMES = 24
SOUGHT = 17
TOKEN = "a-token-for-everything"


@pytest.fixture(scope="module")
def job(live_service, tiny_scene):
    """Id of a finished job of two seconds."""
    from pipeline.synthetic.scene import SampleScene
    from pipeline.synthetic.writing import write_scene

    scene = SampleScene(width=48, height=36, num_views=3)
    write_scene(tiny_scene.parent / "long", scene, num_frames=FRAMES)
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:
        body = {
            "scene": "long",
            "output": {"segment_length": 12},
            "exports": [{"layout": "tab", "container": "mp4"}],
        }
        made = api.post("/api/v1/jobs", json=body).json()["id"]
        follow(api, made)
    return made


def _choose(page, **options):
    page.evaluate("options => Object.assign(window.depthsrWatch.view.options, options)", options)


def _first_frame(page):
    """Pause at the first frame."""
    until_page(page, "window.depthsrWatch.numbers().drawn > 0")
    page.evaluate(
        """async () => {
          const video = window.depthsrWatch.videos.result;
          video.pause();
          video.currentTime = 0.01;
        }"""
    )
    until_page(page, "window.depthsrWatch.numbers().shownFrame === 0")


def test_hls_plays_to_the_end_with_every_frame(chromium, live_service, job):
    """And says how the last one was made, though that is known after it was drawn."""
    with opened(chromium, "about:blank") as page:
        held = []
        page.route("**/results", lambda route: held.append(route))
        page.goto(f"{live_service.url}/watch/jobs/{job}")
        until_page(page, "window.depthsrWatch.videos.result.ended")
        until_page(page, f"window.depthsrWatch.numbers().shownFrame === {FRAMES - 1}")
        quality = page.evaluate(
            "(q => [q.totalVideoFrames, q.corruptedVideoFrames])"
            "(window.depthsrWatch.videos.result.getVideoPlaybackQuality())"
        )
        assert quality == [FRAMES, 0]
        assert page.evaluate("window.depthsrWatch.numbers().way") == "hls"
        held[0].continue_()
        page.wait_for_selector("#frame >> text=computed in")
        assert page.locator("#frame").inner_text().count("computed in") == 1


def test_a_frame_sought_is_shown_though_the_browser_calls_none(chromium, live_service, job):
    """A busy browser may put a frame on the screen without the call that tells of it."""
    with opened(chromium, f"{live_service.url}/watch/jobs/{job}") as page:
        _first_frame(page)
        first = canvas_pixels(page)
        page.evaluate(
            """sought => {
              const video = window.depthsrWatch.videos.result;
              HTMLVideoElement.prototype.requestVideoFrameCallback = () => 0;
              video.currentTime = sought * video.duration;
            }""",
            (SOUGHT + 0.5) / FRAMES,
        )
        until_page(page, f"window.depthsrWatch.numbers().shownFrame === {SOUGHT}")
        assert np.abs(canvas_pixels(page).astype(int) - first).max() > 20


def test_every_view_shows_what_it_says(chromium, live_service, job):
    with opened(chromium, f"{live_service.url}/watch/jobs/{job}") as page:
        _first_frame(page)
        both = canvas_pixels(page)
        assert both.shape == (72, 192, 3)
        left, right = both[:, :96], both[:, 96:]
        assert left.std() > 10
        _choose(page, half=True)
        assert canvas_pixels(page).shape == (72, 96, 3)
        _choose(page, half=False, swap=True)
        assert np.abs(canvas_pixels(page)[:, :96].astype(int) - right).max() <= 1
        _choose(page, mode="tab", swap=False)
        assert np.abs(canvas_pixels(page)[72:].astype(int) - right).max() <= 1
        _choose(page, mode="left")
        assert np.abs(canvas_pixels(page).astype(int) - left).max() <= 1
        _choose(page, mode="anaglyph")
        assert np.abs(canvas_pixels(page).astype(int) - anaglyph(left, right)).max() <= 2


def _orange_clip(width, height):
    """Return an MP4 of one colour."""
    made = io.BytesIO()
    with av.open(made, "w", format="mp4") as file:
        stream = file.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        picture = np.full((height, width, 3), (230, 120, 40), np.uint8)
        for _ in range(10):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture)))
        file.mux(stream.encode())
    return made.getvalue()


def test_what_a_decoder_pads_its_planes_with_is_not_drawn(chromium, live_service, job):
    """Where no macroblock reaches beyond the picture, the padding has no colour that was coded."""
    with opened(chromium, f"{live_service.url}/watch/jobs/{job}") as page:
        _first_frame(page)
        page.evaluate(
            """async clip => {
              const { view } = window.depthsrWatch, video = document.createElement("video");
              const bytes = Uint8Array.from(atob(clip), (byte) => byte.charCodeAt(0));
              video.src = URL.createObjectURL(new Blob([bytes], { type: "video/mp4" }));
              const shown = new Promise((done) => video.requestVideoFrameCallback(done));
              video.muted = true;
              await video.play();
              await shown;
              view.describe({ result: { ...view.tracks.result, eye_height: 64 } }, view.sampling);
              const frame = new VideoFrame(video);
              view.take("result", frame, 0);
              frame.close();
            }""",
            base64.b64encode(_orange_clip(192, 64)).decode(),
        )
        shown = canvas_pixels(page).astype(int)
    assert shown.shape == (64, 192, 3)
    assert np.ptp(shown, axis=(0, 1)).max() <= 2


def test_before_is_the_observed_picture_enlarged_bicubically(chromium, live_service, job):
    with opened(chromium, f"{live_service.url}/watch/jobs/{job}") as page:
        _first_frame(page)
        page.locator("text=Before and after").click()
        until_page(
            page, "window.depthsrWatch.view.hasBefore && !window.depthsrWatch.videos.before.seeking"
        )
        _choose(page, wipe=1.1)
        shown = canvas_pixels(page)
        width, height, flat = page.evaluate(
            """() => {
              const video = window.depthsrWatch.videos.before;
              const { videoWidth: width, videoHeight: height } = video;
              const flat = new OffscreenCanvas(width, height).getContext("2d");
              flat.drawImage(video, 0, 0);
              const { data } = flat.getImageData(0, 0, width, height);
              return [width, height, Array.from(data)];
            }"""
        )
        observed = np.array(flat, np.uint8).reshape(height, width, 4)[:, : width // 2, :3]
        grid = Grid(magnification_x=2, magnification_y=2, sampling=Sampling.AREA)
        expected = np.clip(bicubic(observed.astype(np.float32), grid), 0, 255)
        assert np.abs(shown - expected).max() <= 2
        _choose(page, wipe=-0.1)
        assert np.abs(canvas_pixels(page) - expected).max() > 10


def test_what_stands_still_is_compared_at_its_own_frame(chromium, live_service, job):
    with opened(chromium, f"{live_service.url}/watch/jobs/{job}") as page:
        until_page(page, "window.depthsrWatch.videos.result.ended")
        until_page(page, f"window.depthsrWatch.numbers().shownFrame === {FRAMES - 1}")
        page.locator("text=Before and after").click()
        until_page(page, "window.depthsrWatch.view.hasBefore")
        assert page.evaluate("window.depthsrWatch.numbers().shownFrame") == FRAMES - 1
        assert page.locator("#tag-one").is_visible()
        page.locator("#back-frame").click()
        until_page(
            page,
            "window.depthsrWatch.view.hasBefore"
            f" && window.depthsrWatch.numbers().shownFrame === {FRAMES - 2}",
        )


def test_pictures_come_without_what_only_a_video_has(chromium, live_service, job):
    with opened(chromium, f"{live_service.url}/watch/jobs/{job}") as page:
        _first_frame(page)
        page.locator("text=Before and after").click()
        page.wait_for_selector("#tag-one:not([hidden])")
        assert "frame 0" in page.locator("#time").inner_text()
        page.locator("text=Pictures").click()
        until_page(page, "document.getElementById('stills').naturalWidth > 0")
        for hidden in ("#tag-one", "#tag-two", "#compare-tools", "#canvas"):
            assert not page.locator(hidden).is_visible()
        assert page.locator("#time").inner_text() == ""
        assert page.locator("#play").is_disabled()
        assert page.locator("[name=mode]").first.is_disabled()
        page.locator("#ways >> text=HLS").click()
        page.wait_for_selector("#tag-one:not([hidden])")
        assert page.locator("#play").is_enabled()


def test_the_live_edge_plays_to_the_end(chromium, tmp_path):
    config = ServiceConfig(data=tmp_path / "data", workers=0, zenoh="off")
    with OnAir(config) as station:
        station.feed(3)
        with opened(chromium, f"http://{station.address}/watch/streams/room") as page:
            until_page(page, "window.depthsrWatch.numbers().way === 'live'")
            until(lambda: station.broadcast.viewers)  # who comes late begins at a later key frame
            for number in range(90):  # at its pace, but never so far ahead that the page jumps
                station.feed(1)
                page.wait_for_timeout(1000 / 15)
                until_page(page, f"window.depthsrWatch.numbers().shownFrame >= {number - 15}")
            station.broadcast.close()
            until_page(page, "window.depthsrWatch.videos.result.ended")
            until_page(  # a fragment waits for the next
                page, "window.depthsrWatch.numbers().shownFrame === 91"
            )
            total = page.evaluate(
                "window.depthsrWatch.videos.result.getVideoPlaybackQuality().totalVideoFrames"
            )
            assert total >= 90
            assert canvas_pixels(page).std() > 10
            assert page.locator("#name").inner_text() == "room"


def test_a_job_plays_while_it_runs(chromium, make_service, tiny_scene, job):
    """HLS begins with the first piece and goes on as others come."""
    service = make_service("--roots", str(tiny_scene.parent))
    body = {"scene": "long", "output": {"segment_length": 12}}
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as api:
        running = api.post("/api/v1/jobs", json=body).json()["id"]
        with opened(chromium, f"{service.url}/watch/jobs/{running}") as page:
            until_page(page, "window.depthsrWatch.numbers().drawn > 0")
            until_page(page, "window.depthsrWatch.videos.result.ended")
            until_page(page, f"window.depthsrWatch.numbers().shownFrame === {FRAMES - 1}")
        events = api.get(f"/api/v1/jobs/{running}/events").json()["events"]
    assert events[-1]["kind"] == "succeeded"


def test_files_that_are_dropped_become_a_job(chromium, live_service, tiny_scene):
    views = [{"id": name, "color": f"{name}.png"} for name in ("left", "right")]
    manifest = json.dumps({"format": "depthsr-scene/1", "views": views})
    files = {"scene.json": manifest.encode()}
    for name, view in (("left", "cam0"), ("right", "cam1")):
        files[f"{name}.png"] = (tiny_scene / view / "color-0000.png").read_bytes()
    with opened(chromium, live_service.url) as page:
        held = page.evaluate_handle(
            """files => {
              const held = new DataTransfer();
              for (const [name, bytes] of Object.entries(files)) {
                held.items.add(new File([Uint8Array.from(bytes)], name));
              }
              return held;
            }""",
            {name: list(data) for name, data in files.items()},
        )
        page.dispatch_event("#drop", "dragover", {"dataTransfer": held})
        page.dispatch_event("#drop", "drop", {"dataTransfer": held})
        page.wait_for_url("**/jobs/*")
        made = page.url.rpartition("/")[2]
    asked = httpx.get(f"{live_service.url}/api/v1/jobs/{made}", timeout=PATIENCE).json()["request"]
    assert set(asked["uploads"]) == set(files)


def test_a_folder_chosen_becomes_a_job_with_downloads(chromium, live_service, tiny_scene, tmp_path):
    folder = tmp_path / "small"
    folder.mkdir()
    for name in ("cam0", "cam1", "cam2"):
        (folder / name).mkdir()
        for kind in ("color", "depth"):
            source = tiny_scene / name / f"{kind}-0000.png"
            (folder / name / source.name).write_bytes(source.read_bytes())
    text = (tiny_scene / "scene.json").read_text().replace('"frame_count": 6', '"frame_count": 1')
    (folder / "scene.json").write_text(text)
    with opened(chromium, live_service.url) as page:
        page.locator("#folder").set_input_files(str(folder))
        page.wait_for_url("**/jobs/*")
        until_page(page, "document.getElementById('state').textContent === 'succeeded'")
        page.wait_for_selector("#files a")
        names = page.locator("#files a").all_inner_texts()
        assert "report.json" in names
        assert "small_3D_SBS_LR.mkv" in names
        assert page.locator("#name").inner_text().startswith("small · ")
        with page.expect_download() as loading:
            page.locator("#files a", has_text="report.json").click()
        assert loading.value.suggested_filename == "report.json"


def test_a_video_is_read_as_the_form_says(chromium, live_service, tmp_path):
    video = tmp_path / "clip.mp4"
    video.write_bytes(b"no video")
    with opened(chromium, live_service.url) as page:
        page.locator("summary").click()
        page.locator("[name=input_layout]").select_option("half-sbs")
        page.locator("[name=temporal]").select_option("warm")
        page.locator("[name=container]").select_option("mp4")
        page.locator("[name=codec]").select_option("hevc")
        page.get_by_label("Sound of the video").uncheck()
        page.locator("#files").set_input_files(str(video))
        page.wait_for_url("**/jobs/*")
        made = page.url.rpartition("/")[2]
    asked = httpx.get(f"{live_service.url}/api/v1/jobs/{made}", timeout=PATIENCE).json()["request"]
    assert asked["input"] == {"input_layout": "half-sbs"}
    assert asked["settings"] == {"temporal": "warm"}
    said = {name: asked["output"][name] for name in ("container", "codec", "sound")}
    assert said == {"container": "mp4", "codec": "hevc", "sound": "none"}


def test_the_form_offers_the_codecs_that_a_file_holds(chromium, live_service):
    with opened(chromium, live_service.url, width=360) as page:
        page.locator("summary").click()
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        for container, codecs in CODECS.items():
            page.locator("[name=codec]").select_option("")
            page.locator("[name=container]").select_option(container)
            offered = page.locator("[name=codec] option:enabled").evaluate_all(
                "options => options.map((option) => option.value)"
            )
            assert set(offered) == {"", *codecs}
        page.locator("[name=container]").select_option("mkv")
        page.locator("[name=codec]").select_option("ffv1")
        page.locator("[name=container]").select_option("webm")
        assert page.locator("[name=codec]").input_value() == ""


def test_the_time_left_is_told_by_the_pace_of_the_last_frames(chromium, live_service, job):
    with opened(chromium, f"{live_service.url}/jobs/{job}") as page:

        def left(frames):
            return page.evaluate(
                "async (frames) => (await import('/static/api.js')).secondsLeft(frames, 24)",
                [{"at": 1000 * at, "done": done} for at, done in frames],
            )

        assert left([]) is None
        assert left([(60, 1)]) is None  # the first frame may have been compiled for
        assert left([(60, 1), (61, 2), (64, 4)]) == pytest.approx(20 * 4 / 3)
        assert left([(60, 23), (62, 24)]) == 0
        until_page(
            page, f"document.getElementById('count').textContent === '{FRAMES} of {FRAMES} frames'"
        )


def test_a_job_that_waits_for_kernels_says_so(chromium, make_service, tiny_scene, tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "nothing-compiled")}
    service = make_service("--roots", str(tiny_scene.parent), **cache)
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as api:
        made = api.post("/api/v1/jobs", json={"scene": "tiny"}).json()["id"]
    with opened(chromium, f"{service.url}/jobs/{made}") as page:
        until_page(page, "document.getElementById('count').textContent.endsWith(', compiling')")
        assert "compiling, this once" in page.locator("#log").inner_text()
        page.goto(service.url)
        until_page(
            page, "document.getElementById('jobs').innerText.includes('frames, compiling, ')"
        )


def test_an_export_is_fetched_from_the_page_of_its_job(chromium, live_service, job):
    with opened(chromium, f"{live_service.url}/jobs/{job}") as page:
        page.locator("#export [name=layout]").select_option("left")
        page.locator("#export [name=kind]").select_option("webm")
        page.get_by_role("button", name="Export").click()
        with page.expect_download() as loading:
            page.get_by_role("link", name="Download left · webm").click()
    assert loading.value.suggested_filename == "long_left.webm"


def test_the_page_of_a_failed_job_says_why(chromium, live_service):
    """Also to who comes when it is over, and no look at the job that goes well takes it back."""
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:
        made = api.post("/api/v1/jobs", files=[("files", ("clip.mp4", b"no video"))]).json()["id"]
        follow(api, made)
        why = api.get(f"/api/v1/jobs/{made}").json()["problem"]["detail"]
    with opened(chromium, f"{live_service.url}/jobs/{made}") as page:
        until_page(page, "document.querySelectorAll('#log tr').length >= 3")  # each is a look
        page.wait_for_timeout(1000)
        assert why in page.locator("#problem").inner_text()
        assert page.locator("#log td.when").first.inner_text()
        assert page.locator("#problem").is_visible()
        assert "not come to its end" in page.locator("#no-files").inner_text()
        assert page.locator("#name").inner_text() == f"clip · {made[:8]}"


def test_a_job_that_is_not_there_is_said_to_be_none(chromium, live_service):
    with opened(chromium, f"{live_service.url}/jobs/none", errors=("404",)) as page:
        page.wait_for_selector("#trouble >> text=there is no such job")


def test_what_was_refused_stays_said(chromium, live_service, tmp_path):
    video = tmp_path / "clip.mp4"
    video.write_bytes(b"no video")
    with opened(chromium, live_service.url, errors=("422",)) as page:
        page.locator("summary").click()
        page.locator("[name=range]").fill("9:3")
        page.locator("#files").set_input_files(str(video))
        page.wait_for_selector("#trouble:not([hidden])")
        said = page.locator("#trouble").inner_text()
        assert "9:3" in said
        for _ in range(2):  # looks at the service that go well
            with page.expect_response("**/api/v1/jobs?*") as answer:
                pass
            answer.value.finished()
        page.wait_for_timeout(200)
        assert page.locator("#trouble").is_visible()
        assert page.locator("#trouble").inner_text() == said


def test_who_has_no_token_is_led_to_the_door_and_back(chromium, make_service, tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"anna submit,read {TOKEN}\n")
    service = make_service("--workers", "0", "--token-file", str(tokens))
    known = ("401",)
    with opened(chromium, f"{service.url}/?from=here", errors=known) as page:
        page.wait_for_url("**/login?next=*")
        page.locator("#token").fill("a-token-that-is-wrong")
        page.locator("button.first").click()
        page.wait_for_selector("#trouble:not([hidden])")
        page.locator("#token").fill(TOKEN)
        page.keyboard.press("Enter")
        page.wait_for_url("**/?from=here")
        page.wait_for_selector("#leave:not([hidden])")
        assert page.locator("#leave").inner_text() == "Log out anna"
        assert page.evaluate("document.cookie") == ""
        (cookie,) = page.context.cookies()
        assert cookie["httpOnly"]
        assert cookie["sameSite"] == "Strict"
        page.locator("#leave").click()
        page.wait_for_url("**/login")
        assert page.context.cookies() == []


def test_the_page_of_a_job_says_what_was_asked_for(chromium, live_service, job):
    with opened(chromium, f"{live_service.url}/jobs/{job}") as page:
        until_page(page, "document.querySelectorAll('#facts dd').length > 5")
        said = page.locator("#facts").inner_text()
        assert "tab mp4" in said
        assert "object" not in said


PAGES = {
    "/": "document.querySelector('#jobs .job') && document.querySelector('#health.ready')",
    "/login": "document.readyState === 'complete'",
    "/jobs/{job}": "document.querySelector('#views tr') && document.querySelector('#log tr')",
    "/watch/jobs/{job}": "window.depthsrWatch?.numbers().drawn > 0",
    "/api/docs": "document.querySelector('#operations details')",
}
"""Where pages are, and what is so once all of it is there."""


@pytest.mark.parametrize("where", PAGES)
def test_pages_are_for_everybody(chromium, live_service, job, where):
    """WCAG A and AA by axe, in the dark and in the light, and no sideways scrolling at 360 px."""
    from axe_playwright_python.sync_playwright import Axe

    url = live_service.url + where.format(job=job)
    rules = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21aa", "wcag22aa"]}}
    with opened(chromium, url, width=360) as page:
        until_page(page, f"!!({PAGES[where]})")
        for scheme in ("dark", "light"):
            page.emulate_media(color_scheme=scheme)
            found = Axe().run(page, options=rules).response["violations"]
            assert [
                (item["id"], [node["html"][:120] for node in item["nodes"]]) for item in found
            ] == []
        widths = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
        assert widths[0] <= widths[1]


def test_the_interface_is_shown_with_every_example(chromium, live_service):
    with opened(chromium, f"{live_service.url}/api/docs") as page:
        export = "GET /dscqs/api/operator/tests/{test}/export"
        panel = page.locator("details.panel").filter(has_text=export)
        head = panel.locator("summary").first
        assert "Return the votes (csv, sujson, sureal)" in head.inner_text()
        head.click()
        titles = panel.locator("summary", has_text="Example of").all_inner_texts()
        assert titles == [
            "Example of 200, text/csv",
            "Example of 200, application/json: json",
            "Example of 200, application/json: scores",
            "Example of 200, application/json: sujson",
            "Example of 200, application/json: sureal",
        ]


def test_pages_run_nothing_inline_and_nothing_foreign(live_service):
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:
        for where in PAGES:
            answer = api.get(where.format(job="x"))
            policy = answer.headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "unsafe" not in policy
            assert "http" not in policy
            assert "<script>" not in answer.text
            assert " style=" not in answer.text
            assert " onclick" not in answer.text
        assert api.get("/static/../store.py").status_code == 404
        assert api.get("/static/%2e%2e/store.py").status_code == 404
        assert api.get("/static/__init__.py").status_code == 404
        tag = api.get("/static/style.css").headers["etag"]
        assert api.get("/static/style.css", headers={"If-None-Match": tag}).status_code == 304
