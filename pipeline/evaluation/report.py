"""The report of an evaluation: one page that stands alone, and its numbers for other programs."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path

import jinja2
import numpy as np
import numpy.typing as npt

from pipeline.degradation import Degradation
from pipeline.evaluate import DEFAULT, degraded_input, settings_of
from pipeline.evaluation import (
    ablations,
    fidelity,
    left_out,
    peers,
    registrations,
    sensitivity,
    spectra,
)
from pipeline.evaluation.elements import Chapter, Comparison, Figure
from pipeline.evaluation.methods import MethodRun
from pipeline.evaluation.plan import CHAPTERS, Plan
from pipeline.evaluation.plots import png
from pipeline.evaluation.subjects import SAMPLE, Subject
from pipeline.media.files import write_atomic
from pipeline.media.source import open_scene
from pipeline.report import strict_json, versions

FORMAT = "depthsr-evaluation/1"
"""Value of the key ``format`` of the JSON file."""

TITLE = "Depth-guided super-resolution: what was measured"

GALLERY_SIZE = (480, 640)
"""Largest height and width of a picture in the gallery, HR pixels; the middle is shown."""

PAGE = "pipeline.evaluation.page"


def evaluate_all(
    subjects: Sequence[tuple[str, Subject]],
    plan: Plan,
    *,
    note: Callable[[str], None] = lambda _: None,
) -> list[Chapter]:
    """Return the chapters of a report on the scenes.

    Parameters
    ----------
    subjects : sequence of (str, Subject)
        How each scene was named, and the scene.
    note : callable
        Told what is being done.
    """
    makers = {
        "fidelity": lambda: _fidelity(subjects, plan, note),
        "registration": lambda: _registration(subjects, note),
        "spectra": lambda: _spectra(subjects, plan, note),
        "psf": lambda: _psf(subjects, plan, note),
        "left-out": lambda: _left_out(subjects, note),
        "ablations": lambda: _ablations(subjects, plan, note),
        "peers": lambda: _peers(subjects, plan, note),
    }
    return [makers[key]() for key in CHAPTERS if key in plan.chapters]


def _fidelity(
    subjects: Sequence[tuple[str, Subject]], plan: Plan, note: Callable[[str], None]
) -> Chapter:
    conditions = [
        fidelity.Condition(
            psf_sigma=sigma, noise=noise,
            seeds=tuple(range(1, 1 + (plan.num_seeds if noise > 0 else 1))),
        )
        for sigma in plan.psf_sigmas
        for noise in plan.noises
    ]  # fmt: skip
    shown = conditions[min(1, len(conditions) - 1)]
    rows, comparisons = [], []
    for _, subject in subjects:
        kept: dict[tuple[str, str], npt.NDArray[np.uint8]] = {}

        def keep(condition: fidelity.Condition, run: MethodRun, kept: dict = kept) -> None:
            if condition is shown and run.method in fidelity.GALLERY:
                kept[(run.method, run.view_id)] = run.image

        rows += fidelity.measure_rows(subject, conditions, note=note, keep=keep)
        degradation = Degradation(psf_sigma=shown.psf_sigma, noise_sigma=shown.noise)
        truth = subject.degraded(degradation).truth
        left, right = (
            {
                **{method: kept[(method, eye)] for method in fidelity.GALLERY},
                spectra.TRUTH: truth[eye],
            }
            for eye in subject.eyes
        )
        comparisons.append(
            Comparison(
                title=f"{subject.name} (σ_psf {shown.psf_sigma:g}, noise {shown.noise:g})",
                left={name: png(_middle(picture)) for name, picture in left.items()},
                right={name: png(_middle(picture)) for name, picture in right.items()},
            )
        )
    return fidelity.chapter(rows, comparisons)


def _middle(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the middle of a picture, no larger than the gallery shows."""
    height, width = (
        min(side, most) for side, most in zip(picture.shape, GALLERY_SIZE, strict=True)
    )
    top, left = (picture.shape[0] - height) // 2, (picture.shape[1] - width) // 2
    return picture[top : top + height, left : left + width]


def _registration(subjects: Sequence[tuple[str, Subject]], note: Callable[[str], None]) -> Chapter:
    rows, figures = [], []
    for _, subject in subjects:
        found, pictures = registrations.measure_methods(subject, note=note)
        rows += found
        figures += pictures
    return registrations.chapter(rows, figures)


def _spectra(
    subjects: Sequence[tuple[str, Subject]], plan: Plan, note: Callable[[str], None]
) -> Chapter:
    rows: list[spectra.Beyond] = []
    figures: list[Figure] = []
    degradation = Degradation(psf_sigma=plan.psf_sigmas[0], noise_sigma=plan.noises[0])
    for _, subject in subjects:
        images = _images(subject, degradation, ("bicubic", "single-view", DEFAULT), note)
        truth = images[spectra.TRUTH]
        rows += [
            spectra.beyond_nyquist(subject.name, method, image, truth, (2, 2))
            for method, image in images.items()
            if method != spectra.TRUTH
        ]
        figures += spectra.figures(subject.name, images)
    return spectra.chapter(rows, figures)


def _images(
    subject: Subject,
    degradation: Degradation,
    methods: Sequence[str],
    note: Callable[[str], None],
) -> dict[str, npt.NDArray[np.uint8]]:
    """Return the left eye by method, the original first."""
    left = subject.eyes[0]
    truth = subject.degraded(degradation).truth[left]
    images: dict[str, npt.NDArray[np.uint8]] = {spectra.TRUTH: truth}
    for method in methods:
        note(f"{subject.name}: {method}")
        images[method] = subject.run(method, degradation, left).image
    return images


def _psf(
    subjects: Sequence[tuple[str, Subject]], plan: Plan, note: Callable[[str], None]
) -> Chapter:
    curves, crops = [], []
    for _, subject in subjects:
        for sigma in plan.psf_sigmas:
            for noise in plan.noises:
                curve, figure = sensitivity.measure_curve(
                    subject, Degradation(psf_sigma=sigma, noise_sigma=noise), note=note
                )
                curves.append(curve)
                crops.append(figure)
    anything = Degradation(psf_sigma=plan.psf_sigmas[0], noise_sigma=plan.noises[0])
    of_one_view = sensitivity.remark_of_one_view(subjects[0][1], anything)
    return sensitivity.chapter(curves, crops, of_one_view)


def _left_out(subjects: Sequence[tuple[str, Subject]], note: Callable[[str], None]) -> Chapter:
    predictions, free_views, crops = [], [], []
    for _, subject in subjects:
        found, figure = left_out.measure_prediction(subject, note=note)
        predictions.append(found)
        crops.append(figure)
        free = left_out.measure_free_view(subject, note=note)
        if free is not None:
            free_views.append(free[0])
            crops.append(free[1])
    return left_out.chapter(predictions, free_views, crops)


def _ablations(
    subjects: Sequence[tuple[str, Subject]], plan: Plan, note: Callable[[str], None]
) -> Chapter:
    rows, warm = [], []
    for name, subject in subjects:
        rows += ablations.measure_ablations(subject, note=note)
        warm += _warm(name, subject, plan, note)
    return ablations.chapter(rows, warm)


def _warm(
    name: str, subject: Subject, plan: Plan, note: Callable[[str], None]
) -> list[ablations.WarmRow]:
    """Return the warm start on the first frames of a video; nothing for a still."""
    degradation = ablations.DEGRADATION
    settings = settings_of(degradation, subject.settings)
    if subject.sample is not None:
        frames = []
        for number in range(plan.warm_frames):
            frame = subject.sample.frame(
                number, psf_sigma=degradation.psf_sigma, noise_sigma=degradation.noise_sigma,
                depth="stereo",
            )  # fmt: skip
            truth = subject.sample.truth(number)
            frames.append(
                replace(
                    subject.degraded(degradation), frame=frame,
                    truth={
                        view_id: luma.astype(np.uint8)
                        for view_id, luma in zip(subject.view_ids, truth.hr_luma, strict=True)
                    },
                )
            )  # fmt: skip
    else:
        with open_scene(Path(name)) as source:
            numbers = source.info.frame_indices[: plan.warm_frames]
            if len(numbers) < 2:
                return []
            frames = [degraded_input(source.read(number), degradation) for number in numbers]
    return ablations.measure_warm(subject.name, frames, settings, subject.eyes, note=note)


def _peers(
    subjects: Sequence[tuple[str, Subject]], plan: Plan, note: Callable[[str], None]
) -> Chapter:
    kinds = peers.input_kinds(plan.psf_sigmas, plan.noises)
    rows = [
        row
        for _, subject in subjects
        for row in peers.measure_peers(subject, kinds, note=note, folder=plan.peers_folder)
    ]
    middles = [
        row
        for _, subject in subjects
        for row in peers.measure_middle(subject, kinds, note=note, folder=plan.peers_folder)
    ]
    return peers.chapter(rows, middles)


# --- writing ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Origin:
    """What a report says of itself."""

    command: str
    scenes: tuple[str, ...]
    machine: str
    cpu_seconds: float
    """Processor time of all threads."""


PAGE_PICTURES = "images"
"""Folder beside a page that holds its figures."""

LONG_TABLE = 40
"""Rows beyond which a table of a text is folded."""


def write_page(page: Path, chapters: Sequence[Chapter], origin: Origin) -> list[Path]:
    """Write the report as a Markdown page to be published, and its figures beside it.

    The photographs of real scenes are their owners': the figures are those of the rendered
    scene, and of all scenes together.

    Returns
    -------
    list of Path
        The page, then its figures.
    """
    pictures, written = {}, []
    folder = page.parent / PAGE_PICTURES
    for chapter in chapters:
        shown = [figure for figure in chapter.figures if figure.scene in ("", SAMPLE)]
        for number, figure in enumerate(shown, start=1):
            name = f"{page.stem}-{chapter.key}-{number}.{figure.kind}"
            folder.mkdir(parents=True, exist_ok=True)
            write_atomic(folder / name, figure.content)
            written.append(folder / name)
            pictures[figure.caption] = f"{PAGE_PICTURES}/{name}"
    write_atomic(page, report_text(chapters, origin, pictures).encode())
    return [page, *written]


def write_report(folder: Path, chapters: Sequence[Chapter], origin: Origin) -> list[Path]:
    """Write ``index.html``, ``report.md``, ``report.json`` and a CSV file for each table.

    Returns
    -------
    list of Path
        In that order.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for chapter in chapters:
        for position, (_, table) in enumerate(chapter.tables, start=1):
            if table.rows:
                path = folder / f"{chapter.key}-{position}.csv"
                write_atomic(path, table.as_csv().encode())
                written.append(path)
    record = {
        "format": FORMAT,
        "versions": versions(),
        "command": origin.command,
        "scenes": origin.scenes,
        "cpu_seconds": origin.cpu_seconds,
        "chapters": {
            chapter.key: {"answer": chapter.answer, **chapter.data} for chapter in chapters
        },
    }
    path = folder / "report.json"
    write_atomic(path, strict_json(record).encode())
    page = folder / "index.html"
    write_atomic(page, report_page(chapters, origin).encode())
    text = folder / "report.md"
    write_atomic(text, report_text(chapters, origin).encode())
    return [page, text, path, *written]


def report_text(
    chapters: Sequence[Chapter], origin: Origin, pictures: Mapping[str, str] | None = None
) -> str:
    """Return questions, answers and tables as Markdown; first what the chapters say in short.

    Parameters
    ----------
    pictures : mapping of str, optional
        Addresses of figures by their captions; figures without one are left out.
    """
    pictures = pictures or {}
    lines = [
        f"# {TITLE}", "",
        f"{_when(origin)} with `{origin.command}`. {origin.machine}.", "",
        "## In short", "",
    ]  # fmt: skip
    lines += [
        f"- [{chapter.question}](#{_anchor(chapter.title)}) {chapter.answer[0]}"
        for chapter in chapters
        if chapter.answer
    ]
    for chapter in chapters:
        lines += ["", f"## {chapter.title}", "", f"*{chapter.question}*", ""]
        lines += [f"- {sentence}" for sentence in chapter.answer]
        for figure in chapter.figures:
            if figure.caption in pictures:
                lines += ["", f"![{figure.caption}]({pictures[figure.caption]})", ""]
                lines += [f"*{figure.caption}*"]
        for title, table in chapter.tables:
            if len(table.rows) > LONG_TABLE:
                said = f"<summary>{title}, {len(table.rows)} rows</summary>"
                lines += ["", f"<details>{said}", "", table.as_markdown(), "", "</details>"]
            elif table.rows:
                lines += ["", f"**{title}**", "", table.as_markdown()]
    return "\n".join(lines) + "\n"


def _anchor(title: str) -> str:
    """Return the address of a heading on a Markdown page, as GitHub makes it."""
    return re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")


def _when(origin: Origin) -> str:
    day = datetime.now(UTC).date().isoformat()
    return f"Measured on {day} in {origin.cpu_seconds / 60:.0f} min of processor time"


def report_page(chapters: Sequence[Chapter], origin: Origin) -> str:
    """Return the report as one HTML page that needs nothing else."""
    files = resources.files(PAGE)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters["uri"] = lambda figure: _uri(figure.content)
    environment.filters["svg"] = _inline_svg
    template = environment.from_string((files / "report.html").read_text(encoding="utf-8"))
    pictures = [item for chapter in chapters for item in chapter.comparisons]
    return template.render(
        title=TITLE,
        scenes=origin.scenes,
        date=datetime.now(UTC).date().isoformat(),
        took=f"measured in {origin.cpu_seconds / 60:.0f} min of processor time",
        machine=origin.machine,
        command=origin.command,
        chapters=chapters,
        css=(files / "report.css").read_text(encoding="utf-8"),
        script=(files / "report.js").read_text(encoding="utf-8"),
        gallery=_gallery(pictures),
    )


def _gallery(comparisons: Sequence[Comparison]) -> str:
    """Return the pictures as JSON that may stand inside a script element."""
    if not comparisons:
        return ""
    content = [
        {
            "title": item.title,
            "left": {name: _uri(picture) for name, picture in item.left.items()},
            "right": {name: _uri(picture) for name, picture in item.right.items()},
        }
        for item in comparisons
    ]
    return json.dumps(content, ensure_ascii=True).replace("<", "\\u003c")


def _uri(picture: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(picture).decode("ascii")


def _inline_svg(figure: Figure) -> str:
    """Return the SVG element of a figure, its names made its own among many on one page."""
    text = figure.content.decode("utf-8")
    text = text[text.index("<svg") :]
    prefix = f"f{zlib.crc32(figure.caption.encode()):08x}-"
    text = re.sub(r'\bid="', f'id="{prefix}', text)
    text = re.sub(r'(xlink:href|href)="#', rf'\1="#{prefix}', text)
    return re.sub(r"url\(#", f"url(#{prefix}", text)
