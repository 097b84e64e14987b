"""Where the frames of a job of the service go: the results, a lossless master, the tracks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from pipeline.errors import OutputError
from pipeline.export import Master
from pipeline.media.media_sink import MediaSink
from pipeline.media.video_format import VideoCodec
from pipeline.sink import OutputPlan, Sink
from pipeline.stereo import StereoLayout
from pipeline.tee_sink import TeeSink
from service.jobs.watch_sink import EyeSources, OnPiece, WatchSink, untold, watched_eyes
from service.live.track import Track

MASTER = "master.mkv"
"""Name of the lossless video in a job's folder that exports are made from."""

WATCH = "watch"
"""Name of the folder of the tracks in a job's folder."""


@dataclass(frozen=True, kw_only=True)
class JobSinks:
    """Makes the sink of a job of the service."""

    folder: Path
    """Of the job."""
    sources: EyeSources
    keep_master: bool
    on_piece: OnPiece = untold

    def __call__(self, plan: OutputPlan) -> Sink:
        """Return a sink that writes everything."""
        others: dict[str, Sink] = {
            "watch": WatchSink(plan, self.folder / WATCH, self.sources, self.on_piece)
        }
        if self.keep_master:
            others["master"] = MediaSink(master_plan(plan, self.folder / MASTER))
        return TeeSink(MediaSink(plan), others)


def master_in(folder: Path) -> Master:
    """Return the master of a finished job, which lies in the job's folder.

    Raises
    ------
    OutputError
        If there is none (any more).
    """
    info, path = Track(folder / WATCH / "result").info, folder / MASTER
    if info is None or not path.is_file():
        raise OutputError("there is no lossless master to export from")
    return Master(
        path=path, fps=info.rate, first_frame=info.first_frame,
        layout=StereoLayout(info.layout), pixel_aspect=Fraction(info.pixel_aspect),
    )  # fmt: skip


def master_plan(plan: OutputPlan, path: Path) -> OutputPlan:
    """Return the plan of the lossless video of both eyes, or of the one there is."""
    eyes = watched_eyes(plan)
    alone = StereoLayout.RIGHT if eyes[0] == plan.right else StereoLayout.LEFT
    options = replace(
        plan.options,
        output=path,
        layout=StereoLayout.SBS.value if len(eyes) == 2 else alone.value,
        codec=VideoCodec.FFV1.value,
        quality=None,
        frames_dir=None,
        report=None,
        debug_dir=None,
    )
    return replace(plan, options=options, targets=eyes)
