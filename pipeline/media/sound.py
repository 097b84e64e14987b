"""Sound beside the pictures of a video."""

from __future__ import annotations

from pathlib import Path

import av


def has_sound(path: Path) -> bool:
    """Tell whether a video file, which was opened before, holds sound."""
    with av.open(str(path)) as container:
        return bool(container.streams.audio)
