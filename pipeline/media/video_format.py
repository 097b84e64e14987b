"""What kind of video file is written: container, codec, layout, rate and quality."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from fractions import Fraction
from pathlib import Path

from pipeline.errors import ConfigurationError
from pipeline.media.colorimetry import Colorimetry
from pipeline.stereo import StereoLayout


class Container(StrEnum):
    """The kinds of file, by their suffix."""

    MP4 = "mp4"
    MKV = "mkv"
    WEBM = "webm"
    MOV = "mov"


class VideoCodec(StrEnum):
    """How pictures are compressed."""

    H264 = "h264"
    """Plays nearly everywhere; carries the stereo layout in the stream itself."""

    HEVC = "hevc"
    """What headsets, televisions and HDR ask for, above all at large sizes; 10 bits, always."""

    VP9 = "vp9"
    """Free of licences; plays in browsers. 8 bits here, whatever the source has."""

    AV1 = "av1"
    """Free of licences, smallest files, young players."""

    FFV1 = "ffv1"
    """Lossless: every sample comes back, 8 and 16 bits, grey and RGB, any size."""

    PRORES = "prores"
    """What editors cut: ProRes 422 HQ, 10 bits, whatever the source has."""


CODECS = {
    Container.MP4: (VideoCodec.H264, VideoCodec.HEVC, VideoCodec.AV1, VideoCodec.VP9),
    Container.MKV: (
        VideoCodec.H264,
        VideoCodec.HEVC,
        VideoCodec.AV1,
        VideoCodec.VP9,
        VideoCodec.FFV1,
        VideoCodec.PRORES,
    ),
    Container.WEBM: (VideoCodec.VP9, VideoCodec.AV1),
    Container.MOV: (VideoCodec.PRORES, VideoCodec.H264, VideoCodec.HEVC),
}
"""What each container can hold; the first is its default."""

DEFAULT_CRF = {
    VideoCodec.H264: 8, VideoCodec.HEVC: 10, VideoCodec.VP9: 4, VideoCodec.AV1: 3,
}  # fmt: skip
"""Constant rate factor that keeps flat colours and ramps within a code value; lower is better and
larger."""

HIGHEST_CRF = {
    VideoCodec.H264: 51, VideoCodec.HEVC: 51, VideoCodec.VP9: 63, VideoCodec.AV1: 63,
}  # fmt: skip

HIGHEST_FPS = 500
"""Frames a second; Matroska's clock ticks in milliseconds."""


def container_of(path: Path) -> Container:
    """Return the kind of file that a name asks for.

    Raises
    ------
    ConfigurationError
        If the suffix is none of ``.mp4``, ``.mkv``, ``.webm`` and ``.mov``.
    """
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in list(Container):
        known = ", ".join(f".{container}" for container in Container)
        raise ConfigurationError(
            f"{path}: {'.' + suffix if suffix else 'no suffix'}: "
            f"the name of a video must end in one of {known}"
        )
    return Container(suffix)


@dataclass(frozen=True, kw_only=True)
class VideoFormat:
    """The kind of video file a job writes, the same for all its segments.

    Raises
    ------
    ConfigurationError
        If the container cannot hold the codec (both are named), or a number is
        out of range.
    """

    container: Container
    codec: VideoCodec
    layout: StereoLayout
    fps: Fraction
    """Frames a second, above 0, up to 500."""
    crf: int | None = None
    """Constant rate factor, 1..51 (h264, hevc) or 1..63 (vp9, av1); None: the default. Not for
    ffv1 and prores."""
    pixel_aspect: Fraction = Fraction(1)
    """Width over height of a pixel of one eye, before a layout squeezes it."""
    colorimetry: Colorimetry = field(default_factory=Colorimetry)
    """What is said of the pictures' RGB."""
    is_quick: bool = False
    """Whether H.264 is coded in less than half the time, as good, into larger files."""

    def __post_init__(self) -> None:
        if self.codec not in CODECS[self.container]:
            can = ", ".join(CODECS[self.container])
            raise ConfigurationError(
                f"a .{self.container} file cannot hold {self.codec} video: choose {can}, "
                f"or another kind of file"
            )
        if not 0 < self.fps <= HIGHEST_FPS:
            raise ConfigurationError(
                f"frame rate must be above 0, up to {HIGHEST_FPS} a second, not {self.fps}"
            )
        if self.crf is not None:
            highest = HIGHEST_CRF.get(self.codec)
            if highest is None:
                raise ConfigurationError(f"--crf: {self.codec} has one quality and takes none")
            if not 1 <= self.crf <= highest:
                raise ConfigurationError(
                    f"--crf: must be 1 to {highest} for {self.codec}, not {self.crf}"
                )

    @classmethod
    def for_path(
        cls,
        path: Path,
        *,
        layout: StereoLayout,
        fps: Fraction,
        codec: VideoCodec | None = None,
        crf: int | None = None,
        pixel_aspect: Fraction = Fraction(1),
        colorimetry: Colorimetry | None = None,
        is_quick: bool = False,
    ) -> VideoFormat:
        """Return the format that a file name asks for.

        Raises
        ------
        ConfigurationError
            As :func:`container_of`, and as the class.

        Examples
        --------
        >>> VideoFormat.for_path(
        ...     Path("out.webm"), layout=StereoLayout.SBS, fps=Fraction(24)
        ... ).codec.value
        'vp9'
        """
        container = container_of(path)
        codec = codec or CODECS[container][0]
        return cls(
            container=container,
            codec=codec,
            layout=layout,
            fps=fps,
            crf=crf,
            pixel_aspect=pixel_aspect,
            colorimetry=colorimetry or Colorimetry(),
            is_quick=is_quick,
        )

    @property
    def lossless(self) -> bool:
        """Whether every sample comes back."""
        return self.codec is VideoCodec.FFV1

    @property
    def quality(self) -> int | None:
        """The constant rate factor in use; None where the codec has none."""
        return self.crf if self.crf is not None else DEFAULT_CRF.get(self.codec)

    def coded_bits(self, source_bits: int) -> int:
        """Return the bits a sample that the file keeps of a source of 8 or 16 bits."""
        if self.codec in (VideoCodec.HEVC, VideoCodec.PRORES):
            return 10
        if source_bits == 8 or self.codec is VideoCodec.VP9:
            return 8
        return 16 if self.lossless else 10


def lost_of_hdr(path: Path | None, codec: str | None, layout: str) -> tuple[str, ...]:
    """Return what does not come out right of high dynamic range, a sentence each.

    Parameters
    ----------
    path : Path or None
        The video, if one is written.
    codec : str or None
        None: the container's first.
    layout : str
    """
    lost = []
    if layout == StereoLayout.ANAGLYPH:
        lost.append(
            "anaglyph mixes the eyes as if they were of ordinary range, not of high dynamic range"
        )
    if path is not None and (codec or CODECS[container_of(path)][0]) == VideoCodec.VP9:
        lost.append(f"{path}: vp9 keeps 8 bits, few for high dynamic range: av1 keeps 10")
    return tuple(lost)


_NAME_TOKENS = {
    StereoLayout.SBS: "_3D_SBS_LR",
    StereoLayout.HALF_SBS: "_3D_HSBS_LR",
    StereoLayout.TAB: "_3D_TAB",
    StereoLayout.HALF_TAB: "_3D_HTAB",
    StereoLayout.ANAGLYPH: "_anaglyph",
    StereoLayout.LEFT: "_left",
    StereoLayout.RIGHT: "_right",
    StereoLayout.VIEWS: "",
}
"""Marks that Kodi, Jellyfin and the players of headsets read in file names."""


def suggested_name(stem: str, layout: StereoLayout, container: Container = Container.MKV) -> str:
    """Return a file name by which players know the layout, for users who give a folder.

    Examples
    --------
    >>> suggested_name("clip", StereoLayout.SBS)
    'clip_3D_SBS_LR.mkv'
    """
    return f"{stem}{_NAME_TOKENS[layout]}.{container}"


def video_paths(path: Path, layout: StereoLayout, view_ids: Sequence[str]) -> dict[str, Path]:
    """Return where a video goes by view id; one file of all views has the id ''."""
    if layout is StereoLayout.VIEWS:
        return {view_id: view_path(path, view_id) for view_id in view_ids}
    return {"": path}


def view_path(path: Path, view_id: str) -> Path:
    """Return where one view goes when every view gets a file of its own.

    Examples
    --------
    >>> view_path(Path("out/clip.mkv"), "cam3").as_posix()
    'out/clip.cam3.mkv'
    """
    return path.with_name(f"{path.stem}.{view_id}{path.suffix}")
