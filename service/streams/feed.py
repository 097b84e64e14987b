"""The way into a stream, as sources use it: the manifest now and then, and pictures."""

from __future__ import annotations

import json

from pipeline.media.live_frames import EncodedPicture
from pipeline.media.live_manifest import LiveManifest
from service.bus import keys
from service.bus.bus import JSON, Answer, Bus, Publisher
from service.bus.keys import Part
from service.streams.messages import InputHeader, write_input_header

MANIFEST_INTERVAL = 2.0
"""The manifest is sent again this often, for a service that comes later, seconds."""


class Feed:
    """Sends what cameras see into a stream, and answers who asks for its manifest.

    Parameters
    ----------
    bus : Bus
    stream : str
    manifest : LiveManifest
    """

    def __init__(self, bus: Bus, stream: str, manifest: LiveManifest) -> None:
        self._bus, self._stream, self._key = bus, stream, keys.manifest(stream)
        self._manifest = json.dumps(manifest.content).encode()
        self._publishers: dict[tuple[str, str, str], Publisher] = {}
        self._told = -MANIFEST_INTERVAL
        self.pictures = self.bytes = 0
        bus.answer(
            self._key,
            lambda question: [Answer(key=self._key, payload=self._manifest, encoding=JSON)],
        )

    def tell(self, now: float) -> None:
        """Send the manifest, if it was not sent for a while; ``now`` in seconds of any clock."""
        if now - self._told >= MANIFEST_INTERVAL:
            self._bus.put(self._key, self._manifest, encoding=JSON)
            self._told = now

    def put(self, view_id: str, part: Part, picture: EncodedPicture, header: bytes) -> None:
        """Send a picture."""
        self._publisher(view_id, part, picture).put(picture.data, header)
        self.pictures += 1
        self.bytes += len(picture.data)

    def _publisher(self, view_id: str, part: Part, picture: EncodedPicture) -> Publisher:
        """Return what sends on the picture's key with its encoding."""
        name = (view_id, part.value, picture.encoding.value)
        if name not in self._publishers:
            key = keys.input_key(self._stream, view_id, part)
            self._publishers[name] = self._bus.publisher(key, encoding=picture.encoding.value)
        return self._publishers[name]


def header_of(picture: EncodedPicture, *, frame_index: int, capture_time_ns: int) -> bytes:
    """Return what goes along with a picture."""
    return write_input_header(
        InputHeader(
            frame_index=frame_index, capture_time_ns=capture_time_ns,
            width=picture.width, height=picture.height, pixel_format=picture.pixel_format,
        )
    )  # fmt: skip
