"""The page of a live stream in a real browser: beside bicubic, and through faults."""

from __future__ import annotations

import threading
import time
from datetime import datetime

import numpy as np
import pytest

from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_encode import LiveEncoder
from pipeline.stereo import StereoLayout
from service.config import ServiceConfig
from service.live.broadcast import KEEP
from service.streams.states import Action
from tests.support.on_air import FPS, OnAir
from tests.support.waiting import PATIENCE
from tests.support.watch_page import canvas_pixels, opened, until_page


class Camera:
    """A stream on air whose grey tells which frame it is; what was observed is inverted."""

    def __init__(self, station: OnAir) -> None:
        self._station = station
        self._broadcasts = [
            station.app.state.broadcasts.open(name, fps=FPS, layout=StereoLayout.SBS)
            for name in ("streams/cam", "streams/cam/before")
        ]
        self.begin_anew(0)

    def begin_anew(self, brighter: int) -> None:
        """Do what another worker does, with other encoders, which count from 0."""
        self._brighter = brighter
        self._encoders = [LiveEncoder(fps=FPS, layout=StereoLayout.SBS) for _ in range(2)]
        self.number = 0

    def feed(self) -> None:
        level = grey(self.number) + self._brighter
        for encoder, broadcast, value, size in zip(
            self._encoders, self._broadcasts, (level, 255 - level), (32, 16), strict=True
        ):
            picture = np.full((size, 2 * size, 3), value, np.uint8)
            encoder.encode(picture, self.number)
            broadcast.feed(encoder.take_mp4())
        self.number += 1

    def _run(self) -> None:
        while not self._stop.wait(float(1 / FPS)):
            self.feed()

    def __enter__(self):
        self.feed()
        self.feed()
        self.go_on()
        return self

    def __exit__(self, *_):
        self.pause()
        for encoder in self._encoders:
            encoder.close()

    def go_on(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def pause(self) -> None:
        self._stop.set()
        self._thread.join()

    def end(self) -> None:
        for name in ("streams/cam", "streams/cam/before"):
            self._station.app.state.broadcasts.close(name)


def grey(number: int) -> int:
    """Return the grey level of a frame, below 100."""
    return 30 + 4 * (number % 17)


@pytest.fixture
def station(tmp_path):
    """The service, which knows the stream."""
    config = ServiceConfig(data=tmp_path / "data", workers=0, zenoh="off")
    with OnAir(config) as station:
        station.app.state.streams.create("cam", "anybody")
        yield station


HALVES = """async () => {
  const { view, videos, numbers } = window.depthsrWatch, { gl, canvas } = view;
  const level = (x) => {
    const pixel = new Uint8Array(4);
    gl.readPixels(x, 16, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    return pixel[1];
  };
  const seen = [];
  for (let time = 0; time < 240; time += 1) {
    if (time === 120) videos.before.currentTime -= 0.3;
    await new Promise(requestAnimationFrame);
    seen.push([view.hasBefore, level(4), level(28), numbers().shownFrame]);
  }
  return seen;
}"""
"""What stands in both halves at every refresh, the observed video being held back on the way."""


@pytest.mark.parametrize("way", ["live", "hls"])
def test_what_a_live_stream_is_compared_with_is_of_the_same_frame(chromium, station, way):
    camera = Camera(station)
    for _ in range(2 * round(KEEP * FPS)):  # what HLS began with has been forgotten
        camera.feed()
    with camera, opened(chromium, f"http://{station.address}/watch/streams/cam") as page:
        until_page(page, "window.depthsrWatch.numbers().way === 'live'")
        page.locator(f'[name="way"][value="{way}"]').check()
        until_page(page, "window.depthsrWatch.numbers().drawn > 0")
        first = camera.number
        until_page(page, f"window.depthsrWatch.numbers().shownFrame > {first}")
        page.locator("text=Before and after").click()
        until_page(page, "window.depthsrWatch.view.hasBefore")
        seen = page.evaluate(HALVES)
        until_page(page, "window.depthsrWatch.view.hasBefore")
    pairs = [(before, result) for both, before, result, _ in seen if both]
    alone = [(left, right) for both, left, right, _ in seen if not both]
    assert len({result for _, result in pairs}) > 5
    assert max(abs(before + result - 255) for before, result in pairs) <= 3
    assert all(abs(left - right) <= 1 and left < 128 for left, right in alone)
    assert len({frame for *_, frame in seen}) > 10
    shown = [(result, frame) for both, _, result, frame in seen if both]
    assert max(abs(result - grey(frame)) for result, frame in shown) <= 3


def test_a_worker_that_is_started_anew_is_watched_on(chromium, station):
    with Camera(station) as camera, opened(
        chromium, f"http://{station.address}/watch/streams/cam"
    ) as page:  # fmt: skip
        until_page(page, "window.depthsrWatch.numbers().drawn > 10")
        camera.pause()
        camera.begin_anew(100)
        camera.go_on()
        deadline = time.monotonic() + PATIENCE
        while int(canvas_pixels(page)[16, 16, 1]) <= 125:
            assert time.monotonic() < deadline, "the new worker is not seen"
            page.wait_for_timeout(20)
        drawn = page.evaluate("window.depthsrWatch.numbers().drawn")
        until_page(page, f"window.depthsrWatch.numbers().drawn > {drawn + 10}")
        assert int(canvas_pixels(page)[16, 16, 1]) > 125


def test_a_stream_that_is_stopped_and_made_again_is_watched_again(chromium, station):
    with opened(chromium, f"http://{station.address}/watch/streams/cam") as page:
        with Camera(station) as camera:
            until_page(page, "window.depthsrWatch.numbers().drawn > 3")
            camera.pause()
            camera.end()
        until_page(page, "document.getElementById('state').textContent !== 'live'")
        drawn = page.evaluate("window.depthsrWatch.numbers().drawn")
        with Camera(station):
            until_page(page, f"window.depthsrWatch.numbers().drawn > {drawn + 3}")


@pytest.mark.parametrize("way", ["live", "hls"])
def test_a_stream_that_is_made_again_at_once_is_watched_again(chromium, station, way):
    """The page never sees that it was gone."""
    with opened(
        chromium, f"http://{station.address}/watch/streams/cam", errors=("404",)
    ) as page, Camera(station) as camera:  # fmt: skip
        until_page(page, "window.depthsrWatch.numbers().way === 'live'")
        page.locator(f'[name="way"][value="{way}"]').check()
        page.locator("text=Before and after").click()
        until_page(page, "window.depthsrWatch.view.hasBefore")
        camera.pause()
        with Camera(station) as another:  # one of the same name ends
            another.pause()
            another.begin_anew(100)
            another.go_on()
            until_page(page, "window.depthsrWatch.numbers().drawn > 0")
            deadline = time.monotonic() + PATIENCE
            while int(canvas_pixels(page)[16, 28, 1]) <= 125:
                assert time.monotonic() < deadline, "what was made again is not seen"
                page.wait_for_timeout(20)
            until_page(page, "window.depthsrWatch.view.hasBefore")
            assert page.evaluate("window.depthsrWatch.numbers().way") == way
            assert page.locator('[name="mode"][value="compare"]').is_checked()


def test_pictures_of_a_stream_that_is_made_again_at_once_go_on(chromium, station):
    def show_until_seen(width: int) -> None:
        picture = encode_jpeg(np.full((32, width, 3), 90, np.uint8))
        deadline = time.monotonic() + PATIENCE
        while page.evaluate("document.getElementById('stills').naturalWidth") != width:
            assert time.monotonic() < deadline, "no picture is seen"
            station.app.state.broadcasts.get("streams/cam").show(picture)
            page.wait_for_timeout(50)

    with opened(
        chromium, f"http://{station.address}/watch/streams/cam"
    ) as page, Camera(station):  # fmt: skip
        until_page(page, "window.depthsrWatch.numbers().way === 'live'")
        page.locator("text=Pictures").click()
        show_until_seen(64)
        with Camera(station):
            show_until_seen(128)


def test_the_number_said_is_that_of_the_picture_drawn(chromium, station):
    """Whoever asks for a picture while others come may get an earlier one than the clock says."""
    with Camera(station), opened(chromium, f"http://{station.address}/watch/streams/cam") as page:
        until_page(page, "window.depthsrWatch.numbers().drawn > 0")
        seen = page.evaluate(
            """async () => {
              const { view, videos, numbers } = window.depthsrWatch, { gl } = view;
              const pixel = new Uint8Array(4), seen = [], frames = new Set();
              while (seen.length < 150 || frames.size < 6) {
                videos.result.dispatchEvent(new Event("seeked"));
                gl.readPixels(16, 16, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
                const said = document.getElementById("time").textContent.split("frame ")[1];
                seen.push([numbers().shownFrame, Number(said), pixel[1]]);
                frames.add(numbers().shownFrame);
                await new Promise((go) => setTimeout(go, 9));
              }
              return seen;
            }"""
        )
    assert [said for _, said, _ in seen] == [frame for frame, _, _ in seen]
    assert [round((level - 30) / 4) for _, _, level in seen] == [n % 17 for n, _, _ in seen]


def test_a_stream_that_is_silent_says_since_when(chromium, station):
    stream = station.app.state.streams.get("cam")
    with Camera(station) as camera:
        stream.act(Action.BEGIN)
        stream.act(Action.HEAR)
        url = f"http://{station.address}/"
        with opened(chromium, url, errors=("404",)) as page:  # nobody makes stills here
            said = "document.querySelector('#streams [data-name=cam] .soft')?.textContent ?? ''"
            until_page(page, f"({said}).endsWith(' frames')")
            camera.pause()
            stream.act(Action.SILENCE)
            until_page(page, f"({said}).includes(', silent since ')")
            status = page.evaluate("fetch('/api/v1/status').then((answer) => answer.json())")
            (seen,) = (item for item in status["streams"] if item["name"] == "cam")
            came = station.app.state.broadcasts.get("streams/cam").newest_at
            assert datetime.fromisoformat(seen["silent_since"]).timestamp() == pytest.approx(came)
            stream.act(Action.HEAR)
            until_page(page, f"({said}).endsWith(' frames')")


def test_the_page_of_a_stream_that_is_silent_says_since_when(chromium, station):
    stream = station.app.state.streams.get("cam")
    with Camera(station) as camera:
        stream.act(Action.BEGIN)
        stream.act(Action.HEAR)
        with opened(chromium, f"http://{station.address}/watch/streams/cam") as page:
            state = "document.getElementById('state').textContent"
            message = "document.getElementById('message')"
            until_page(page, f"{state} === 'live' && {message}.hidden")
            camera.pause()
            stream.act(Action.SILENCE)
            said = f"{message}.textContent.startsWith('Nothing has arrived since ')"
            until_page(page, f"{state} === 'silent' && !{message}.hidden && {said}")
            camera.go_on()
            stream.act(Action.HEAR)
            until_page(page, f"{state} === 'live' && {message}.hidden")


def test_who_stands_on_a_stream_of_the_dashboard_is_left_there(chromium, station):
    with (
        Camera(station),
        opened(
            chromium,
            f"http://{station.address}/",
            errors=("404",),  # nobody makes stills here
        ) as page,
    ):
        link = page.locator("#streams [data-name=cam] a")
        link.focus()
        said = page.locator("#streams [data-name=cam] .soft").inner_text()
        assert said.startswith("0 viewers, ")
        numbers = "document.querySelector('#streams [data-name=cam] .soft').textContent"
        until_page(page, f"{numbers} !== '{said}'")
        assert page.evaluate("document.activeElement.textContent") == "cam"
