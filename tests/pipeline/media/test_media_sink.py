"""What becomes of super-resolved frames in files."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import av
import cv2
import numpy as np
import pytest

from pipeline.colour import picture_from_rgb
from pipeline.config import Settings
from pipeline.job import OutputOptions, Segment
from pipeline.media.decode import VideoReader
from pipeline.media.media_sink import MediaSink
from pipeline.results import FrameReport, FrameResult, SuperResolvedImage, WholeColour
from pipeline.sink import OutputPlan

FRAMES = 4


def _plan(path, shape, **options) -> OutputPlan:
    return OutputPlan(
        options=OutputOptions(output=path, **options), targets=("a", "b"), left="a", right="b",
        hr_shape=shape, fps=Fraction(15), bit_depth=8, is_color=True, grid=Settings().grid,
        is_realtime=True,
    )  # fmt: skip


def _results(shape) -> list[FrameResult]:
    rows, columns = np.mgrid[: shape[0], : shape[1]]

    def eye(name, number):
        waves = [np.sin((columns + number) / 25), np.cos(rows / 37), np.sin((rows - columns) / 29)]
        rgb = (128 + 80 * np.stack(waves, axis=-1)).astype(np.uint8)
        picture = picture_from_rgb(rgb if name == "a" else rgb[::-1], 255.0)
        return SuperResolvedImage(
            view_id=name, luma=picture.luma, colour=WholeColour(chroma=picture.chroma)
        )

    report = FrameReport(
        frame_index=0, noise_sigma=1.0, noise_is_estimated=False, psf_sigma=1.0, psf_support=7,
        psf_is_estimated=False, targets=(), timings={}, warnings=(),
    )  # fmt: skip
    return [
        FrameResult(
            frame_index=number, images={name: eye(name, number) for name in "ab"},
            report=replace(report, frame_index=number),
        )
        for number in range(FRAMES)
    ]  # fmt: skip


def _written(plan, tmp_path, name):
    """Return the colour tags of a plan's video and its pictures, RGB, as a player gets them."""
    sink = MediaSink(replace(plan, options=replace(plan.options, output=tmp_path / name)))
    segment = Segment(index=0, start=0, stop=FRAMES)
    stem = tmp_path / f"segment-{name}"
    sink.write_segment(segment, stem, _results(plan.hr_shape))
    sink.join([stem])
    with av.open(str(tmp_path / name)) as container:
        context = container.streams.video[0].codec_context
        tags = (context.colorspace, context.color_range, context.color_primaries, context.pix_fmt)
    reader = VideoReader(tmp_path / name)
    pictures = [reader.picture(number) for number in range(FRAMES)]
    reader.close()
    return tags, pictures


@pytest.mark.parametrize(
    ("layout", "shape"),
    [("sbs", (48, 64)), ("sbs", (720, 64)), ("tab", (361, 63)), ("left", (47, 62))],
)
def test_what_is_coded_without_rgb_between_is_tagged_the_same_and_nearer_to_what_was_made(
    tmp_path, layout, shape
):
    plan = _plan(tmp_path / "o.mkv", shape, layout=layout, quality=1)
    if layout == "left":
        plan = replace(plan, targets=("a",))
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    by_rgb = replace(plan, options=replace(plan.options, frames_dir=pictures))
    tags, direct = _written(plan, tmp_path, "direct.mkv")
    expected_tags, by_way_of_rgb = _written(by_rgb, tmp_path, "rgb.mkv")
    assert tags == expected_tags
    assert len(list(pictures.glob("*.png"))) >= FRAMES, "pictures are RGB"
    eye = np.s_[: shape[0] - 4, : shape[1] - 4]  # the left one, but for where the other begins
    chroma = []
    for result, ours, theirs in zip(_results(shape), direct, by_way_of_rgb, strict=True):
        made = result.images["a"]
        of_luma, of_chroma = (
            [
                cv2.PSNR(getattr(picture, plane)[eye], getattr(made, plane)[eye], 255.0)
                for picture in (ours, theirs)
            ]
            for plane in ("luma", "chroma")
        )
        chroma.append(of_chroma)
        assert of_luma[0] > max(of_luma[1], 48)
        assert of_chroma[0] > 45
    # a rounding less, which in one frame of so few pixels may be chance
    assert np.mean(chroma, axis=0)[0] > np.mean(chroma, axis=0)[1]


def test_a_picture_shown_again_stays_what_it_was_beside_those_after_it(tmp_path):
    """Frames take one another's memory over, in the sink as in the encoder."""
    shape = (48, 64)
    plan = _plan(tmp_path / "o.mkv", shape, quality=1)
    results = _results(shape)
    shown = [results[0], replace(results[0], frame_index=1), results[2], results[3]]
    sink = MediaSink(plan)
    segment, stem = Segment(index=0, start=0, stop=FRAMES), tmp_path / "segment"
    sink.write_segment(segment, stem, shown)
    sink.join([stem])
    reader = VideoReader(tmp_path / "o.mkv")
    pictures = [reader.picture(number) for number in range(FRAMES)]
    reader.close()
    for result, picture in zip(shown, pictures, strict=True):
        made = np.hstack([result.images[name].luma for name in "ab"])
        assert cv2.PSNR(picture.luma, made, 255.0) > 45
