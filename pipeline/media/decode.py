"""Video files, decoded frame by frame with PyAV: the only reader that knows codecs.

Frames are numbered in presentation order from 0. All packets are listed once when a file is
opened (nothing is decoded for that), so the number of frames is known, a file that was cut
short is noticed, and any frame can be reached from the key frame before it.
"""

from __future__ import annotations

import threading
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import av.error
import av.video.frame
import numpy as np
import numpy.typing as npt

from pipeline.colour import Picture
from pipeline.errors import SceneError
from pipeline.media.colorimetry import HDR
from pipeline.media.decoded import colorimetry_of, picture_of, samples_of, stereo_tag
from pipeline.media.isobmff import holds_layers
from pipeline.media.video_format import HIGHEST_FPS

APPROACH = 2
"""Frames that are decoded at once, at most, of a video that is only drawn level with others."""

_UNEVEN = 0.5
"""Share of the usual time of a frame by which that of one differs where times are uneven."""

_SEEK_TRIES = 4
"""How many key frames further back are tried where seeking overshoots."""


class VideoReader:
    """The first video stream of a file, at random access.

    Sequential reading decodes each frame once. May be used from several threads; reads
    exclude each other.

    Raises
    ------
    SceneError
        If the file is missing, no video, or cut short.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.RLock()
        self._container = self._open()
        self._packets: Iterator[av.Packet] = iter(())
        self._decoded: deque[av.VideoFrame] = deque()
        self._next = 0
        self._place = 0
        """Of the next packet, in the order of decoding."""
        self._wanted = 0
        """Frame before which those that no other refers to are not decoded."""
        self._last: tuple[int, Picture] | None = None
        self.keeps_last = False
        """Whether the last picture is kept, for readers that each take a part of it."""
        try:
            self._prepare()
        except BaseException:
            self.close()
            raise

    def _open(self) -> av.container.InputContainer:
        try:
            # titles and the like, which nobody reads, may be of any encoding
            container = av.open(str(self.path), metadata_errors="replace")
        except FileNotFoundError as error:
            raise SceneError("the file is missing", path=self.path) from error
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise SceneError(
                f"cannot be opened as a video, or is cut short: {_said(error)}", path=self.path
            ) from error
        if not container.streams.video:
            container.close()
            raise SceneError("no video stream in this file", path=self.path)
        return container

    def _prepare(self) -> None:
        self._stream = self._container.streams.video[0]
        self._list_packets()
        self._restart()
        first = self._decode_next(0)
        stream = self._stream  # a stream must not be touched once its container is closed
        self._coded_size = int(first.width), int(first.height)
        self._turns = round(first.rotation / 90) % 4
        self.width, self.height = self._coded_size[:: -1 if self._turns % 2 else 1]
        components = first.format.components
        bits = max(component.bits for component in components)
        self.bit_depth = 8 if bits <= 8 else 10 if bits <= 10 else 16
        self.is_color = bool(first.format.is_rgb or len(components) >= 3)
        rate = stream.average_rate or stream.base_rate
        self.fps = rate_of(stream) or (Fraction(rate.numerator, rate.denominator) if rate else None)
        aspect = stream.sample_aspect_ratio
        self.pixel_aspect = Fraction(aspect.numerator, aspect.denominator) if aspect else None
        if self.pixel_aspect is not None and self._turns % 2:
            self.pixel_aspect = 1 / self.pixel_aspect
        told = {**self._container.metadata, **stream.metadata}
        self.timecode = next((told[key] for key in told if key.lower() == "timecode"), None)
        """Time code of the first frame, as the file says it."""
        self.stereo = stereo_tag(stream, first)
        self.colorimetry = colorimetry_of(first)
        self.holds_layers = (
            stream.codec_context.name == "hevc"
            and "mov" in self._container.format.name.split(",")
            and holds_layers(self.path)
        )
        """Whether a second view lies in layers that are not read (MV-HEVC)."""
        self.is_interlaced = bool(first.interlaced_frame)
        """Whether the two fields of a frame were taken one after the other."""
        self._decoded.appendleft(first)
        self._next = 0

    def _list_packets(self) -> None:
        stream = self._stream
        times: list[int] = []
        keys: list[int] = []
        timed = True
        end = packets = 0
        damaged = None
        try:
            for packet in self._container.demux(stream):
                if packet.size == 0:
                    continue
                packets += 1
                if packet.is_corrupt and damaged is None:
                    damaged = len(times)
                if packet.is_discard or _is_hidden(stream, packet):
                    continue
                if packet.pts is None:
                    timed = False
                    times.append(len(times))
                    continue
                times.append(packet.pts)
                end = max(end, packet.pts + (packet.duration or 0))
                if packet.is_keyframe:
                    keys.append(packet.pts)
        except av.error.FFmpegError as error:
            raise SceneError(
                f"cut short or damaged after {len(times)} frames: {_said(error)}", path=self.path
            ) from error
        if not times:
            raise SceneError("no frames in this video; is it cut short?", path=self.path)
        if damaged is not None:
            raise SceneError("cut short or damaged", path=self.path, frame=damaged)
        if packets < stream.frames:
            raise SceneError(
                f"cut short: it says {stream.frames} frames and holds {packets}", path=self.path
            )
        if not stream.frames and timed:
            self._check_duration(times, end)
        self._timed = timed and len(set(times)) == len(times)
        self._times = sorted(times) if self._timed else times
        self._places = np.argsort(times)
        """Of each frame's packet, in the order of decoding."""
        self._keys = sorted(keys)
        self.num_frames = len(times)
        self.has_uneven_times = self._timed and _are_uneven(self._times)
        """Whether frames are shown for unequal times, by more than rounding."""

    def _check_duration(self, times: list[int], end: int) -> None:
        """Complain where the last frame ends well before the file says that it does."""
        stated = _stated_duration(self._stream)
        base = self._stream.time_base
        if stated is None or base is None or end <= 0:
            return
        ends = float(end * base)  # from time 0, where the stated duration counts from
        frame = float((end - min(times)) * base) / len(times)
        if end == max(times):  # the last frame does not tell how long it lasts
            ends += frame
        if ends < stated - 0.75 * frame:
            raise SceneError(
                f"cut short: it says {stated:.2f} s and holds {ends:.2f} s", path=self.path
            )

    def _seek(self, index: int) -> None:
        """Make the decoder stand at or before frame ``index``."""
        stream = self._stream
        back = 0
        while self._timed and index > 0 and self._keys:
            at = bisect_right(self._keys, self._times[index]) - 1 - back
            if at < 0 or back >= _SEEK_TRIES:
                break
            self._container.seek(self._keys[at], stream=stream, backward=True)
            self._begin(index)
            try:
                while not self._decoded and self._decode_packet():
                    pass
            except av.error.FFmpegError:
                break
            if not self._decoded:
                break
            position = self._position(self._decoded[0])
            if position is not None and position <= index:
                self._next = position
                return
            back += 1
        self._restart()

    def _restart(self) -> None:
        """Make the decoder stand at frame 0, with nothing of its past."""
        self._container.close()
        self._container = self._open()
        self._stream = self._container.streams.video[0]
        self._stream.thread_type = "AUTO"
        self._begin(0)
        self._next = 0

    def _begin(self, wanted: int) -> None:
        """Take packets from where the container stands, for the sake of frame ``wanted``."""
        self._packets = self._container.demux(self._stream)
        self._decoded.clear()
        self._wanted = wanted
        self._place = 0

    def _position(self, coded: av.VideoFrame | av.Packet) -> int | None:
        """Return the number of a frame by its time; None: it has no place."""
        if coded.pts is None:
            return None
        at = bisect_left(self._times, coded.pts)
        return at if at < len(self._times) and self._times[at] == coded.pts else None

    def _decode_packet(self) -> bool:
        """Decode the next packet; return False where there is none.

        A frame before the wanted one is decoded only if the codec says that others refer to it.
        """
        packet = next(self._packets, None)
        if packet is None:
            return False
        position = self._position(packet) if self._timed else None
        is_passed = position is not None and position < self._wanted
        self._stream.codec_context.skip_frame = "NONREF" if is_passed else "DEFAULT"
        self._decoded += packet.decode()
        if position is not None:
            self._place = int(self._places[position]) + 1
        return True

    def _decode_next(self, index: int) -> av.VideoFrame:
        """Return frame ``index``, decoding on from where the decoder stands."""
        self._wanted = index
        while True:
            while not self._decoded:
                self._decode_on(index)
            frame = self._decoded.popleft()
            position = self._position(frame) if self._timed else self._next
            if position is None:
                continue
            self._next = position + 1
            if position < index:
                continue
            if position > index or frame.is_corrupt:
                raise SceneError("cannot be decoded", path=self.path, frame=index)
            return frame

    def _decode_on(self, index: int) -> None:
        """Decode a packet on the way to frame ``index``; raise SceneError where that fails."""
        try:
            is_there = self._decode_packet()
        except av.error.FFmpegError as error:
            raise SceneError(
                f"cannot be decoded: {_said(error)}", path=self.path, frame=index
            ) from error
        if not is_there:
            raise SceneError("the video ends early; is it cut short?", path=self.path, frame=index)

    def _frame(self, index: int) -> av.VideoFrame:
        if not 0 <= index < self.num_frames:
            raise SceneError(
                f"no such frame; the file holds {self.num_frames}", path=self.path, frame=index
            )
        if not self._way_to(index)[1]:
            self._seek(index)
        frame = self._decode_next(index)
        if (frame.width, frame.height) != self._coded_size:
            raise SceneError(
                f"changes its size to {frame.width}×{frame.height}", path=self.path, frame=index
            )
        if (int(frame.color_trc) in HDR) != self.colorimetry.is_hdr:
            kind = "ordinary" if self.colorimetry.is_hdr else "high"
            raise SceneError(f"changes to {kind} dynamic range", path=self.path, frame=index)
        return frame

    def _way_to(self, index: int) -> tuple[int, bool]:
        """Return the first frame that has to be decoded before ``index`` can be, or itself.

        That is the next one, unless a key frame lies ahead that spares decoding up to it, or
        ``index`` lies behind. With whether it is the next one.
        """
        at = bisect_right(self._keys, self._times[index]) - 1 if self._timed else -1
        key = bisect_left(self._times, self._keys[at]) if at >= 0 else 0
        is_next = key <= self._next <= index and self._wanted <= index
        return (self._next if is_next else key), is_next

    def picture(self, index: int, *, with_chroma: bool = True) -> Picture:
        """Return frame ``index`` (0-based, presentation order) as luma and, if wanted, chroma.

        The matrix and range the file is tagged with are honoured, and by how many quarters it is
        to be turned; without a tag the former are taken as for raw video (BT.709 from 720 lines
        up, limited; grey is full).
        """
        with self._lock:
            if self._last is not None and self._last[0] == index:
                return self._last[1]
            self._last = None
            picture = picture_of(self._frame(index), with_chroma or self.keeps_last)
            picture = _turned_picture(picture, self._turns)
            if self.keeps_last:
                self._last = (index, picture)
            return picture

    def samples(self, index: int) -> npt.NDArray:
        """Return the first plane of frame ``index`` as stored numbers: (H, W), for depth.

        Limited range is stretched to full only where the file is tagged with it.
        """
        with self._lock:
            return _turned(samples_of(self._frame(index), self.path), self._turns)

    def approach(self, index: int) -> bool:
        """Decode a few of the frames that frame ``index`` needs, and convert nothing.

        What no other frame refers to is left out.

        Returns
        -------
        bool
            Whether all of them are decoded, so that frame ``index`` itself is next.
        """
        with self._lock:
            first, is_next = self._way_to(index)
            soon = min(index, first + APPROACH)
            if not self._timed:
                if soon > first:
                    self._frame(soon - 1)
                return soon == index
            if not is_next:
                self._seek(first)
            self._wanted = index
            while self._place < self._places[soon]:
                self._decode_on(index)
            while self._decoded and (self._position(self._decoded[0]) or 0) < index:
                self._decoded.popleft()
            self._next = soon
            return soon == index

    def stored(self, index: int) -> npt.NDArray:
        """Return frame ``index`` of an RGB or grey video as it is stored, nothing computed.

        Returns
        -------
        ndarray of shape (H, W, 3) RGB or (H, W) grey, uint8 or uint16
        """
        with self._lock:
            frame = self._frame(index)
            deep = max(component.bits for component in frame.format.components) > 8
            if frame.format.name.startswith("gray"):
                return frame.to_ndarray(format="gray16le" if deep else "gray")
            if not frame.format.is_rgb:
                raise SceneError(f"{frame.format.name} is not stored as RGB", path=self.path)
            return frame.to_ndarray(format="rgb48le" if deep else "rgb24")

    def close(self) -> None:
        """Close the file; may be called twice."""
        with self._lock:
            self._packets = iter(())
            self._decoded.clear()
            self._last = None
            self._container.close()


def rate_of(stream: av.VideoStream) -> Fraction | None:
    """Return the frames a second that a file or a camera tells; ticks of its clock are none."""
    for rate in (stream.average_rate, stream.guessed_rate):
        if rate and rate <= HIGHEST_FPS:
            return Fraction(rate.numerator, rate.denominator)
    return None


def _said(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _is_hidden(stream: av.VideoStream, packet: av.Packet) -> bool:
    """Tell whether a packet is a VP8 frame that is never shown (RFC 6386, §9.1)."""
    return stream.codec_context.name == "vp8" and not bytes(packet)[0] & 0x10


def _are_uneven(times: Sequence[int]) -> bool:
    """Return whether times, in order, are at distances that differ by more than rounding."""
    apart = np.diff(times)
    usual = np.median(apart) if apart.size else 0
    return bool((np.abs(apart - usual) > _UNEVEN * usual).any())


def _stated_duration(stream: av.VideoStream) -> float | None:
    """Return the duration in seconds that the file states for its video, if it does."""
    text = stream.metadata.get("DURATION") or stream.metadata.get("duration")
    if text:
        try:
            hours, minutes, seconds = text.split(":")
            return int(hours) * 3600 + int(minutes) * 60 + float(seconds)
        except ValueError:
            return None
    if stream.duration and stream.time_base:
        return float(stream.duration * stream.time_base)
    container = stream.container
    if isinstance(container, av.container.InputContainer) and len(container.streams) == 1:
        return container.duration / av.time_base if container.duration else None
    return None


def _turned_picture(picture: Picture, turns: int) -> Picture:
    """Return the picture turned by so many quarters, counter-clockwise."""
    if not turns:
        return picture
    chroma = None if picture.chroma is None else _turned(picture.chroma, turns)
    return Picture(luma=_turned(picture.luma, turns), chroma=chroma)


def _turned(samples: npt.NDArray, turns: int) -> npt.NDArray:
    return np.ascontiguousarray(np.rot90(samples, turns)) if turns else samples
