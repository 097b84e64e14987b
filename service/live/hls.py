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
    generation: int = 0
    """Number of its init segment; another one than before is another kind of video."""


def playlist(
    segments: Sequence[MediaSegment], *, ended: bool, growing: bool, longest: float = 1.0
) -> str:
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
    longest : float
        No segment will be longer, seconds; where one is, that counts.
    """
    longest = max([longest, *(segment.duration for segment in segments)])
    lines = [
        "#EXTM3U",
        "#EXT-X-VERSION:7",
        f"#EXT-X-TARGETDURATION:{max(1, math.ceil(round(longest, 3)))}",
        f"#EXT-X-MEDIA-SEQUENCE:{segments[0].number if segments else 0}",
        "#EXT-X-INDEPENDENT-SEGMENTS",
    ]
    if segments and segments[0].generation:
        lines.insert(4, f"#EXT-X-DISCONTINUITY-SEQUENCE:{segments[0].generation}")
    if growing:
        lines.append(f"#EXT-X-PLAYLIST-TYPE:{'VOD' if ended else 'EVENT'}")
    generation = None
    for segment in segments:
        if segment.generation != generation:
            if generation is not None:
                lines.append("#EXT-X-DISCONTINUITY")
            generation = segment.generation
            lines.append(f'#EXT-X-MAP:URI="init-{generation}.mp4"')
        lines += [f"#EXTINF:{segment.duration:.6f},", f"segment-{segment.number:06d}.m4s"]
    if ended:
        lines.append("#EXT-X-ENDLIST")
    return "\n".join(lines) + "\n"
