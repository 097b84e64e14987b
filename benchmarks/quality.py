"""``python -m benchmarks.quality``: the tables of quality on real and rendered scenes.

Every cell is kept in the JSON file as soon as it is measured; with ``--resume`` those are
taken from there that the same code has measured before on the same scenes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

FORMAT = "depthsr-quality/1"
"""Value of the key ``format`` of the JSON file; changes when a key changes its meaning."""

ROOT = Path(__file__).parents[1]

PARTS = ("set1", "beyond", "rendered")


@dataclass(kw_only=True)
class Cells:
    """What has been measured, by key; kept in a file where there is one."""

    code: str
    """Digest of what the numbers depend on."""
    path: Path | None = None
    found: dict[str, Any] = field(default_factory=dict)
    """Plain records."""
    resumed: int = 0
    """Of them, how many were measured in another run."""

    def get(self, key: str, work: Callable[[], Any]) -> Any:
        """Return the plain record of that key, measured now unless it is there already."""
        from pipeline.media.files import write_atomic
        from pipeline.report import strict_json, to_plain

        if key not in self.found:
            self.found[key] = to_plain(work())
            if self.path is not None:
                content = {"format": FORMAT, "code": self.code, "cells": self.found}
                write_atomic(self.path, strict_json(content).encode())
        return self.found[key]


def kept_cells(path: Path | None, code: str, resume: bool) -> Cells:
    """Return the cells of a file if the same code has measured them, else none."""
    cells = Cells(code=code, path=path)
    if resume and path is not None and path.is_file():
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.get("format") == FORMAT and content.get("code") == code:
            cells.found = content["cells"]
            cells.resumed = len(cells.found)
    return cells


def code_digest(folder: Path | None) -> str:
    """Return a digest of the pipeline's source, the versions, and the files of the scenes."""
    from pipeline.evaluation.cells import SCENES
    from pipeline.report import versions

    digest = hashlib.sha256(repr(sorted(versions().items())).encode())
    for package in ("pipeline", "benchmarks"):
        for path in sorted((ROOT / package).rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    if folder is not None:
        for path in (path for scene in SCENES for path in sorted((folder / scene).rglob("*"))):
            digest.update(f"{path.relative_to(folder)} {path.stat().st_size}".encode())
    return digest.hexdigest()[:16]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.quality",
        description=__doc__.partition(":")[2].partition("\n")[0],
    )
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the page as Markdown")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep every cell here")
    parser.add_argument("--resume", action="store_true", help="take what FILE has already")
    parser.add_argument("--only", choices=PARTS, help="one part alone (default: all)")
    parser.add_argument(
        "--threads", type=int, default=0, help="threads (default: one a core); changes no number"
    )
    options = parser.parse_args(arguments)
    if options.resume and options.json is None:
        parser.error("--resume: needs --json FILE")

    from pipeline.numba_cache import prepare_numba_cache

    prepare_numba_cache()  # before anything imports numba

    from benchmarks.speed import stderr_note
    from pipeline.config import Settings
    from pipeline.evaluation.cells import scenes_folder
    from pipeline.machine import described, today
    from pipeline.media.files import check_writable, write_atomic
    from pipeline.threads import set_threads

    for path in (options.json, options.write):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            check_writable(path)
    begin = time.perf_counter()
    note = stderr_note(begin)
    settings = Settings(threads=options.threads)
    set_threads(settings.threads)
    folder = None if options.only == "rendered" else scenes_folder()
    if folder is None and options.only != "rendered":
        print("DEPTHSR_SCENES names no folder: the real scenes are left out", file=sys.stderr)
    cells = kept_cells(options.json, code_digest(folder), options.resume)
    parts = []
    wanted = PARTS if options.only is None else (options.only,)
    if folder is not None and "set1" in wanted:
        parts.append(set1_part(folder, cells, settings, note))
    if folder is not None and "beyond" in wanted:
        parts.append(beyond_part(folder, cells, settings, note))
    if "rendered" in wanted:
        parts.append(rendered_part(cells, settings, note))
    took = f"{time.perf_counter() - begin:.0f} s"
    if cells.resumed:
        took += f" and {cells.resumed} cells measured before"
    print(f"{described()}; {today()}, {took}", *(part.as_text() for part in parts), sep="\n\n")
    if options.write is not None:
        write_atomic(options.write, page(parts, options.only, took).encode())
    return 0


@dataclass(frozen=True, kw_only=True)
class Part:
    """One chapter of the page."""

    title: str
    text: str
    tables: Sequence[tuple[str, Any]]
    """Title and table; the floors are the last."""

    def as_text(self) -> str:
        """Return the chapter for a terminal."""
        pieces = [f"{title}\n\n{table.as_text()}" for title, table in self.tables]
        return "\n\n".join([self.title.upper(), *pieces])

    def as_markdown(self) -> str:
        """Return the chapter as Markdown."""
        pieces = [f"### {title}\n\n{table.as_markdown()}" for title, table in self.tables]
        return "\n\n".join([f"## {self.title}", self.text.strip(), *pieces])


SET1_TEXT = """Real photographs as the truth: 8-bit luma, blurred by a Gaussian of σ_psf HR pixels
(support 7), every second pixel kept, noise added (seed 1), rounded. K = 2, the left view, frame 0;
a border of 24 HR pixels is left out. Every method gets the same grey LR frame and the PSF; nothing
else is told, nothing is tuned to a scene. *single-view* is the default given the left view alone.
One cell by hand: `depthsr evaluate set1 SCENE --psf-sigma 1.7 --psf-support 7 --noise 2 --seed 1`.
"""

BEYOND_TEXT = """Whether another view ever does harm: the last frame of each scene, other K, PSF
(support 7 or more, as wide as six σ_psf) and noise (seed 3), both eyes. Given is the gain of the
default over single-view at each noise, dB, and the least of its gains over bicubic at any.
"""

RENDERED_TEXT = """The scene that the project renders itself, 8 views of 512×384, σ_psf 1.0, noise
1, depth as a stereo matcher delivers it (8 bit, noisy, ragged edges, holes). *True motion* is the
same solver with the true motion and the true visibility in place of those estimated; *loss* is
what estimation costs. *1 view* is the eye alone; 2, 4 and 8 are those around the stereo pair.

End-point errors are in LR pixels, over all views but the eye itself, both eyes: *visible* are
pixels that the eye truly sees, *verified* those trusted in the end; *wrong* are verified pixels
more than half a pixel off, *hidden* verified pixels that the eye does not see.
"""


def set1_part(folder: Path, cells: Cells, settings: Any, note: Callable[[str], None]) -> Part:
    from pipeline.evaluation import cells as set1
    from pipeline.evaluation.floors import Set1Cell, set1_floors, verdict_table

    found = []
    frames: dict[str, Any] = {}
    for scene in set1.SCENES:
        for sigma, noise in set1.conditions():

            def work(scene: str = scene, sigma: float = sigma, noise: float = noise) -> Set1Cell:
                note(f"{scene}, σ_psf {sigma:g}, noise {noise:g}")
                if scene not in frames:
                    frames.clear()
                    frames[scene] = set1.read_scene(folder, scene)
                return set1.measure_cell(frames[scene], scene, sigma, noise, settings)

            found.append(Set1Cell(**cells.get(f"set1 {scene} {sigma:g} {noise:g}", work)))
    return Part(
        title="Set 1: real scenes",
        text=SET1_TEXT,
        tables=[
            ("PSNR, dB", set1.psnr_table(found)),
            ("SSIM", set1.ssim_table(found)),
            ("Floors of Set 1", verdict_table(set1_floors(found))),
        ],
    )


def beyond_part(folder: Path, cells: Cells, settings: Any, note: Callable[[str], None]) -> Part:
    from pipeline.evaluation import beyond
    from pipeline.evaluation.cells import SCENES
    from pipeline.evaluation.floors import verdict_table

    found = []
    frames: dict[str, Any] = {}
    for condition in (condition for scene in SCENES for condition in beyond.conditions(scene)):

        def work(condition: beyond.Condition = condition) -> beyond.Gains:
            note(condition.name)
            if condition.scene not in frames:
                frames.clear()
                frames[condition.scene] = beyond.read_last(folder, condition.scene)
            return beyond.measure(frames[condition.scene], condition, settings)

        found.append(beyond.from_json(cells.get(f"beyond {condition.name}", work)))
    return Part(
        title="Beyond Set 1",
        text=BEYOND_TEXT,
        tables=[
            ("What the other views bring, dB", beyond.table(found)),
            ("Floor beyond Set 1", verdict_table(beyond.verdicts(found))),
        ],
    )


def rendered_part(
    cells: Cells,
    settings: Any,
    note: Callable[[str], None],
    cases: Sequence[Any] | None = None,
) -> Part:
    from pipeline.evaluation import rendered
    from pipeline.evaluation.floors import rendered_floors, verdict_table

    found = []
    scenes: dict[tuple[Any, ...], Any] = {}
    for case in rendered.CASES if cases is None else cases:

        def work(case: rendered.Case = case) -> rendered.CaseResult:
            key = (case.max_disparity, case.rotation_degrees)
            if key not in scenes:
                scenes.clear()
                scenes[key] = case.scene()
            return rendered.measure_case(case, scenes[key], settings, note)

        found.append(rendered.case_from_json(cells.get(f"rendered {case.name}", work)))
    verdicts = [
        verdict
        for result in found
        for verdict in rendered_floors(result.judged, result.case.counts)
    ]
    return Part(
        title="The rendered scene",
        text=RENDERED_TEXT,
        tables=[
            ("PSNR by the number of views, dB", rendered.gain_table(found)),
            ("End-point error", rendered.error_table(found)),
            (f"End-point error by view: {found[0].case.name}", rendered.view_table(found[0])),
            ("Floors of the rendered scene", verdict_table(verdicts)),
        ],
    )


def page(parts: Sequence[Part], only: str | None, took: str) -> str:
    """Return the page of the results, Markdown."""
    from pipeline.machine import described, today

    command = "python -m benchmarks.quality" + (f" --only {only}" if only else "")
    head = f"""# How good

Measured on {today()} with `DEPTHSR_SCENES=FOLDER {command}` (`make quality`) in {took}.

Machine: {described()}.

The real scenes are no part of this repository; `DEPTHSR_SCENES` names the folder that holds
them.

What each method, piece and setting is worth besides, beside other projects' packages, and whether
a scene tells its PSF, is in [measured.md](measured.md)."""
    return "\n\n".join([head, *(part.as_markdown() for part in parts)]) + "\n"


if __name__ == "__main__":
    sys.exit(main())
