"""Figure 13: what there is beyond the Nyquist limit of the LR grid, and how much of it is true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pipeline import drawing
from pipeline.evaluate import BORDER
from pipeline.evaluation.elements import Chapter, Figure
from pipeline.evaluation.plots import lines, png
from pipeline.evaluation.tables import Table, number

TRUTH = "original"

DECADES = 5.0
"""Range of the pictures: log₁₀ of the magnitude, from the largest downwards."""

NUM_BINS = 48
"""Of the radial average."""


@dataclass(frozen=True, kw_only=True)
class Beyond:
    """What one picture has beyond the LR Nyquist limit."""

    scene: str
    method: str
    energy: float
    """As a share of the truth's energy there; more than 1 is too much."""
    true_energy: float
    """Share of the truth's energy there that the picture explains: 1 − |F − F₀|²/|F₀|²;
    0 for a picture without any, negative where what it has is wrong."""


def spectrum(image: npt.ArrayLike) -> npt.NDArray[np.complex128]:
    """Return the 2-D DFT of a picture, zero frequency in the middle.

    The mean is taken off and a Hann window laid over, so that the borders, which do
    not fit together, draw no cross.
    """
    grey = np.asarray(image, float)
    window = np.hanning(grey.shape[0])[:, None] * np.hanning(grey.shape[1])
    return np.asarray(np.fft.fftshift(np.fft.fft2((grey - grey.mean()) * window)))


def frequencies(shape: tuple[int, int]) -> tuple[npt.NDArray, npt.NDArray]:
    """Return |f_y| (H, 1) and |f_x| (1, W) of :func:`spectrum`, cycles per pixel."""
    along_y, along_x = (np.fft.fftshift(np.fft.fftfreq(side)) for side in shape)
    return np.abs(along_y)[:, None], np.abs(along_x)[None, :]


def beyond_nyquist(
    scene: str,
    method: str,
    image: npt.ArrayLike,
    truth: npt.ArrayLike,
    magnification: tuple[int, int],
) -> Beyond:
    """Return what a picture has where |f_x| > 1/(2 K_x) or |f_y| > 1/(2 K_y)."""
    found, true = spectrum(image), spectrum(truth)
    f_y, f_x = frequencies(true.shape)
    outside = (f_x > 0.5 / magnification[0]) | (f_y > 0.5 / magnification[1])
    total = float((np.abs(true[outside]) ** 2).sum())
    if total == 0:
        return Beyond(scene=scene, method=method, energy=float("nan"), true_energy=float("nan"))
    wrong = float((np.abs(found[outside] - true[outside]) ** 2).sum())
    return Beyond(
        scene=scene,
        method=method,
        energy=float((np.abs(found[outside]) ** 2).sum()) / total,
        true_energy=1.0 - wrong / total,
    )


def radial_average(image: npt.ArrayLike) -> tuple[list[float], list[float]]:
    """Return spatial frequency (cycles per pixel) and mean power around each ring."""
    power = np.abs(spectrum(image)) ** 2
    f_y, f_x = frequencies(power.shape)
    radius = np.hypot(f_y, f_x)
    edges = np.linspace(0, 0.5, NUM_BINS + 1)
    ring = np.digitize(radius.ravel(), edges) - 1
    inside = (ring >= 0) & (ring < NUM_BINS)
    sums = np.bincount(ring[inside], power.ravel()[inside], NUM_BINS)
    counts = np.bincount(ring[inside], minlength=NUM_BINS)
    known = counts > 0
    centres = (edges[:-1] + edges[1:]) / 2
    return centres[known].tolist(), (sums[known] / counts[known]).tolist()


def figures(scene: str, images: Mapping[str, npt.NDArray]) -> list[Figure]:
    """Return the log spectra side by side at one scale, and their radial averages."""
    inner = {name: image[BORDER:-BORDER, BORDER:-BORDER] for name, image in images.items()}
    magnitudes = {name: np.log10(np.abs(spectrum(image)) + 1e-9) for name, image in inner.items()}
    top = max(float(values.max()) for values in magnitudes.values())
    panels = [
        drawing.titled(
            drawing.fitted(drawing.grey_canvas(values, top - DECADES, top), 360, 280), name
        )
        for name, values in magnitudes.items()
    ]
    curves = {}
    for name, image in inner.items():
        curves[name] = radial_average(image)
    return [
        Figure(
            caption=f"{scene}: logarithm of the magnitude of the 2-D DFT, one scale of "
            f"{DECADES:g} decades for all (Figure 13); zero frequency in the middle.",
            content=png(drawing.beside(panels)),
            kind="png",
            scene=scene,
        ),
        Figure(
            caption=f"{scene}: power averaged around rings; the line is the limit of the LR grid.",
            content=lines(
                curves, x_label="cycles per HR pixel", y_label="mean power", log_y=True,
                marks={"LR Nyquist": 0.25},
            ),
            scene=scene,
        ),
    ]  # fmt: skip


def chapter(rows: Sequence[Beyond], pictures: Sequence[Figure]) -> Chapter:
    """Return Figure 13 and its numbers."""
    sentences = []
    means = {
        method: 100 * float(np.mean([row.true_energy for row in rows if row.method == method]))
        for method in dict.fromkeys(row.method for row in rows)
    }
    if "default" in means and "bicubic" in means and len({row.scene for row in rows}) > 1:
        sentences.append(
            "Of the original's energy beyond the LR Nyquist limit the default brings back "
            f"{means['default']:.0f} % rightly in the mean over the scenes, bicubic "
            f"{means['bicubic']:.0f} %."
        )
    for scene in dict.fromkeys(row.scene for row in rows):
        by_method = {row.method: row for row in rows if row.scene == scene}
        if "default" in by_method and "bicubic" in by_method:
            ours, plain = by_method["default"], by_method["bicubic"]
            sentences.append(
                f"{scene}: of the original's energy beyond the LR Nyquist limit the default "
                f"brings back {100 * ours.true_energy:.0f} % rightly, bicubic "
                f"{100 * plain.true_energy:.0f} %."
            )
    return Chapter(
        key="spectra",
        title="Frequencies (Figure 13)",
        question="Is there detail that the LR grid could not hold, and is it the right one?",
        answer=sentences,
        tables=[
            (
                "Beyond the LR Nyquist limit, shares of the original's energy there",
                Table(
                    head=("scene", "method", "energy %", "explained %"),
                    rows=tuple(
                        (row.scene, row.method, number(100 * row.energy, 1),
                         number(100 * row.true_energy, 1))
                        for row in rows
                    ),
                    left=("method",),
                ),
            )
        ],
        figures=pictures,
        data={"rows": list(rows)},
    )  # fmt: skip
