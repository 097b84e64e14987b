"""The text of HLS playlists (RFC 8216), from what is stored. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MediaSegment:
    """Fragments from one key frame to the next."""

    number: int
    duration: float
    """Seconds."""


def playlist(segments: Sequence[MediaSegment], *, ended: bool, growing: bool) -> str:
    """Return the media playlist.

    Parameters
    ----------
    segments : sequence of MediaSegment
        In order, without gaps.
    ended : bool
        Whether no segment will follow.
    growing : bool
        Whether all segments are kept (a job), so that a viewer may begin at the
        first; False for a window that moves on (a stream).
    """
    longest = max((segment.duration for segment in segments), default=1.0)
    lines = [
        "#EXTM3U",
        "#EXT-X-VERSION:7",
        f"#EXT-X-TARGETDURATION:{max(1, math.ceil(longest))}",
        f"#EXT-X-MEDIA-SEQUENCE:{segments[0].number if segments else 0}",
        "#EXT-X-INDEPENDENT-SEGMENTS",
    ]
    if growing:
        lines.append(f"#EXT-X-PLAYLIST-TYPE:{'VOD' if ended else 'EVENT'}")
    lines.append('#EXT-X-MAP:URI="init.mp4"')
    for segment in segments:
        lines += [f"#EXTINF:{segment.duration:.6f},", f"segment-{segment.number:06d}.m4s"]
    if ended:
        lines.append("#EXT-X-ENDLIST")
    return "\n".join(lines) + "\n"
