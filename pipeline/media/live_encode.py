"""Live video out: one encoder whose packets serve every way of watching.

A frame goes in, its access unit comes out at once: as H.264 byte stream with
the parameter sets before each key frame (ITU-T H.264 Annex B, for zenoh), and
one frame later as fragment of an MP4 (ISO/IEC 14496-12, for browsers; a
fragment needs the time of the frame after it). There are no B-frames, and a
key frame comes at least once a second, so that who joins late waits that long
at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import av

from pipeline.errors import OutputError
from pipeline.media.colorimetry import Colorimetry
from pipeline.media.encode import write_planes
from pipeline.media.files import Outlet
from pipeline.media.ycbcr import HD_LINES, MATRIX_CODES, Yuv420, matrix_for, to_yuv420
from pipeline.stereo import Picture, StereoLayout

_LIMITED = 1
"""Of FFmpeg's ranges."""

_MUXER = {
    "movflags": "+frag_every_frame+empty_moov+default_base_moof+frag_discont",
    "use_editlist": "0",
    "avoid_negative_ts": "make_non_negative",  # with frag_discont: times need not begin at 0
    "flush_packets": "1",
    "fflags": "+bitexact",
}


@dataclass(frozen=True, kw_only=True)
class AccessUnit:
    """One coded frame."""

    frame_index: int
    """Of the source."""
    is_key: bool
    annex_b: bytes
    """With start codes; a key frame brings its parameter sets along."""


class LiveEncoder:
    """H.264 for people who watch now; the size is that of the first picture.

    Parameters
    ----------
    fps : Fraction
        Of the source, > 0; frame n is shown at (n − begin) / fps.
    layout : StereoLayout
        What the pictures hold; packed ones are signalled by the frame-packing
        message (ITU-T H.264 D.1.26).
    crf : int
        Quality of x264, 0 (lossless) … 51.
    preset : str
        Of x264. ``superfast`` codes 2048×768 at 80 frames a second on two cores.
    colorimetry : Colorimetry, optional
        What is said of the pictures' RGB; BT.709 if left out.
    begin : int, optional
        Index of the frame that has time 0, no later than the first one, which it is if left out.

    Examples
    --------
    >>> encoder = LiveEncoder(fps=Fraction(15), layout=StereoLayout.SBS)
    >>> unit = encoder.encode(np.zeros((32, 64, 3), np.uint8), 0)[0]
    >>> unit.is_key, unit.frame_index
    (True, 0)
    >>> encoder.close()
    """

    def __init__(
        self, *, fps: Fraction, layout: StereoLayout, crf: int = 20, preset: str = "superfast",
        colorimetry: Colorimetry | None = None, begin: int | None = None,
    ) -> None:  # fmt: skip
        if fps <= 0:
            raise OutputError(f"a live stream of {fps} frames a second: give a rate above 0")
        self._fps = fps
        self._layout = layout
        self._crf = crf
        self._preset = preset
        self._colorimetry = colorimetry or Colorimetry()
        # the same at all sizes: browsers read the tag
        self._matrix = matrix_for(HD_LINES, self._colorimetry.primaries)
        self._outlet = Outlet()
        self._container: Any = None
        self._stream: Any = None
        self._frame: Any = None
        self._shape: tuple[int, ...] | None = None
        self._begin: Any = begin
        self._last = -1

    def encode(
        self, picture: Picture | Yuv420, frame_index: int, *, key: bool = False
    ) -> Sequence[AccessUnit]:
        """Code one picture and return what is ready: its own access unit.

        Parameters
        ----------
        picture : ndarray of shape (H, W, 3) or (H, W), uint8 or uint16, or Yuv420
            Packed as the layout says; H and W even. An array is of full range, planes are of the
            matrix of high definition.
        frame_index : int
            Of the source, above the one before; gaps are lost frames.
        key : bool
            Whether this frame must be a key frame.

        Raises
        ------
        OutputError
            If the picture's size is odd or differs from the first one's, or
            the frame index does not grow.
        """
        if self._shape is None:
            self._open(picture, frame_index)
            self._shape = picture.shape
        if picture.shape != self._shape:
            raise OutputError(
                f"frame {frame_index} is {picture.shape[1]}×{picture.shape[0]}, the live stream "
                f"is {self._shape[1]}×{self._shape[0]}; begin a new stream"
            )
        if frame_index <= self._last:
            raise OutputError(f"frame {frame_index} comes after frame {self._last}; drop it")
        self._last = frame_index
        if isinstance(picture, Yuv420):
            planes = picture.planes
        else:
            planes = to_yuv420(picture, self._matrix, coded_bits=8)
        frame = self._frame
        write_planes(frame, planes)
        frame.pts = frame_index - self._begin
        frame.time_base = 1 / self._fps
        kinds = av.video.frame.PictureType
        frame.pict_type = kinds.I if key else kinds.NONE
        return self._mux(self._stream.encode(frame))

    def take_mp4(self) -> bytes:
        """Return the bytes of the fragmented MP4 written since the last call."""
        return self._outlet.take()

    def close(self) -> None:
        """Write the last fragment; may be called twice."""
        if self._container is not None:
            self._mux(self._stream.encode(None))
            container, self._container = self._container, None
            container.close()

    def _open(self, picture: Picture | Yuv420, frame_index: int) -> None:
        height, width = picture.shape[:2]
        if height % 2 or width % 2:
            raise OutputError(f"a live picture of {width}×{height}: pad it to even sides")
        self._begin = frame_index if self._begin is None else self._begin
        self._frame = av.VideoFrame(width, height, "yuv420p")
        self._container = av.open(self._outlet, "w", format="mp4", options=dict(_MUXER))
        parameters = ["scenecut=0"]
        if self._layout.packed:
            parameters.append(f"frame-packing={3 if self._layout.side_by_side else 4}")
        interval = max(1, int(self._fps))
        options = {
            "preset": self._preset, "tune": "zerolatency", "crf": str(self._crf), "bf": "0",
            "g": str(interval), "forced-idr": "1", "x264-params": ":".join(parameters),
        }  # fmt: skip
        self._stream = self._container.add_stream("libx264", rate=self._fps, options=options)
        context = self._stream.codec_context
        context.width, context.height, context.pix_fmt = width, height, "yuv420p"
        context.time_base = 1 / self._fps
        context.color_range = _LIMITED
        context.colorspace = MATRIX_CODES[self._matrix]
        context.color_primaries = self._colorimetry.primaries
        context.color_trc = self._colorimetry.transfer

    def _mux(self, packets: Sequence[Any]) -> list[AccessUnit]:
        units = []
        for packet in packets:
            data = bytes(packet)
            if packet.is_keyframe:
                data = bytes(self._stream.codec_context.extradata or b"") + data
            units.append(
                AccessUnit(
                    frame_index=self._begin + packet.pts,
                    is_key=bool(packet.is_keyframe),
                    annex_b=data,
                )
            )
            packet.duration = 1
            self._container.mux(packet)
        return units
