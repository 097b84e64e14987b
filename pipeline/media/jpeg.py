"""Small pictures for people who look at once: JPEG."""

from __future__ import annotations

import cv2

from pipeline.errors import OutputError
from pipeline.stereo import Picture


def encode_jpeg(picture: Picture, *, quality: int = 85, max_width: int | None = None) -> bytes:
    """Return a picture as baseline JPEG.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3) RGB or (H, W) grey, uint8
    quality : int
        1..100.
    max_width : int, optional
        A wider picture is made so wide, by area averaging, with its shape kept.

    Raises
    ------
    OutputError
        If the encoder does not take the picture.
    """
    height, width = picture.shape[:2]
    if max_width is not None and width > max_width:
        size = (max_width, max(1, round(height * max_width / width)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    bgr = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    done, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise OutputError(f"no JPEG can hold an array of shape {picture.shape}, {picture.dtype}")
    return encoded.tobytes()
