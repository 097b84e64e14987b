"""The floors of quality that the project has set itself, and whether numbers reach them.

Pure functions: numbers in, verdicts out. What was not measured is not judged.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pipeline.evaluation.tables import NOT_MEASURED, Table, number, signed

OVER_BICUBIC, OVER_SINGLE, MEAN_OVER_BICUBIC = 0.8, -0.02, 2.7
"""Set 1: least gain in every cell over bicubic and single-view; noise-free mean; dB."""

NOISY_OVER_SINGLE = {
    ("lytro_2067", 1.0): 1.8,
    ("lytro_2067", 1.7): 1.2,
    ("flower", 1.0): 0.8,
    ("flower", 1.7): 0.5,
}
"""Set 1 with noise 2: least gain over single-view by scene and σ_psf, dB."""

THESIS_ABOVE = 0.2
"""Set 1: by how much the thesis' own solvers may be better than the default, dB."""

FLOWER_AIM = 1.3
"""Set 1: what is aimed at for ``flower`` over single-view at σ_psf 1.0 and noise 2, dB."""

LOSS, RENDERED_OVER_SINGLE = 0.6, 3.0
"""Rendered scene: largest loss to true motion, least gain over single-view, dB."""

MEDIAN_ERROR, ERROR_95, WRONG_SHARE = 0.02, 0.25, 0.01
"""Rendered scene: largest end-point errors, LR pixels; share of verified pixels that is wrong."""

PSF_SCENES = ("lytro_2067", "flower", "sample")
"""Scenes that have to tell their PSF."""

PSF_OFF, PSF_LOSS = 0.15, 0.4
"""``--psf auto``: largest distance from the true σ, HR pixels; largest loss against it, dB."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One floor and what was measured."""

    floor: str
    measured: str
    met: bool | None
    """None where it was not measured, or not with what the floor is about."""

    @property
    def word(self) -> str:
        """``met``, ``not met`` or ``not judged``."""
        return {True: "met", False: "not met", None: "not judged"}[self.met]


def verdict_table(verdicts: Iterable[Verdict]) -> Table:
    """Return the verdicts as a table."""
    return Table(
        head=("floor", "measured", ""),
        rows=tuple((item.floor, item.measured, item.word) for item in verdicts),
        left=("measured", ""),
    )


def at_most(floor: str, value: float, limit: float, *, digits: int = 2, unit: str = "") -> Verdict:
    """Return whether a value is not above a limit; NaN is not measured."""
    return Verdict(
        floor=floor,
        measured=_with_unit(value, digits, unit),
        met=None if math.isnan(value) else value <= limit,
    )


def at_least(floor: str, value: float, limit: float, *, digits: int = 2, unit: str = "") -> Verdict:
    """Return whether a value is not below a limit; NaN is not measured."""
    return Verdict(
        floor=floor,
        measured=_with_unit(value, digits, unit),
        met=None if math.isnan(value) else value >= limit,
    )


def _with_unit(value: float, digits: int, unit: str) -> str:
    return NOT_MEASURED if math.isnan(value) else f"{number(value, digits)}{unit}"


# --- how good: Set 1 -------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Set1Cell:
    """One scene under one PSF and one noise, the left view."""

    scene: str
    psf_sigma: float
    """HR pixels."""
    noise: float
    """Grey levels."""
    psnr: Mapping[str, float]
    """dB, by method."""
    ssim: Mapping[str, float]
    """By method."""

    def gain(self, base: str, method: str = "default") -> float:
        """Return by how much a method is better than another, dB."""
        return self.psnr[method] - self.psnr[base]

    @property
    def name(self) -> str:
        """Scene, σ_psf and noise in a few letters."""
        return f"{self.scene} σ {self.psf_sigma:g} noise {self.noise:g}"


def set1_floors(cells: Sequence[Set1Cell]) -> list[Verdict]:
    """Return the floors of Set 1, each met or not."""
    verdicts = [
        in_every_cell(
            f"every cell: default ≥ bicubic {signed(OVER_BICUBIC, 1)} dB",
            {cell.name: cell.gain("bicubic") for cell in cells}, OVER_BICUBIC,
        ),
        in_every_cell(
            f"every cell: default ≥ single-view {signed(OVER_SINGLE)} dB",
            {cell.name: cell.gain("single-view") for cell in cells}, OVER_SINGLE,
        ),
    ]  # fmt: skip
    clean = [cell.gain("bicubic") for cell in cells if cell.noise == 0]
    mean = sum(clean) / len(clean) if clean else math.nan
    verdicts.append(
        at_least(
            f"noise-free mean over bicubic ≥ {MEAN_OVER_BICUBIC:g} dB",
            mean, MEAN_OVER_BICUBIC, unit=" dB",
        )
    )  # fmt: skip
    noisy = {
        (cell.scene, cell.psf_sigma): cell.gain("single-view") for cell in cells if cell.noise == 2
    }
    for (scene, sigma), floor in NOISY_OVER_SINGLE.items():
        verdicts.append(
            at_least(
                f"{scene}, σ_psf {sigma:g}, noise 2: ≥ single-view + {floor:g} dB",
                noisy.get((scene, sigma), math.nan), floor, unit=" dB",
            )
        )  # fmt: skip
    for method in ("pocs", "pocs-simplified"):
        verdicts.append(
            in_every_cell(
                f"every cell: {method} at most {THESIS_ABOVE:g} dB above the default",
                {cell.name: -cell.gain("default", method) for cell in cells}, -THESIS_ABOVE,
                said=f"default over {method}",
            )
        )  # fmt: skip
    verdicts.append(
        at_least(
            f"aim: flower, σ_psf 1, noise 2: ≥ single-view + {FLOWER_AIM:g} dB",
            noisy.get(("flower", 1.0), math.nan), FLOWER_AIM, unit=" dB",
        )
    )  # fmt: skip
    return verdicts


def in_every_cell(
    floor: str, gains: Mapping[str, float], limit: float, said: str = "", *, digits: int = 2
) -> Verdict:
    """Return whether every gain reaches the limit; the worst one is named."""
    if not gains:
        return Verdict(floor=floor, measured="", met=None)
    worst = min(gains, key=lambda name: gains[name])
    missed = sum(not gain >= limit for gain in gains.values())
    measured = f"{said} worst {signed(gains[worst], digits)} dB ({worst})".strip()
    if missed:
        measured += f"; {missed} of {len(gains)} cells miss it"
    return Verdict(floor=floor, measured=measured, met=missed == 0)


# --- the PSF that the scene tells --------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class PsfEstimate:
    """What ``--psf auto`` finds at one true σ and one noise, and what it costs; the left eye."""

    scene: str
    true_sigma: float
    """HR pixels."""
    noise: float
    """Grey levels."""
    sigma: float
    """Found, HR pixels."""
    true_psnr: float
    """With the true PSF, dB."""
    psnr: float
    """With the one found, dB."""
    remark: str
    """Of the search; empty where the views could tell."""

    @property
    def off(self) -> float:
        """Found less true σ, HR pixels."""
        return self.sigma - self.true_sigma

    @property
    def loss(self) -> float:
        """What the estimate costs against the true PSF, dB."""
        return self.true_psnr - self.psnr

    @property
    def name(self) -> str:
        """Scene, σ_psf and noise in a few letters."""
        return f"{self.scene} σ {self.true_sigma:g} noise {self.noise:g}"

    @property
    def met(self) -> bool:
        """Whether the estimate is near enough in σ and in PSNR."""
        return abs(self.off) <= PSF_OFF and self.loss <= PSF_LOSS


def psf_floors(estimates: Sequence[PsfEstimate], of_one_view: str) -> list[Verdict]:
    """Return the floors of the estimated PSF, the worst case named.

    ``of_one_view`` is what the search remarked when it was given one view alone.
    """
    farthest = max(estimates, key=lambda item: abs(item.off))
    dearest = max(estimates, key=lambda item: item.loss)
    return [
        Verdict(
            floor=f"--psf auto: within {PSF_OFF:g} HR px of the true σ",
            measured=f"worst {signed(farthest.off)} px ({farthest.name})",
            met=abs(farthest.off) <= PSF_OFF,
        ),
        Verdict(
            floor=f"--psf auto: loss to the true PSF ≤ {PSF_LOSS:g} dB",
            measured=f"worst {number(dearest.loss)} dB ({dearest.name})",
            met=dearest.loss <= PSF_LOSS,
        ),
        Verdict(
            floor="--psf auto: one view alone says that it cannot tell",
            measured=of_one_view, met="one view alone" in of_one_view,
        ),
    ]  # fmt: skip


# --- how good: the rendered scene ------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class RenderedCase:
    """The rendered scene under one kind of input; PSNR by eye ("left", "right")."""

    name: str
    psnr: Mapping[str, Mapping[str, float]]
    """dB, by method, then eye: bicubic, ``1 view`` … ``8 views``, ``true motion``."""
    median_error: float
    """End-point error of truly visible pixels that have a motion, LR pixels."""
    error_95: float
    """95th percentile of verified pixels, LR pixels."""
    wrong_share: float
    """Share of verified pixels that are more than half a pixel off, 0..1."""

    def gain(self, method: str, base: str) -> dict[str, float]:
        """Return by how much a method is better than another, dB by eye."""
        return {eye: value - self.psnr[base][eye] for eye, value in self.psnr[method].items()}


def views_method(count: int) -> str:
    """Return the name of the method that uses so many views.

    >>> views_method(1), views_method(8)
    ('1 view', '8 views')
    """
    return "1 view" if count == 1 else f"{count} views"


def rendered_floors(case: RenderedCase, counts: Sequence[int]) -> list[Verdict]:
    """Return the floors of one case of the rendered scene; the worse eye decides."""
    all_views = views_method(max(counts))
    loss = max(case.gain("true motion", all_views).values())
    over_single = min(case.gain(all_views, views_method(1)).values())
    steps = [
        (few, many, min(case.gain(views_method(many), views_method(few)).values()))
        for few, many in zip(sorted(counts), sorted(counts)[1:], strict=False)
    ]
    growth = ", ".join(f"{few} → {many}: {signed(gain)}" for few, many, gain in steps)
    return [
        at_most(
            f"{case.name}: loss to true motion ≤ {LOSS:g} dB", loss, LOSS, unit=" dB"
        ),
        at_least(
            f"{case.name}: ≥ single-view + {RENDERED_OVER_SINGLE:g} dB",
            over_single, RENDERED_OVER_SINGLE, unit=" dB",
        ),
        Verdict(
            floor=f"{case.name}: the gain grows with {', '.join(map(str, sorted(counts)))} views",
            measured=f"{growth} dB",
            met=all(gain > 0 for *_, gain in steps) if steps else None,
        ),
        at_most(
            f"{case.name}: median end-point error ≤ {MEDIAN_ERROR:g} LR px",
            case.median_error, MEDIAN_ERROR, digits=4, unit=" px",
        ),
        at_most(
            f"{case.name}: 95th percentile of verified ≤ {ERROR_95:g} LR px",
            case.error_95, ERROR_95, digits=3, unit=" px",
        ),
        at_most(
            f"{case.name}: verified wrong by > ½ LR px ≤ {100 * WRONG_SHARE:g} %",
            100 * case.wrong_share, 100 * WRONG_SHARE, unit=" %",
        ),
    ]  # fmt: skip
