"""What other projects' packages make of the same input, and where they win."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.degradation import Degradation, DegradedFrame
from pipeline.evaluate import BORDER, DEFAULT, SINGLE_VIEW, settings_of
from pipeline.evaluation import vidsr
from pipeline.evaluation.elements import Chapter
from pipeline.evaluation.home_ground import HALVING, home_frame, home_settings
from pipeline.evaluation.methods import accounted, fidelity, timed_run
from pipeline.evaluation.rivals import PEERS, Given, Peer, moved_half
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.tables import Table, number, signed
from pipeline.threads import thread_count

OURS = ("bicubic", SINGLE_VIEW, DEFAULT)
"""Measured beside the peers."""

MANY_VIEWS = 4
"""Views from which, with noise, the goal is to win everywhere."""

LEFT_OUT = (
    "OpenCV's BTV-L1 (superres) is left out: its Python packages do not bind it; it can only be "
    "built with a C++ compiler against the library's headers."
)


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

    def frame(self, subject: Subject) -> DegradedFrame:
        """Return the LR frame and its truth."""
        if self.sigma is None:
            return home_frame(subject, self.noise)
        return subject.degraded(Degradation(psf_sigma=self.sigma, noise_sigma=self.noise))

    def settings(self, settings: Settings) -> Settings:
        """Return the settings that say of the input what is true."""
        if self.sigma is None:
            return home_settings(settings)
        return settings_of(Degradation(psf_sigma=self.sigma), settings)


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
    seconds: float
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
    with_vidsr: bool = True,
) -> list[PeerRow]:
    """Return a row for each input and method, ours first; those that are absent say so.

    Parameters
    ----------
    peers : sequence of Peer
        Those that take one picture.
    with_vidsr : bool
        Whether the one packaged program that fuses several pictures is tried, too.
    """
    eye = subject.eyes[0]
    rows = []
    for kind in kinds:
        degraded = kind.frame(subject)
        settings = kind.settings(subject.settings)
        truth = degraded.truth[eye]

        def row(
            method: str, image: npt.NDArray, seconds: float, memory_mib: float, *,
            is_peer: bool, kind: InputKind = kind, truth: npt.NDArray = truth,
        ) -> PeerRow:  # fmt: skip
            eight_bit = np.clip(np.rint(image), 0, 255).astype(np.uint8)
            found = fidelity(eight_bit, truth, BORDER)
            return PeerRow(
                scene=subject.name, num_views=len(subject.view_ids), sigma=kind.sigma,
                noise=kind.noise, method=method, is_peer=is_peer, psnr=found.psnr,
                ssim=found.ssim, seconds=seconds, memory_mib=memory_mib,
            )  # fmt: skip

        for method in OURS:
            note(f"{subject.name}, {kind.name}: {method}")
            run = timed_run(method, degraded, settings, eye)
            rows.append(row(method, run.image, run.seconds, run.memory_mib, is_peer=False))
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
            peer.run(lr_image[:32, :32], given)  # loads it
            made = accounted(partial(peer.run, lr_image, given))
            image = made.result if kind.sigma is None else moved_half(made.result)
            rows.append(row(peer.name, image, made.seconds, made.memory_mib, is_peer=True))
        if with_vidsr:
            remark = vidsr.missing()
            if remark:
                rows.append(_absent(subject, kind, vidsr.NAME, remark))
                continue
            note(f"{subject.name}, {kind.name}: {vidsr.NAME}")
            begin = time.perf_counter()
            sigma = HALVING.sigma if kind.sigma is None else kind.sigma
            picture, remark = vidsr.fused(degraded.frame, eye, sigma)
            if picture is None:
                rows.append(_absent(subject, kind, vidsr.NAME, remark))
                continue
            seconds = time.perf_counter() - begin
            image = picture if kind.sigma is None else moved_half(picture)
            rows.append(row(vidsr.NAME, image, seconds, float("nan"), is_peer=True))
    return rows


def _absent(subject: Subject, kind: InputKind, method: str, remark: str) -> PeerRow:
    nothing = float("nan")
    return PeerRow(
        scene=subject.name, num_views=len(subject.view_ids), sigma=kind.sigma, noise=kind.noise,
        method=method, is_peer=True, psnr=nothing, ssim=nothing, seconds=nothing,
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


def chapter(rows: Sequence[PeerRow]) -> Chapter:
    """Return the comparison, and in words where the default wins and where a peer does."""
    cells = _cells(rows)
    return Chapter(
        key="peers",
        title="Beside other projects' packages",
        question="Is there a package that does better, and on what?",
        answer=_answer(rows, cells),
        tables=[
            ("The default and the best of the peers, left eye", _summary(cells)),
            ("Every method, left eye", _full_table(rows)),
        ],
        data={"rows": list(rows)},
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
    return [*sentences, LEFT_OUT]


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
        head=("scene", "input", "method", "PSNR", "SSIM", "seconds", "MiB", ""),
        rows=tuple(
            (
                row.scene, row.input_name, row.method, number(row.psnr), number(row.ssim, 4),
                number(row.seconds), number(row.memory_mib, 0), row.remark,
            )
            for row in rows
        ),
        left=("input", "method", ""),
    )  # fmt: skip
