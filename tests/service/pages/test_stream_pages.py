"""The page of a live stream in a real browser: beside bicubic, and through faults."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from pipeline.media.live_encode import LiveEncoder
from pipeline.stereo import StereoLayout
from service.config import ServiceConfig
from tests.service.http.test_watch import FPS, OnAir
from tests.service.pages.test_pages import _pixels, _until, opened


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


def _halves(page):
    shown = _pixels(page)
    assert shown.shape == (32, 32, 3)
    return int(shown[16, 4, 1]), int(shown[16, 28, 1])


def _until_together(page):
    """Wait until both halves show the same frame."""
    for _ in range(2000):
        before, result = _halves(page)
        if abs(before + result - 255) <= 3 and result < 128:
            return
        page.wait_for_timeout(20)
    raise AssertionError(f"bicubic shows {before}, the result {result}")


def test_a_live_stream_beside_bicubic_shows_the_same_frame(chromium, station):
    with Camera(station), opened(chromium, f"http://{station.address}/watch/streams/cam") as page:
        _until(page, "window.depthsrWatch.numbers().way === 'live'")
        _until(page, "window.depthsrWatch.numbers().drawn > 0")
        page.locator("text=Before and after").click()
        _until(page, "window.depthsrWatch.view.hasBefore")
        for _ in range(3):
            _until_together(page)
            shown = page.evaluate("window.depthsrWatch.numbers().shownFrame")
            _until(page, f"window.depthsrWatch.numbers().shownFrame > {shown + 5}")


def test_a_worker_that_is_started_anew_is_watched_on(chromium, station):
    with Camera(station) as camera, opened(
        chromium, f"http://{station.address}/watch/streams/cam"
    ) as page:  # fmt: skip
        _until(page, "window.depthsrWatch.numbers().drawn > 10")
        camera.pause()
        camera.begin_anew(100)
        camera.go_on()
        for _ in range(1000):
            if int(_pixels(page)[16, 16, 1]) > 125:
                break
            page.wait_for_timeout(20)
        drawn = page.evaluate("window.depthsrWatch.numbers().drawn")
        _until(page, f"window.depthsrWatch.numbers().drawn > {drawn + 10}")
        assert int(_pixels(page)[16, 16, 1]) > 125


def test_a_stream_that_is_stopped_and_made_again_is_watched_again(chromium, station):
    with opened(chromium, f"http://{station.address}/watch/streams/cam") as page:
        with Camera(station) as camera:
            _until(page, "window.depthsrWatch.numbers().drawn > 3")
            camera.pause()
            camera.end()
        _until(page, "document.getElementById('state').textContent !== 'live'")
        drawn = page.evaluate("window.depthsrWatch.numbers().drawn")
        with Camera(station):
            _until(page, f"window.depthsrWatch.numbers().drawn > {drawn + 3}")


def test_the_number_said_is_that_of_the_picture_drawn(chromium, station):
    """Whoever asks for a picture while others come may get an earlier one than the clock says."""
    with Camera(station), opened(chromium, f"http://{station.address}/watch/streams/cam") as page:
        _until(page, "window.depthsrWatch.numbers().drawn > 0")
        seen = page.evaluate(
            """async () => {
              const { view, videos, numbers } = window.depthsrWatch, { gl } = view;
              const pixel = new Uint8Array(4), seen = [];
              for (let time = 0; time < 150; time += 1) {
                videos.result.dispatchEvent(new Event("seeked"));
                gl.readPixels(16, 16, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
                const said = document.getElementById("time").textContent.split("frame ")[1];
                seen.push([numbers().shownFrame, Number(said), pixel[1]]);
                await new Promise((go) => setTimeout(go, 9));
              }
              return seen;
            }"""
        )
    assert len({frame for frame, _, _ in seen}) > 5
    assert [said for _, said, _ in seen] == [frame for frame, _, _ in seen]
    assert [round((level - 30) / 4) for _, _, level in seen] == [n % 17 for n, _, _ in seen]


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
        _until(page, f"{numbers} !== '{said}'")
        assert page.evaluate("document.activeElement.textContent") == "cam"
