"""A stream on air in this process."""

from __future__ import annotations

import threading
from fractions import Fraction

import httpx
import numpy as np
import uvicorn

from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_encode import LiveEncoder
from pipeline.stereo import StereoLayout
from service.app import create_app
from service.config import ServiceConfig
from tests.support.waiting import PATIENCE

FPS = Fraction(15)


class OnAir:
    """The application in this process, with a stream that a test feeds."""

    def __init__(self, config: ServiceConfig) -> None:
        self.app = create_app(config)
        self.server = uvicorn.Server(
            uvicorn.Config(self.app, port=0, log_config=None, ws_per_message_deflate=False)
        )
        self.thread = threading.Thread(target=self.server.run)
        self.encoder = LiveEncoder(fps=FPS, layout=StereoLayout.SBS)
        self.picture = np.random.default_rng(1).integers(0, 256, (32, 64, 3), np.uint8)
        self.number = 0

    def __enter__(self):
        self.thread.start()
        with httpx.Client(timeout=PATIENCE) as client:
            while not self.server.started:
                assert self.thread.is_alive()
                threading.Event().wait(0.02)
            port = self.server.servers[0].sockets[0].getsockname()[1]
            self.address = f"127.0.0.1:{port}"
            assert client.get(f"http://{self.address}/healthz").status_code == 200
        self.broadcast = self.app.state.broadcasts.open(
            "streams/room", fps=FPS, layout=StereoLayout.SBS
        )
        return self

    def __exit__(self, *_):
        self.encoder.close()
        self.server.should_exit = True
        self.app.state.notices.stop()
        self.app.state.broadcasts.stop()
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()

    def feed(self, count: int) -> None:
        for _ in range(count):
            picture = np.roll(self.picture, self.number, 1)
            self.encoder.encode(picture, self.number)
            self.broadcast.feed(self.encoder.take_mp4())
            self.broadcast.show(encode_jpeg(picture))
            self.number += 1
