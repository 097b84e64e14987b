"""Learn the filters of ``pipeline/reconstruction/learned.py`` anew.

Run with ``make learn``, which unpacks scikit-image beside for its photographs. Pictures of which
the truth is known are observed as cameras would, restored and reconstructed, and each class of
pixels gets the taps that bring it nearest to the truth, in the least squares. The photographs are
CC0, in the public domain, or under no known restriction of copyright; the rendered scenes are our
own.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import multiprocessing
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.config import Settings
from pipeline.frames import RegisteredView, Rejection
from pipeline.grid import Grid
from pipeline.learned_filters import TABLES
from pipeline.machine import available_cores
from pipeline.media.files import atomic_path
from pipeline.metrics import psnr
from pipeline.reconstruction.fused import fuse
from pipeline.reconstruction.learned import (
    PATCH,
    FilterBank,
    LearnedFilters,
    kinds_of,
    num_classes,
    views_seen,
)
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.reconstruction.restoration import restored
from pipeline.superresolve import default_residual_threshold, register_frame
from pipeline.synthetic import SampleScene
from pipeline.threads import set_threads

PHOTOGRAPHS = (
    "astronaut.png", "brick.png", "camera.png", "chelsea.png", "coffee.png", "coins.png",
    "grass.png", "gravel.png", "hubble_deep_field.jpg", "ihc.png", "moon.png", "retina.jpg",
    "rocket.jpg",
)  # fmt: skip
"""Of scikit-image's package."""

LARGEST_SIDE = 900
"""Photographs larger than that are halved, pixels."""

SCENES = (2, 4, 5, 7)
"""Seeds of the rendered scenes."""

SOFT = {"camera.png": 0.8, "coffee.png": 0.8, "scene 5": 0.8, "scene 7": 1.2}
"""σ of a further blur of some, HR pixels: not every picture is sharp."""

VIEWS = (1, 2, 4, 8)
"""Numbers of views reconstructed."""

SIGMAS = {2: (0.7, 1.0, 1.35, 1.7, 2.3), 3: (0.9, 1.3, 1.9, 2.8), 4: (1.1, 1.7, 2.4, 3.4)}
"""σ_psf by K, HR pixels."""

NOISES = {2: (0.0, 1.0, 2.0, 4.0, 8.0), 3: (0.0, 2.0, 6.0), 4: (0.0, 2.0, 6.0)}
"""Grey levels."""

SUPPORT = 7
"""Least width of the PSF, HR pixels."""

SHIFT, TURN, MISPLACED = 4.0, 0.01, 0.05
"""Of the views of a photograph: largest shift, LR pixels, and rotation, radians; how far a pixel
lies from where it is said to, standard deviation, LR pixels."""

MISTOLD = (-0.12, 0.0, 0.12)
"""Without noise, what one after the other's σ_psf is off by, as a share: nobody knows it exactly,
and then it matters most."""

BORDER = 24
"""HR pixels left out at each side."""

RIDGE = 300.0
"""Sum of squares that taps are drawn with: to nothing those of all classes together, to them those
of one class. Grey levels squared."""

Made = tuple[int, npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]
"""How many views; the picture made of them, how many its pixels saw, and the truth."""

NOTHING = FilterBank(np.zeros((num_classes(tells_views=True), PATCH * PATCH // 2), np.float32))
"""Corrects nothing."""


@dataclass(frozen=True, kw_only=True)
class Example:
    """A reference view, the views registered onto it, and the truth."""

    name: str
    grid: Grid
    registered: tuple[RegisteredView, ...]
    truth: npt.NDArray[np.float32]
    noise: float


@dataclass
class Sums:
    """Normal equations of each class."""

    of_squares: npt.NDArray[np.float64]
    of_products: npt.NDArray[np.float64]

    @classmethod
    def empty(cls, classes: int) -> Sums:
        taps = PATCH * PATCH // 2
        return cls(np.zeros((classes, taps, taps)), np.zeros((classes, taps)))

    def add(self, image: npt.NDArray, truth: npt.NDArray, views: npt.NDArray | None) -> None:
        kinds = kinds_of(image, views, (0, len(image)))
        missing = truth.astype(np.float64) - image
        _add(image.astype(np.float64), missing, kinds, BORDER, self.of_squares, self.of_products)

    def solved(self) -> FilterBank:
        lower = np.tril(self.of_squares, -1)
        squares = np.tril(self.of_squares) + lower.transpose(0, 2, 1)
        ridge = RIDGE * np.eye(squares.shape[1])
        common = np.linalg.solve(squares.sum(axis=0) + ridge, self.of_products.sum(axis=0))
        rest = self.of_products - squares @ common
        found = common + np.linalg.solve(squares + ridge, rest[..., None])[..., 0]
        return FilterBank(found.astype(np.float16).astype(np.float32))


@njit(cache=True, fastmath=True)
def _add(image, missing, kinds, border, squares, products):
    """Add each pixel's pairs of opposite neighbours, turned as its class is, to its class."""
    classes, half = products.shape
    middle = PATCH // 2
    pairs = np.empty(half)
    for row in range(border, image.shape[0] - border):
        for column in range(border, image.shape[1] - border):
            mirroring, number = divmod(kinds[row, column], classes)
            twice = 2 * image[row, column]
            for tap in range(half):
                down, right = tap // PATCH - middle, tap % PATCH - middle
                if mirroring % 2:
                    down, right = right, down
                if mirroring >= 2:
                    right = -right
                pairs[tap] = (
                    image[row + down, column + right] + image[row - down, column - right] - twice
                )
            for tap in range(half):
                products[number, tap] += pairs[tap] * missing[row, column]
                for other in range(tap + 1):
                    squares[number, tap, other] += pairs[tap] * pairs[other]


def of_photograph(path: Path, magnification: int, psf: GaussianPsf, noise: float) -> Example:
    """Return a photograph seen by views that lie a few pixels and degrees apart."""
    truth = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if max(truth.shape) > LARGEST_SIDE:
        truth = cv2.resize(truth, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    height, width = (side // magnification for side in truth.shape)
    truth = truth[: height * magnification, : width * magnification].astype(np.float32)
    if path.name in SOFT:
        truth = np.rint(cv2.GaussianBlur(truth, (0, 0), SOFT[path.name]))
    generator = np.random.default_rng(list(path.name.encode()))
    taps = psf.taps_at(0.0)
    blurred = cv2.sepFilter2D(truth, -1, taps, taps, borderType=cv2.BORDER_REFLECT)
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    views = []
    for number in range(max(VIEWS)):
        shift, turn = generator.uniform(-SHIFT, SHIFT, 2), generator.uniform(-TURN, TURN)
        if number == 0:
            shift, turn = np.zeros(2), 0.0
        x = (columns + shift[0] + turn * (rows - height / 2)).astype(np.float32)
        y = (rows + shift[1] - turn * (columns - width / 2)).astype(np.float32)
        seen = cv2.remap(
            blurred, magnification * x, magnification * y, cv2.INTER_LANCZOS4,
            borderMode=cv2.BORDER_REFLECT,
        )  # fmt: skip
        seen += generator.normal(0, noise, seen.shape)
        position = np.stack((x, y), axis=-1)
        if number:
            away = cv2.GaussianBlur(
                generator.normal(size=position.shape).astype(np.float32), (0, 0), 6
            )
            position += MISPLACED / away.std() * away
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        views.append(
            RegisteredView(
                view_id=str(number),
                observed=np.clip(np.rint(seen), 0, 255).astype(np.float32),
                position=position,
                registration_weights=np.zeros_like(x),
                flags=np.where(inside, 0, int(Rejection.OUTSIDE)).astype(np.uint8),
                confidence=np.ones_like(x),
                is_reference=number == 0,
            )
        )
    return Example(
        name=path.name, grid=_settings(magnification, psf).grid, registered=tuple(views),
        truth=truth, noise=noise,
    )  # fmt: skip


def _settings(magnification: int, psf: GaussianPsf) -> Settings:
    return Settings(
        magnification=str(magnification), psf_sigma=psf.sigma, psf_support=psf.support,
        sampling="decimation",
    )  # fmt: skip


def of_scene(seed: int, magnification: int, psf: GaussianPsf, noise: float) -> Example:
    """Return a rendered scene, its views registered as any are."""
    scene = SampleScene(
        seed=seed, width=768 // magnification, height=576 // magnification,
        magnification=magnification,
    )  # fmt: skip
    soft = SOFT.get(f"scene {seed}", 0.0)
    seen = GaussianPsf.of(float(np.hypot(psf.sigma, soft)), None if soft else psf.support)
    frame = scene.frame(
        seed, psf_sigma=seen.sigma, psf_support=seen.support, noise_sigma=noise, noise_seed=seed,
        depth="stereo",
    )  # fmt: skip
    number = scene.reference_views[0]
    truth = scene.truth(seed).hr_luma[number]
    if soft:
        truth = np.rint(cv2.GaussianBlur(truth, (0, 0), soft))
    settings = _settings(magnification, psf)
    eye = scene.view_ids[number]
    found = register_frame(frame, settings, targets=(eye,))
    by_distance = sorted(
        (one.registered for one in found.registrations[eye]),
        key=lambda view: abs(scene.view_ids.index(view.view_id) - number),
    )
    return Example(
        name=f"scene {seed}",
        grid=settings.grid,
        registered=tuple(by_distance),
        truth=truth,
        noise=found.noise,
    )


def examples(folder: Path, magnification: int, psf: GaussianPsf, noise: float) -> Iterator[Example]:
    shares = (0.0,) if noise else MISTOLD
    truly = itertools.cycle(replace(psf, sigma=psf.sigma * (1 + share)) for share in shares)
    for name in PHOTOGRAPHS:
        yield of_photograph(folder / name, magnification, next(truly), noise)
    for seed in SCENES:
        yield of_scene(seed, magnification, next(truly), noise)


def learn(folder: Path, magnification: int, sigma: float, noise: float) -> LearnedFilters:
    """Return the filters for one K, PSF and noise."""
    psf = GaussianPsf(sigma=sigma, support=max(SUPPORT, GaussianPsf.of(sigma).support))
    seen = list(examples(folder, magnification, psf, noise))
    of_one = Sums.empty(num_classes(tells_views=False))
    for example in seen:
        of_one.add(_restored(example, psf), example.truth, None)
    filters = LearnedFilters(
        magnification=magnification, of_one=of_one.solved(), of_all=NOTHING, trust=1.0
    )
    of_all = Sums.empty(num_classes(tells_views=True))
    made: list[Made] = []
    for example in seen:
        for count in VIEWS:
            solved = fuse(
                example.registered[:count], example.grid, example.registered[0].flags.shape, psf,
                noise=example.noise,
                residual_threshold=default_residual_threshold(example.noise),
                judged=False, learned=filters,
            )  # fmt: skip
            image, views = (
                np.clip(solved.estimate, 0, 255),
                views_seen(solved.density, magnification),
            )
            of_all.add(image, example.truth, views)
            made.append((count, image, views, example.truth))
    filters = replace(filters, of_all=of_all.solved())
    _tell(filters, psf, noise, seen, made)
    return filters


def _restored(example: Example, psf: GaussianPsf) -> npt.NDArray[np.float32]:
    observed = np.array(example.registered[0].observed)
    return np.clip(restored(observed, example.grid, psf, example.noise), 0, 255)


def _tell(
    filters: LearnedFilters,
    psf: GaussianPsf,
    noise: float,
    seen: Sequence[Example],
    made: Sequence[Made],
) -> None:
    gains = []
    for example in seen:
        image = _restored(example, psf)
        gains.append(_gain(image, filters.of_one.apply(image), example.truth))
    text = f"restored {np.mean(gains):+.2f}"
    for count in VIEWS:
        gains = [
            _gain(image, filters.of_all.apply(image, views), truth)
            for number, image, views, truth in made
            if number == count
        ]
        text += f", {count} views {np.mean(gains):+.2f}"
    of = f"K {filters.magnification}, σ {psf.sigma:g}, noise {noise:g}"
    print(f"{of}, on what they were learned from, dB: {text}", flush=True)


def _gain(before: npt.NDArray, after: npt.NDArray, truth: npt.NDArray) -> float:
    was, now = (
        psnr(np.clip(np.rint(image), 0, 255), truth, border=BORDER) for image in (before, after)
    )
    return now - was


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the photographs: skimage/data")
    parser.add_argument("--write", type=Path, default=TABLES)
    arguments = parser.parse_args()
    begin = time.monotonic()
    nodes = [
        (magnification, sigma, noise)
        for magnification, sigmas in SIGMAS.items()
        for sigma in sigmas
        for noise in NOISES[magnification]
    ]
    with ProcessPoolExecutor(
        available_cores(), multiprocessing.get_context("spawn"), set_threads, (1,)
    ) as pool:
        found = list(
            pool.map(functools.partial(learn, arguments.folder), *zip(*nodes, strict=True))
        )
    tables: dict[str, npt.NDArray] = {"magnifications": np.array(list(SIGMAS))}
    for magnification, sigmas in SIGMAS.items():
        noises = NOISES[magnification]
        of_it = [filters for filters in found if filters.magnification == magnification]
        tables[f"sigmas_{magnification}"] = np.array(sigmas, np.float32)
        tables[f"noises_{magnification}"] = np.array(noises, np.float32)
        for name in ("of_one", "of_all"):
            taps = np.array([getattr(filters, name).taps for filters in of_it], np.float16)
            tables[f"{name}_{magnification}"] = taps.reshape(
                len(sigmas), len(noises), *taps.shape[1:]
            )
    with atomic_path(arguments.write) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **tables)
    print(f"{arguments.write} in {time.monotonic() - begin:.0f} s")


if __name__ == "__main__":
    main()
