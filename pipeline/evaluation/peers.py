"""What other projects' packages make of the same input, and where they win."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pipeline.degradation import Degradation, DegradedFrame
from pipeline.evaluate import BORDER, DEFAULT, SINGLE_VIEW
from pipeline.evaluation.btv_l1 import BTV_L1
from pipeline.evaluation.elements import Chapter
from pipeline.evaluation.fusing import Asked, Fuser
from pipeline.evaluation.home_ground import HALVING, home_frame, home_settings
from pipeline.evaluation.kept import fused_once, made_once
from pipeline.evaluation.methods import Accounted, MethodRun, accounted, fidelity, timed_run
from pipeline.evaluation.programs import ProgramFailed
from pipeline.evaluation.rivals import PEERS, Given, Peer, moved_half
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.tables import NOT_MEASURED, Table, number, signed
from pipeline.evaluation.vidsr import VIDSR
from pipeline.frames import GreyImage
from pipeline.threads import thread_count

OURS = ("bicubic", SINGLE_VIEW, DEFAULT)
"""Measured beside the peers."""

MANY_VIEWS = 4
"""Views from which, with noise, the goal is to win everywhere."""

MIDDLE = (96, 72)
"""Width and height of what a slow peer is given: the middle of the picture, LR pixels."""

FUSERS = (VIDSR, BTV_L1)
"""Those that fuse views; all of them are slow."""


@dataclass(frozen=True, kw_only=True)
class InputKind:
    """How LR pictures are made for the comparison."""

    sigma: float | None
    """Of the Gaussian PSF before decimation, HR pixels; None: antialiased bicubic."""
    noise: float
    """Grey levels."""

    @property
    def name(self) -> str:
        """What a table calls it."""
        blur = "bicubic" if self.sigma is None else f"Gaussian {self.sigma:g}"
        return f"{blur}, noise {self.noise:g}"

    @property
    def degradation(self) -> Degradation | None:
        """As Set 1 has it; None: antialiased bicubic."""
        if self.sigma is None:
            return None
        return Degradation(psf_sigma=self.sigma, noise_sigma=self.noise)

    def frame(self, subject: Subject) -> DegradedFrame:
        """Return the LR frame and its truth."""
        if self.degradation is None:
            return home_frame(subject, self.noise)
        return subject.degraded(self.degradation)

    def run(self, method: str, subject: Subject, degraded: DegradedFrame) -> MethodRun:
        """Return what a method of ours makes of the left eye, told what is true of the input."""
        eye = subject.eyes[0]
        if self.degradation is None:
            return timed_run(method, degraded, home_settings(subject.settings), eye)
        return subject.run(method, self.degradation, eye)


@dataclass(frozen=True, kw_only=True)
class PeerRow:
    """One method on the left eye of one scene, made in one way."""

    scene: str
    num_views: int
    sigma: float | None
    """HR pixels; None: antialiased bicubic."""
    noise: float
    """Grey levels."""
    method: str
    is_peer: bool
    psnr: float
    """dB; NaN where it did not run."""
    ssim: float
    cpu_seconds: float
    """Of all threads; NaN of a program of its own."""
    memory_mib: float
    remark: str = ""
    """Why it did not run; empty where it did."""

    @property
    def input_name(self) -> str:
        """What a table calls the input."""
        return InputKind(sigma=self.sigma, noise=self.noise).name


def input_kinds(sigmas: Iterable[float], noises: Sequence[float]) -> list[InputKind]:
    """Return the inputs to compare on: Gaussians, then the networks' home ground."""
    blurs: list[float | None] = [*sorted(sigmas, reverse=True), None]
    return [InputKind(sigma=blur, noise=noise) for blur in blurs for noise in noises]


def measure_peers(
    subject: Subject,
    kinds: Iterable[InputKind],
    *,
    note: Callable[[str], None] = lambda _: None,
    peers: Sequence[Peer] = PEERS,
    folder: Path | None = None,
) -> list[PeerRow]:
    """Return a row for each input and method, ours first; those that are absent say so.

    Parameters
    ----------
    peers : sequence of Peer
        Those that take one picture.
    folder : Path, optional
        Where it is kept what networks make, and taken from if it is there.
    """
    eye = subject.eyes[0]
    rows = []
    for kind in kinds:
        degraded = kind.frame(subject)
        truth = degraded.truth[eye]

        def row(
            method: str, image: npt.NDArray, cpu_seconds: float, memory_mib: float, *,
            is_peer: bool, kind: InputKind = kind, truth: npt.NDArray = truth,
        ) -> PeerRow:  # fmt: skip
            found = fidelity(image, truth, BORDER)
            return PeerRow(
                scene=subject.name, num_views=len(subject.view_ids), sigma=kind.sigma,
                noise=kind.noise, method=method, is_peer=is_peer, psnr=found.psnr,
                ssim=found.ssim, cpu_seconds=cpu_seconds, memory_mib=memory_mib,
            )  # fmt: skip

        for method in OURS:
            note(f"{subject.name}, {kind.name}: {method}")
            run = kind.run(method, subject, degraded)
            rows.append(row(method, run.image, run.cpu_seconds, run.memory_mib, is_peer=False))
        given = Given(noise=kind.noise, sigma=kind.sigma, threads=thread_count())
        lr_image = degraded.frame.view(eye).luma
        for peer in peers:
            if not peer.applies(given):
                continue
            remark = peer.missing()
            if remark:
                rows.append(_absent(subject, kind, peer.name, remark))
                continue
            note(f"{subject.name}, {kind.name}: {peer.name}")
            made = made_once(peer, lr_image, given, folder, partial(_made, peer, lr_image, given))
            rows.append(
                row(peer.name, made.result, made.cpu_seconds, made.memory_mib, is_peer=True)
            )
    return rows


@dataclass(frozen=True, kw_only=True)
class MiddleRow:
    """A peer that fuses views, and ours, on the middle of the left eye, made in one way."""

    scene: str
    num_views: int
    input_name: str
    peer: str
    psnr: dict[str, float]
    """By method, dB; empty where the peer did not run."""
    ssim: dict[str, float]
    cpu_seconds: float
    """Of the peer, all its processes; NaN where it did not run."""
    memory_mib: float
    """Of the peer's own process, all of it; NaN where it did not run."""
    remark: str = ""
    """Why it did not run; empty where it did."""


def measure_middle(
    subject: Subject,
    kinds: Iterable[InputKind],
    *,
    note: Callable[[str], None] = lambda _: None,
    fusers: Sequence[Fuser] = FUSERS,
    folder: Path | None = None,
) -> list[MiddleRow]:
    """Return a row for each noisy input of a scene of many views, and each peer that fuses them.

    They take too long for more, and work on a region of interest; ours are measured over the
    same pixels of their whole pictures.

    Parameters
    ----------
    folder : Path, optional
        Where it is kept what peers make, and taken from if it is there.
    """
    if len(subject.view_ids) < MANY_VIEWS:
        return []
    rows = []
    for kind in kinds:
        if kind.noise == 0:
            continue
        degraded = kind.frame(subject)
        asked = Asked(
            frame=degraded.frame, reference=subject.eyes[0],
            sigma=HALVING.sigma if kind.sigma is None else kind.sigma,
            region=_middle_of(degraded.frame.lr_shape),
        )  # fmt: skip
        truth = _inside(degraded.truth[subject.eyes[0]], asked.region)
        ours: dict[str, npt.NDArray[np.uint8]] = {}
        for fuser in fusers:
            remark = fuser.missing()
            if not remark:
                note(f"{subject.name}, {kind.name}: {fuser.name}, the middle")
                try:
                    made = fused_once(fuser, asked, folder, partial(_fused, fuser, asked, kind))
                except ProgramFailed as error:
                    remark = str(error)
            if remark:
                rows.append(_absent_middle(subject, kind, fuser.name, remark))
                continue
            ours = ours or {
                method: _inside(kind.run(method, subject, degraded).image, asked.region)
                for method in OURS
            }
            pictures = {fuser.name: made.result, **ours}
            found = {name: fidelity(picture, truth, BORDER) for name, picture in pictures.items()}
            rows.append(
                MiddleRow(
                    scene=subject.name, num_views=len(subject.view_ids), input_name=kind.name,
                    peer=fuser.name, psnr={name: one.psnr for name, one in found.items()},
                    ssim={name: one.ssim for name, one in found.items()},
                    cpu_seconds=made.cpu_seconds, memory_mib=made.memory_mib,
                )
            )  # fmt: skip
    return rows


def _fused(fuser: Fuser, asked: Asked, kind: InputKind) -> Accounted[npt.NDArray[np.uint8]]:
    """Return what a peer makes of a region, as it is measured."""
    made = fuser.run(asked)
    return made.giving(
        _placed(made.result, on_pixels=fuser.on_pixels, decimated=kind.sigma is not None)
    )


def _absent_middle(subject: Subject, kind: InputKind, peer: str, remark: str) -> MiddleRow:
    return MiddleRow(
        scene=subject.name, num_views=len(subject.view_ids), input_name=kind.name, peer=peer,
        psnr={}, ssim={}, cpu_seconds=math.nan, memory_mib=math.nan, remark=remark,
    )  # fmt: skip


def _middle_of(lr_shape: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return x, y, width, height of the middle, all even, LR pixels."""
    height, width = (
        min(side, shape) for side, shape in zip(reversed(MIDDLE), lr_shape, strict=True)
    )
    return (lr_shape[1] - width) // 4 * 2, (lr_shape[0] - height) // 4 * 2, width, height


def _inside(
    image: npt.NDArray[np.uint8], region: tuple[int, int, int, int]
) -> npt.NDArray[np.uint8]:
    """Return the part of an HR picture that shows a region of the LR one."""
    x, y, width, height = (2 * number for number in region)
    return image[y : y + height, x : x + width]


def _made(peer: Peer, lr_image: GreyImage, given: Given) -> Accounted[npt.NDArray[np.uint8]]:
    """Return what a peer makes of an LR picture, as it is measured."""
    peer.run(lr_image[:32, :32], given)  # loads it
    made = accounted(partial(peer.run, lr_image, given))
    return made.giving(_placed(made.result, on_pixels=False, decimated=given.sigma is not None))


def _placed(image: GreyImage, *, on_pixels: bool, decimated: bool) -> npt.NDArray[np.uint8]:
    """Return a picture where the truth is, rounded.

    Parameters
    ----------
    on_pixels : bool
        Its maker takes LR pixel i to lie on HR pixel 2i; else pixel areas are aligned.
    decimated : bool
        LR pixel i does lie on HR pixel 2i; else pixel areas are aligned.
    """
    if decimated and not on_pixels:
        image = moved_half(image)
    elif on_pixels and not decimated:
        image = moved_half(image[::-1, ::-1])[::-1, ::-1]  # the other way
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _absent(subject: Subject, kind: InputKind, method: str, remark: str) -> PeerRow:
    nothing = float("nan")
    return PeerRow(
        scene=subject.name, num_views=len(subject.view_ids), sigma=kind.sigma, noise=kind.noise,
        method=method, is_peer=True, psnr=nothing, ssim=nothing, cpu_seconds=nothing,
        memory_mib=nothing, remark=remark,
    )  # fmt: skip


Cell = tuple[str, str]
"""Scene and input."""


def _cells(rows: Iterable[PeerRow]) -> dict[Cell, list[PeerRow]]:
    """Return what was measured, by cell."""
    cells: dict[Cell, list[PeerRow]] = {}
    for row in rows:
        if not row.remark:
            cells.setdefault((row.scene, row.input_name), []).append(row)
    return cells


def _default(rows: Iterable[PeerRow]) -> PeerRow:
    return next(row for row in rows if row.method == DEFAULT)


def _best(rows: Iterable[PeerRow], measure: str) -> PeerRow:
    """Return the best peer of a cell by ``psnr`` or ``ssim``."""
    return max((row for row in rows if row.is_peer), key=lambda row: getattr(row, measure))


def chapter(rows: Sequence[PeerRow], middles: Sequence[MiddleRow] = ()) -> Chapter:
    """Return the comparison, and in words where the default wins and where a peer does."""
    cells = _cells(rows)
    return Chapter(
        key="peers",
        title="Beside other projects' packages",
        question="Is there a package that does better, and on what?",
        answer=[*_answer(rows, cells), *_answer_of_middles(middles)],
        tables=[
            ("The default and the best of the peers, left eye", _summary(cells)),
            *([(_MIDDLE_TITLE, _middle_table(middles))] if middles else []),
            ("Every method, left eye", _full_table(rows)),
        ],
        data={"rows": list(rows), "middles": list(middles)},
    )


def _answer(rows: Sequence[PeerRow], cells: Mapping[Cell, Sequence[PeerRow]]) -> list[str]:
    sentences = []
    aimed = {
        cell: found
        for cell, found in cells.items()
        if found[0].num_views >= MANY_VIEWS and found[0].noise > 0
    }
    if aimed:
        margins = {
            measure: {
                cell: getattr(_default(found), measure) - getattr(_best(found, measure), measure)
                for cell, found in aimed.items()
            }
            for measure in ("psnr", "ssim")
        }
        won = {name: sum(gain > 0 for gain in of.values()) for name, of in margins.items()}
        verdict = "yes" if all(count == len(aimed) for count in won.values()) else "no"
        least = min(aimed, key=lambda cell: margins["psnr"][cell])
        sentences.append(
            f"At {MANY_VIEWS} views or more and with noise, does the default win everywhere? "
            f"{verdict.capitalize()}: in {won['psnr']} of {len(aimed)} cells by PSNR and in "
            f"{won['ssim']} by SSIM; its least margin over the best peer is "
            f"{signed(margins['psnr'][least])} dB, on {least[0]} ({least[1]}) against "
            f"{_best(aimed[least], 'psnr').method}."
        )
    for cell, found in cells.items():
        ours, best = _default(found), _best(found, "psnr")
        if best.psnr > ours.psnr:
            sentences.append(
                f"A peer wins on {cell[0]} ({cell[1]}, {ours.num_views} views): {best.method}, "
                f"{number(best.psnr)} dB against {number(ours.psnr)} dB."
            )
    absent = dict.fromkeys((row.method, row.remark) for row in rows if row.remark)
    if absent:
        names = "; ".join(f"{method}: {remark}" for method, remark in absent)
        sentences.append(f"Not measured: {names}.")
    return sentences


def _answer_of_middles(middles: Sequence[MiddleRow]) -> list[str]:
    sentences = []
    for peer in dict.fromkeys(row.peer for row in middles):
        of_peer = [row for row in middles if row.peer == peer]
        remarks = dict.fromkeys(row.remark for row in of_peer if row.remark)
        sentences += [f"Not measured: {peer}: {remark}." for remark in remarks]
        margins = [_margin(row) for row in of_peer if not row.remark]
        if margins:
            won = sum(margin > 0 for margin in margins)
            sentences.append(
                f"Against {peer}, which fuses the views as the default does and takes minutes "
                f"for a whole picture, the default wins {won} of {len(margins)} cells on the "
                f"middle {MIDDLE[0]}×{MIDDLE[1]} LR pixels, by {signed(min(margins))} to "
                f"{signed(max(margins))} dB."
            )
    return sentences


def _margin(row: MiddleRow) -> float:
    """Return by how much the default is better than the peer, dB."""
    return row.psnr[DEFAULT] - row.psnr[row.peer]


_MIDDLE_TITLE = (
    "Peers that fuse views, too slow for whole pictures, and ours, on the middle "
    f"{MIDDLE[0]}×{MIDDLE[1]} LR pixels of the left eye"
)


def _middle_table(middles: Iterable[MiddleRow]) -> Table:
    return Table(
        head=(
            "scene", "views", "input", "peer", "peer dB", *(f"{method} dB" for method in OURS),
            "margin dB", "peer SSIM", f"{DEFAULT} SSIM", "peer CPU s", "peer MiB", "",
        ),
        rows=tuple(
            (
                row.scene, str(row.num_views), row.input_name, row.peer,
                *(number(row.psnr.get(method, math.nan)) for method in (row.peer, *OURS)),
                NOT_MEASURED if row.remark else signed(_margin(row)),
                *(number(row.ssim.get(method, math.nan), 4) for method in (row.peer, DEFAULT)),
                number(row.cpu_seconds), number(row.memory_mib, 0), row.remark,
            )
            for row in middles
        ),
        left=("input", "peer", ""),
    )  # fmt: skip


def _summary(cells: Mapping[Cell, Sequence[PeerRow]]) -> Table:
    table = []
    for (scene, kind), found in cells.items():
        ours, best, alike = _default(found), _best(found, "psnr"), _best(found, "ssim")
        table.append(
            (
                scene, str(ours.num_views), kind, number(ours.psnr), number(best.psnr),
                signed(ours.psnr - best.psnr), best.method, number(ours.ssim, 4),
                number(alike.ssim, 4), signed(ours.ssim - alike.ssim, 4), alike.method,
            )
        )  # fmt: skip
    return Table(
        head=(
            "scene", "views", "input", "default dB", "best peer dB", "margin dB", "peer",
            "default SSIM", "best peer SSIM", "margin SSIM", "peer by SSIM",
        ),
        rows=tuple(table),
        left=("input", "peer", "peer by SSIM"),
    )  # fmt: skip


def _full_table(rows: Iterable[PeerRow]) -> Table:
    return Table(
        head=("scene", "input", "method", "PSNR", "SSIM", "CPU s", "MiB", ""),
        rows=tuple(
            (
                row.scene, row.input_name, row.method, number(row.psnr), number(row.ssim, 4),
                number(row.cpu_seconds), number(row.memory_mib, 0), row.remark,
            )
            for row in rows
        ),
        left=("input", "method", ""),
    )  # fmt: skip
