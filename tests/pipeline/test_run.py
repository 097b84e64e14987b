from __future__ import annotations

import dataclasses
import json
import os
import sys
import threading
import time
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.background import BEHIND, LEAST
from pipeline.baselines import bicubic
from pipeline.config import Settings
from pipeline.effort import FULL, SWIFT, Effort
from pipeline.errors import ConfigurationError, Interrupted, OutputError, SceneError
from pipeline.events import FrameFinished, JobFinished, JobStarted, SegmentFinished, Warned
from pipeline.frames import MultiViewFrame, View
from pipeline.job import FrameRange, InputOptions, Job, OutputOptions, cut_segments
from pipeline.line import highest_at_hand
from pipeline.media.source import MemorySource
from pipeline.results import FrameReport, FrameResult, SuperResolvedImage
from pipeline.run import Tools, check_outputs, run_job
from pipeline.sink import MemorySink
from pipeline.stop import StopFlag
from pipeline.workfolder import work_folder_of

FIRST_FRAME = 5


def _frames(count: int, *, views: int = 3, height: int = 12, width: int = 18) -> list:
    rng = np.random.default_rng(4)
    return [
        MultiViewFrame(
            frame_index=FIRST_FRAME + number,
            views=tuple(
                View(
                    view_id=f"cam{view}",
                    luma=rng.integers(0, 256, (height, width)).astype(np.float32),
                    depth_is_estimated=view == 1,
                    depth_map=np.ones((height, width), np.float32) if view else None,
                )
                for view in range(views)
            ),
            left="cam0",
            right="cam1",
        )
        for number in range(count)
    ]


def enlarge(frame, settings, *, targets, observed_views=None, keep_intermediates=False):
    """A super-resolution that costs nothing: bicubic."""
    images = {
        view_id: SuperResolvedImage(
            view_id=view_id, luma=bicubic(frame.view(view_id).luma, settings.grid)
        )
        for view_id in targets
    }
    report = FrameReport(
        frame_index=frame.frame_index,
        noise_sigma=float("nan"),
        noise_is_estimated=True,
        psf_sigma=1.0,
        psf_support=7,
        psf_is_estimated=False,
        targets=(),
        timings={"reconstruction": 0.25},
        warnings=("the same warning every time",),
    )
    return FrameResult(frame_index=frame.frame_index, images=images, report=report)


def worker(compute):
    """Return what makes workers whose second half is ``compute`` and whose first does nothing."""

    class Simple:
        lacks_motions = stands = finds_motions = False

        def __init__(self, settings, *, stop, **arguments):
            self.settings, self.arguments = settings, arguments

        def reset(self):
            pass

        def register(self, frame, *, neighbours):
            return frame

        def reconstruct(self, registered):
            return compute(registered, self.settings, **self.arguments)

    return Simple


def _tools(frames, *, sinks: list | None = None, pixel_aspect=Fraction(1), **other) -> Tools:
    def open_scene(path, *, views=None, **_):
        source = MemorySource(frames, path=str(path), pixel_aspect=pixel_aspect)
        if views is not None:
            known = dict(zip(source.info.view_ids, source.info.has_depth, strict=True))
            source.info = dataclasses.replace(
                source.info,
                view_ids=tuple(views),
                has_depth=tuple(known[view_id] for view_id in views),
            )
        return source

    def make_sink(plan):
        sink = MemorySink(plan)
        (sinks if sinks is not None else []).append(sink)
        return sink

    parts = {"open_scene": open_scene, "make_worker": worker(enlarge), "make_sink": make_sink}
    return Tools(**parts | other)


def _job(folder: Path, **options) -> Job:
    scene = folder / "scene.json"
    if not scene.exists():
        scene.write_text("{}")
    settings = options.pop("settings", Settings())
    names = {field.name for field in dataclasses.fields(InputOptions)}
    given = {name: options.pop(name) for name in list(options) if name in names}
    output = OutputOptions(**{"output": folder / "out.mkv", "segment_length": 2, **options})
    return Job(scene=scene, settings=settings, input=InputOptions(**given), output=output)


def _numbers(path: Path) -> list[int]:
    return [int(line) for line in path.read_text().split()]


def test_all_frames_come_out_in_order_and_the_work_folder_is_gone(tmp_path):
    events, sinks = [], []
    job = _job(tmp_path, report=tmp_path / "report.json")
    summary = run_job(job, on_event=events.append, tools=_tools(_frames(5), sinks=sinks))
    assert _numbers(tmp_path / "out.mkv") == [5, 6, 7, 8, 9]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "out.mkv", "report.json", "scene.json",
    ]  # fmt: skip
    assert summary.frames == summary.frames_computed == 5
    assert [type(event) for event in (events[0], events[-1])] == [JobStarted, JobFinished]
    assert events[-1].timings == summary.report["timings"]
    finished = [event.frame_index for event in events if isinstance(event, FrameFinished)]
    assert finished == [5, 6, 7, 8, 9]
    assert [event.index for event in events if isinstance(event, SegmentFinished)] == [0, 1, 2]
    assert len([event for event in events if isinstance(event, Warned)]) == 1
    assert sinks[0].plan.hr_shape == (24, 36)
    assert list(sinks[0].results[0].images) == ["cam0", "cam1"]


def test_report_is_strict_json_with_an_account_of_every_frame(tmp_path):
    job = _job(tmp_path, report=tmp_path / "report.json")
    run_job(job, tools=_tools(_frames(3)))
    text = (tmp_path / "report.json").read_text()
    assert "NaN" not in text
    report = json.loads(text)
    assert report["format"] == "depthsr-report/1"
    assert [frame["frame_index"] for frame in report["frames"]] == [5, 6, 7]
    assert report["frames"][0]["noise_sigma"] is None
    assert report["frames"][0]["timings"]["reconstruction"] == 0.25
    assert report["scene"]["depth"] == {"cam0": "none", "cam1": "estimated", "cam2": "given"}
    assert report["settings"]["magnification"] == "2"
    assert report["timings"]["reconstruction"] == pytest.approx(0.75)
    assert {"decode", "encode", "join"} <= set(report["timings"])
    assert report["run"]["peak_memory_mib"] > 1
    assert report["warnings"] == ["the same warning every time"]
    assert report["versions"]["numpy"] == np.__version__


def test_only_the_frames_asked_for(tmp_path):
    job = _job(tmp_path, frames=FrameRange.parse("6:9"))
    run_job(job, tools=_tools(_frames(5)))
    assert _numbers(tmp_path / "out.mkv") == [6, 7, 8]


@pytest.mark.parametrize("text", ["4:7", "8:11", "11:"])
def test_frames_that_are_not_there_are_refused(tmp_path, text):
    job = _job(tmp_path, frames=FrameRange.parse(text))
    with pytest.raises(ConfigurationError, match="not within the scene's frames 5:10"):
        run_job(job, tools=_tools(_frames(5)))
    assert not (tmp_path / "out.mkv").exists()


def test_segments_are_the_same_whatever_their_length(tmp_path):
    results = {}
    for length in (1, 3, 32):
        sinks: list[MemorySink] = []
        job = _job(tmp_path, segment_length=length)
        run_job(job, tools=_tools(_frames(4), sinks=sinks))
        results[length] = [result.images["cam0"].luma for result in sinks[0].results]
    for other in (3, 32):
        np.testing.assert_array_equal(results[1], results[other])


class _Dies:
    """Superresolves a number of frames, then fails."""

    def __init__(self, after: int, error: BaseException) -> None:
        self.left, self.error = after, error

    def __call__(self, *arguments, **options):
        if self.left == 0:
            raise self.error
        self.left -= 1
        return enlarge(*arguments, **options)


def test_resumed_run_computes_only_what_is_missing(tmp_path):
    job = _job(tmp_path)
    with pytest.raises(RuntimeError, match="boom"):
        run_job(job, tools=_tools(_frames(7), make_worker=worker(_Dies(5, RuntimeError("boom")))))
    folder = tmp_path / ".out.mkv.depthsr"
    assert not (tmp_path / "out.mkv").exists()
    kept = sorted(path.name for path in folder.glob("segment-*.json"))
    assert kept in (["segment-000000.json"], ["segment-000000.json", "segment-000001.json"])
    sinks: list[MemorySink] = []
    events = []
    summary = run_job(
        job, resume=True, on_event=events.append, tools=_tools(_frames(7), sinks=sinks)
    )
    assert _numbers(tmp_path / "out.mkv") == [5, 6, 7, 8, 9, 10, 11]
    assert summary.frames_computed == 7 - 2 * len(kept)
    assert len(sinks[0].results) == summary.frames_computed
    assert events[0].frames_done == 2 * len(kept)
    assert [frame["frame_index"] for frame in summary.report["frames"]] == list(range(5, 12))
    assert not folder.exists()


def test_without_resume_old_work_is_discarded(tmp_path):
    job = _job(tmp_path)
    with pytest.raises(RuntimeError):
        run_job(job, tools=_tools(_frames(7), make_worker=worker(_Dies(5, RuntimeError("boom")))))
    assert run_job(job, tools=_tools(_frames(7))).frames_computed == 7


def test_a_segment_whose_file_is_gone_is_computed_again(tmp_path):
    job = _job(tmp_path)
    with pytest.raises(RuntimeError):
        run_job(job, tools=_tools(_frames(7), make_worker=worker(_Dies(6, RuntimeError("boom")))))
    (tmp_path / ".out.mkv.depthsr" / "segment-000000.txt").unlink()
    run_job(job, resume=True, tools=_tools(_frames(7)))
    assert _numbers(tmp_path / "out.mkv") == [5, 6, 7, 8, 9, 10, 11]


def test_resuming_another_job_is_refused_and_says_what_differs(tmp_path):
    with pytest.raises(RuntimeError):
        run_job(
            _job(tmp_path),
            tools=_tools(_frames(7), make_worker=worker(_Dies(5, RuntimeError("boom")))),
        )
    other = _job(tmp_path, settings=Settings(noise_sigma=3))
    with pytest.raises(OutputError, match="noise_sigma was None, is 3") as caught:
        run_job(other, resume=True, tools=_tools(_frames(7)))
    assert caught.value.exit_status == 2
    again = _job(
        tmp_path, settings=Settings(threads=2), report=tmp_path / "report.json"
    )  # changes no result
    assert run_job(again, resume=True, tools=_tools(_frames(7))).frames == 7


def test_resuming_over_a_changed_scene_is_refused(tmp_path):
    with pytest.raises(RuntimeError):
        run_job(
            _job(tmp_path),
            tools=_tools(_frames(7), make_worker=worker(_Dies(5, RuntimeError("boom")))),
        )
    job = _job(tmp_path)
    job.scene.write_text('{"changed": true}')
    with pytest.raises(OutputError, match="scene's files"):
        run_job(job, resume=True, tools=_tools(_frames(7)))


def test_stop_flag_ends_the_job_and_keeps_finished_segments(tmp_path):
    stop, events = StopFlag(), []

    def on_event(event):
        events.append(event)
        if isinstance(event, SegmentFinished):
            stop.set()

    job = _job(tmp_path, segment_length=1)
    with pytest.raises(Interrupted):
        run_job(job, stop=stop, on_event=on_event, tools=_tools(_frames(200)))
    assert not (tmp_path / "out.mkv").exists()
    assert list((tmp_path / ".out.mkv.depthsr").glob("segment-*.json"))
    assert run_job(job, resume=True, tools=_tools(_frames(200))).frames_computed < 200
    assert _numbers(tmp_path / "out.mkv") == list(range(5, 205))


def test_a_stop_breaks_off_a_long_computation(tmp_path):
    stop = StopFlag()

    class Endless(worker(enlarge)):
        def __init__(self, settings, *, stop, **arguments):
            super().__init__(settings, stop=stop, **arguments)
            self.asked = stop

        def register(self, frame, *, neighbours):
            stop.from_signal()  # as the handler does, amid the computation
            while not self.asked():
                time.sleep(0.01)
            raise Interrupted

    with pytest.raises(Interrupted):
        run_job(_job(tmp_path), stop=stop, tools=_tools(_frames(3), make_worker=Endless))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.json"]


def test_no_thread_outlives_a_job(tmp_path):
    before = set(threading.enumerate())
    with pytest.raises(RuntimeError):
        run_job(
            _job(tmp_path),
            tools=_tools(_frames(9), make_worker=worker(_Dies(1, RuntimeError("boom")))),
        )
    left = [t for t in set(threading.enumerate()) - before if t.name.startswith("depthsr-")]
    assert left == []


def test_reader_and_writer_errors_reach_the_caller(tmp_path):
    class Broken(MemorySource):
        def read(self, frame_index):
            if frame_index == 7:
                raise SceneError("cut short", path="x.png", view="cam1", frame=7)
            return super().read(frame_index)

    tools = _tools(_frames(6), open_scene=lambda path, **_: Broken(_frames(6)))
    with pytest.raises(SceneError, match=r"x.png, view 'cam1', frame 7: cut short"):
        run_job(_job(tmp_path), tools=tools)

    class Full(MemorySink):
        def write_segment(self, segment, stem, results):
            next(iter(results))
            raise OutputError("out.mkv: cannot be written: the disk is full")

    with pytest.raises(OutputError, match="disk is full"):
        run_job(_job(tmp_path), tools=_tools(_frames(30), make_sink=Full))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.json"]


def test_an_eye_that_is_not_observed_is_not_written(tmp_path):
    sinks: list[MemorySink] = []
    run_job(_job(tmp_path, views=("cam1", "cam2")), tools=_tools(_frames(1), sinks=sinks))
    assert sinks[0].plan.targets == ("cam1",)
    assert sinks[0].plan.options.layout == "right"
    assert sinks[0].plan.picture_names == {"cam1": "right"}
    with pytest.raises(ConfigurationError, match="no eye to write"):
        run_job(_job(tmp_path, views=("cam2",)), tools=_tools(_frames(1)))
    with pytest.raises(ConfigurationError, match=r"'cam0' \(left\) is not among them"):
        run_job(_job(tmp_path, views=("cam1",), layout="left"), tools=_tools(_frames(1)))


def test_layout_views_writes_every_observed_view(tmp_path):
    sinks: list[MemorySink] = []
    job = _job(tmp_path, views=("cam0", "cam2"), layout="views")
    run_job(job, tools=_tools(_frames(1), sinks=sinks))
    assert sinks[0].plan.targets == ("cam0", "cam2")
    assert sinks[0].plan.picture_names == {"cam0": "cam0", "cam2": "cam2"}


@pytest.mark.parametrize(
    ("aspect", "is_default", "expected", "remaining"),
    [
        (Fraction(2), True, (12, 36), 1),
        (Fraction(1, 2), True, (24, 18), 1),
        (Fraction(2), False, (24, 36), 2),
        (Fraction(1), True, (24, 36), 1),
    ],
)
def test_halved_eyes_are_restored_unless_told_otherwise(
    tmp_path, aspect, is_default, expected, remaining
):
    sinks: list[MemorySink] = []
    job = dataclasses.replace(_job(tmp_path), magnification_is_default=is_default)
    run_job(job, tools=_tools(_frames(1), sinks=sinks, pixel_aspect=aspect))
    assert sinks[0].plan.hr_shape == expected
    assert sinks[0].plan.pixel_aspect == remaining
    assert sinks[0].results[0].images["cam0"].luma.shape == expected


def test_outputs_are_checked_before_the_scene_is_opened(tmp_path):
    def never(*_, **__):
        raise AssertionError("the scene was opened")

    cases = {
        "there is no folder": {"output": tmp_path / "missing" / "out.mkv"},
        "it is a folder": {"output": tmp_path},
        "named for the video and for the report": {"report": tmp_path / "out.mkv"},
        "would overwrite the scene": {"report": tmp_path / "scene.json"},
        "not a folder": {"frames_dir": tmp_path / "scene.json"},
    }
    for said, options in cases.items():
        with pytest.raises(OutputError, match=said):
            run_job(_job(tmp_path, **options), tools=_tools([], open_scene=never))


@pytest.mark.parametrize(
    ("settings", "width"),
    [(Settings(psf_support=25), 25), (Settings(psf_sigma=4.0), 25)],
)
def test_a_psf_that_reaches_across_the_picture_is_refused(tmp_path, settings, width):
    tools = _tools(_frames(1, height=6, width=9))
    with pytest.raises(
        ConfigurationError, match=f"PSF of {width} .* too wide for an image of 18×12"
    ):
        run_job(_job(tmp_path, settings=settings), tools=tools)


def test_a_picture_of_one_line_takes_any_psf_along_it(tmp_path):
    job = _job(tmp_path, settings=Settings(psf_sigma=1.7, psf_support=7))
    assert run_job(job, tools=_tools(_frames(1, height=1, width=9))).frames == 1


@pytest.mark.parametrize("place", ["report", "output", "frames_dir"])
def test_no_file_of_the_scene_is_written_over(tmp_path, place):
    names = {"report": "in.json", "output": "in.mkv", "frames_dir": "right-000006.png"}
    taken = tmp_path / names[place]
    taken.write_bytes(b"input")

    class OfFiles(MemorySource):
        def reads(self, path):
            return path.samefile(taken)

    options = {place: tmp_path if place == "frames_dir" else taken}
    tools = _tools([], open_scene=lambda *_, **__: OfFiles(_frames(2)))
    with pytest.raises(OutputError, match=f"{taken.name}: would overwrite the scene"):
        run_job(_job(tmp_path, **options), tools=tools)
    assert taken.read_bytes() == b"input"
    assert not work_folder_of(tmp_path / "out.mkv").exists()


def test_depth_maps_that_hold_nothing_are_warned_of_once(tmp_path):
    class Unknown(MemorySource):
        def __init__(self, frames):
            super().__init__(frames)
            self.info = dataclasses.replace(self.info, has_depth=(False, True, True))

    events = []
    tools = _tools([], open_scene=lambda *_, **__: Unknown(_frames(3)))
    summary = run_job(_job(tmp_path), on_event=events.append, tools=tools)
    said = "view cam1: all of its depth is unknown; it is estimated from the neighbours"
    assert [event.text for event in events if isinstance(event, Warned)].count(said) == 1
    assert said in summary.report["warnings"]


def test_two_runs_of_one_output_do_not_mix(tmp_path):
    def second(*arguments, **options):
        with pytest.raises(OutputError, match="another run is writing"):
            run_job(_job(tmp_path), tools=_tools(_frames(2)))
        return enlarge(*arguments, **options)

    run_job(_job(tmp_path), tools=_tools(_frames(2), make_worker=worker(second)))
    assert _numbers(tmp_path / "out.mkv") == [5, 6]


def test_pictures_carry_source_frame_numbers_and_the_values_computed(tmp_path):
    """With the real sink: lossless PNG, and a resumed run that misses one of them."""
    frames = _frames(3)
    tools = Tools(open_scene=lambda path, **_: MemorySource(frames), make_worker=worker(enlarge))
    folder = tmp_path / "pictures"
    run_job(_job(tmp_path, output=None, frames_dir=folder), tools=tools)
    names = sorted(path.name for path in folder.iterdir())
    assert names == [f"{eye}-00000{n}.png" for eye in ("left", "right") for n in (5, 6, 7)]
    picture = cv2.imread(str(folder / "right-000006.png"), cv2.IMREAD_UNCHANGED)
    expected = np.clip(np.rint(bicubic(frames[1].view("cam1").luma, Settings().grid)), 0, 255)
    np.testing.assert_array_equal(picture, expected)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pictures", "scene.json"]


def test_interrupted_and_resumed_video_is_the_same_file(tmp_path):
    """With the real sink: bytes of an undisturbed run, of a resumed one, and of all views."""
    frames = _frames(5)
    for layout, names in (("sbs", ["out.mkv"]), ("views", ["out.cam0.mkv", "out.cam2.mkv"])):
        bytes_of = {}
        for way in ("straight", "resumed"):
            folder = tmp_path / layout / way
            folder.mkdir(parents=True)
            job = _job(folder, layout=layout)
            if way == "resumed":
                broken = Tools(
                    open_scene=lambda path, **_: MemorySource(frames),
                    make_worker=worker(_Dies(3, RuntimeError("boom"))),
                )
                with pytest.raises(RuntimeError):
                    run_job(job, tools=broken)
                assert not list(folder.glob("out*"))
            tools = Tools(
                open_scene=lambda path, **_: MemorySource(frames), make_worker=worker(enlarge)
            )
            run_job(job, resume=True, tools=tools)
            bytes_of[way] = [(folder / name).read_bytes() for name in names]
        assert bytes_of["straight"] == bytes_of["resumed"]
        assert all(len(content) > 500 for content in bytes_of["resumed"])


def test_segments_cover_the_frames_without_overlap():
    segments = cut_segments(range(3, 100), 32)
    covered = [n for segment in segments for n in range(segment.start, segment.stop)]
    assert covered == list(range(3, 100))
    assert [len(segment) for segment in segments] == [32, 32, 32, 1]


def test_output_must_be_named(tmp_path):
    with pytest.raises(ConfigurationError, match="nothing to write"):
        OutputOptions()
    check_outputs(_job(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["scene.json"]


def test_a_rate_that_is_too_high_is_held_by_dropping_and_says_so(tmp_path):
    """Ten frames at once do not fit; every frame is in the file, and accounted for."""

    class Slow(worker(enlarge)):
        def take(self, frame, *, effort, neighbours):
            time.sleep(0.05)
            result = enlarge(frame, self.settings, targets=("cam0", "cam1"))
            return dataclasses.replace(
                result, report=dataclasses.replace(result.report, effort=effort)
            )

    sinks: list[MemorySink] = []
    settings = Settings(temporal="warm", realtime=True, rate=200.0)
    job = _job(tmp_path, settings=settings, report=tmp_path / "report.json", segment_length=8)
    summary = run_job(job, tools=_tools(_frames(60), sinks=sinks, make_worker=Slow))
    assert _numbers(tmp_path / "out.mkv") == list(range(5, 65))
    records = [frame["realtime"] for frame in summary.report["frames"]]
    dropped = [record["dropped"] for record in records]
    assert 30 < sum(dropped) < 60
    assert not dropped[0]
    account = summary.report["realtime"]
    assert account["dropped"] == sum(dropped)
    assert sum(account["frames_by_rung"].values()) == 60 - sum(dropped)
    assert f"60 frames computed, {sum(dropped)} dropped" in summary.report["remarks"][0]
    for before, now, record in zip(
        sinks[0].results, sinks[0].results[1:], records[1:], strict=False
    ):
        assert list(now.images) == ["cam0", "cam1"]
        same = [eye for eye in now.images if now.images[eye] is before.images[eye]]
        assert same == record["repeated"]


def test_a_rate_that_is_low_enough_changes_nothing(tmp_path):
    class Quick(worker(enlarge)):
        def take(self, frame, *, effort, neighbours):
            assert effort.is_full
            return enlarge(frame, self.settings, targets=("cam0", "cam1"))

    settings = Settings(temporal="warm", realtime=True, rate=0.01)
    summary = run_job(
        _job(tmp_path, settings=settings), tools=_tools(_frames(5), make_worker=Quick)
    )
    assert summary.report["realtime"]["frames_by_rung"] == {"full quality": 5}


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a priority for each thread")
@pytest.mark.parametrize("is_held", [False, True])
def test_where_a_rate_is_held_reading_gives_way_to_making_frames(tmp_path, is_held):
    """So do the decoders' threads, which are begun where the scene is opened."""
    seen = {"opened": set(), "read": set(), "made": set()}

    def note(what):
        seen[what].add(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

    class Watched(MemorySource):
        def read(self, frame_index, **wanted):
            note("read")
            return super().read(frame_index, **wanted)

    def open_scene(path, **_):
        note("opened")
        return Watched(_frames(5), path=str(path))

    class Quick(worker(enlarge)):
        def take(self, frame, *, effort, neighbours):
            note("made")
            return enlarge(frame, self.settings, targets=("cam0", "cam1"))

        def register(self, frame, *, neighbours):
            note("made")
            return super().register(frame, neighbours=neighbours)

    rate = {"realtime": True, "rate": 0.01} if is_held else {}
    tools = Tools(open_scene=open_scene, make_worker=Quick, make_sink=MemorySink)
    run_job(_job(tmp_path, settings=Settings(temporal="warm", **rate)), tools=tools)
    before = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    behind = min(before + BEHIND, LEAST) if is_held else before
    assert seen == {"opened": {behind}, "read": {behind}, "made": {before}}


def test_holding_a_rate_needs_warm_frames():
    with pytest.raises(ConfigurationError, match="--temporal: must be warm with --realtime"):
        Settings(realtime=True)


def test_where_each_eye_is_made_alone_no_other_view_is_read(tmp_path):
    read = []
    now = 0.0  # time passes in the worker alone

    class Watched(MemorySource):
        def read(self, frame_index, *, only=None, depth=(), colour=None):
            read.append(only)
            return super().read(frame_index, only=only, depth=depth, colour=colour)

    class Slow(worker(enlarge)):
        def take(self, frame, *, effort, neighbours):
            nonlocal now
            assert not effort.looks_around or len(frame.views) == 3
            now += 0.016 if effort.refresh_every is None else 0.1
            return enlarge(frame, self.settings, targets=("cam0", "cam1"))

    settings = Settings(temporal="warm", realtime=True, rate=50.0)
    summary = run_job(
        _job(tmp_path, settings=settings),
        tools=_tools(
            _frames(30),
            open_scene=lambda path, **_: Watched(_frames(30)),
            make_worker=Slow,
            clock=lambda: now,
        ),
    )
    assert read[0] is None
    assert {"cam0", "cam1"} in [set(only) for only in read if only is not None]
    assert sum(only is not None for only in read) > 20
    assert summary.report["realtime"]["frames_by_rung"]["each eye alone"] > 15


@pytest.mark.parametrize("comes", [True, False])
def test_depth_that_was_let_go_of_is_waited_for_on_the_rung_that_needs_less_of_it(comes):
    source = MemorySource(_frames(2))
    ids, targets = source.info.view_ids, ("cam0", "cam1")
    few = dataclasses.replace(SWIFT, views=2)
    efforts = [FULL, SWIFT, few, Effort(register=False, views=2), Effort(alone=True)]
    asked = []

    def approach(frame_index, *, depth=None):
        asked.append(depth)
        return comes or not depth

    source.approach = approach

    def rung(level, before):
        return highest_at_hand(source, targets, 1, efforts, level, before)

    assert rung(1, few) == (1 if comes else 2)
    assert rung(2, SWIFT) == 2, "it is there"
    assert rung(0, Effort(register=False)) == (0 if comes else 3)
    assert {frozenset(depth) for depth in asked if depth} == {frozenset(ids), frozenset(targets)}


@pytest.mark.parametrize("comes", [True, False])
def test_views_that_were_let_go_are_waited_for_before_quality_goes_up(tmp_path, comes):
    """After a while that is busy: no video holds the stream up, and what is said is what was."""
    now = 0.0
    let_go: set[int] = set()

    class Videos(MemorySource):
        """Its other views are there at once, or at a key frame every ten frames, or never."""

        def read(self, frame_index, *, only=None, depth=(), colour=None):
            if only is not None and set(only) == {"cam0", "cam1"}:
                let_go.add(frame_index)
            else:
                assert frame_index - 1 not in let_go or (comes and frame_index % 10 == 0)
            return super().read(frame_index, only=only, depth=depth, colour=colour)

        def approach(self, frame_index, *, depth=None):
            return frame_index - 1 not in let_go or (comes and frame_index % 10 == 0)

    class Busy(worker(enlarge)):
        def take(self, frame, *, effort, neighbours):
            nonlocal now
            assert not effort.looks_around or len(frame.views) == 3
            is_busy = frame.frame_index < 20
            now += (0.018 if effort.refresh_every is None else 0.2) if is_busy else 0.001
            return enlarge(frame, self.settings, targets=("cam0", "cam1"))

    settings = Settings(temporal="warm", realtime=True, rate=50.0)
    summary = run_job(
        _job(tmp_path, settings=settings),
        tools=_tools(
            _frames(300),
            open_scene=lambda path, **_: Videos(_frames(300)),
            make_worker=Busy,
            clock=lambda: now,
        ),
    )
    rungs = [record["realtime"]["rung"] for record in summary.report["frames"]]
    assert rungs[15] == "each eye alone"
    of_eyes = "each eye alone, what stands still made again"
    assert rungs[-1] == ("full quality" if comes else of_eyes)
    assert summary.report["realtime"]["dropped"] <= 8
