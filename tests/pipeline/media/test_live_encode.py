"""Live video: what is encoded comes back, frame by frame."""

from __future__ import annotations

from fractions import Fraction

import av
import cv2
import numpy as np

from pipeline.colour import picture_from_rgb
from pipeline.media.coded import coded_together
from pipeline.media.live_encode import LiveEncoder
from pipeline.media.ycbcr import HD_LINES, matrix_for
from pipeline.stereo import StereoLayout, pack

KEY = 3
FRAMES = 6


def eyes_of(number):
    """Return the eyes of a frame that is like no other, RGB."""
    rows, columns = np.mgrid[:48, :70]
    waves = [np.sin((columns + 9 * number) / 25), np.cos(rows / 37), np.sin((rows - columns) / 29)]
    left = (128 + 80 * np.stack(waves, axis=-1)).astype(np.uint8)
    return left, np.ascontiguousarray(left[::-1])


def decoded(pictures):
    """Return what a player shows of pictures, RGB, and which of them are key frames."""
    encoder = LiveEncoder(fps=Fraction(15), layout=StereoLayout.SBS, crf=1)
    units = [
        unit
        for number, picture in enumerate(pictures)
        for unit in encoder.encode(picture, number, key=number == KEY)
    ]
    encoder.close()
    player = av.CodecContext.create("h264", "r")
    shown = [frame for unit in units for frame in player.decode(av.Packet(unit.annex_b))]
    shown += player.decode(None)
    return [frame.to_ndarray(format="rgb24") for frame in shown], [unit.is_key for unit in units]


def test_planes_come_back_as_the_pictures_that_they_are_of():
    frames = [eyes_of(number) for number in range(FRAMES)]
    matrix = matrix_for(HD_LINES)
    planes = [
        coded_together(
            [(made.luma, made.chroma) for made in (picture_from_rgb(eye, 255.0) for eye in eyes)],
            matrix,
        )
        for eyes in frames
    ]
    of_planes, keys = decoded(planes)
    assert [number for number, is_key in enumerate(keys) if is_key] == [0, KEY]
    of_pictures, same_keys = decoded(pack(*eyes, StereoLayout.SBS, multiple=2) for eyes in frames)
    assert keys == same_keys
    assert len(of_planes) == len(of_pictures) == FRAMES
    for (left, right), ours, theirs in zip(frames, of_planes, of_pictures, strict=True):
        both = np.hstack([left, right])
        assert cv2.PSNR(ours, both) > 38
        assert cv2.PSNR(ours, both) > cv2.PSNR(theirs, both) - 0.5
