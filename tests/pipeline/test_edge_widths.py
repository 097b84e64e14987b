"""Widths of edges: blurred discs, seen by views whose shifts are known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from pipeline.edge_widths import measure_edges
from pipeline.frames import RegisteredView, Rejection
from pipeline.grid import Grid, Sampling

SQUARE = Grid(magnification_x=2, magnification_y=2, sampling=Sampling.DECIMATION)
SQUEEZED = Grid(magnification_x=2, magnification_y=1, sampling=Sampling.AREA)
SHIFTS = ((0.0, 0.0), (0.5, 0.25), (-0.25, 0.5), (0.25, -0.5))
"""Of the views, LR pixels."""
NOISE = 1.0
APART, RADIUS = 40, 13
"""Of the discs, LR pixels."""


def blurred_step(distance, gradient_x, gradient_y, sigma, grid):
    """Blur along the axes that are enlarged; gradients are those of the distance, LR pixels."""
    along_x = gradient_x * sigma / grid.magnification_x if grid.magnification_x > 1 else 0
    along_y = gradient_y * sigma / grid.magnification_y if grid.magnification_y > 1 else 0
    return ndtr(distance / np.maximum(np.hypot(along_x, along_y), 1e-3))


def registered(sigma, grid, profile):
    generator = np.random.default_rng(5)
    rows, columns = np.mgrid[:120, :160].astype(np.float64)
    views = []
    for number, (shift_x, shift_y) in enumerate(SHIFTS):
        x, y = columns + shift_x, rows + shift_y
        from_x, from_y = (axis % APART - APART / 2 for axis in (x, y))
        radius = np.maximum(np.hypot(from_x, from_y), 1e-6)
        picture = profile(radius - RADIUS, from_x / radius, from_y / radius, sigma, grid)
        observed = 60 + 120 * picture + generator.normal(0, NOISE, rows.shape)
        views.append(
            RegisteredView(
                view_id=f"v{number}", observed=observed.astype(np.float32),
                position=np.stack((x, y), axis=-1).astype(np.float32),
                registration_weights=np.zeros(rows.shape, np.float32),
                flags=np.zeros(rows.shape, np.uint8),
                confidence=np.ones(rows.shape, np.float32), is_reference=number == 0,
            )
        )  # fmt: skip
    return views


@pytest.mark.parametrize("grid", [SQUARE, SQUEEZED])
@pytest.mark.parametrize("sigma", [0.7, 1.6])
def test_widths_are_those_of_the_blur_and_as_uncertain_as_they_say(sigma, grid):
    edges = measure_edges(registered(sigma, grid, blurred_step), grid, NOISE)
    assert edges.width.size >= 20
    assert np.median(edges.width) == pytest.approx(sigma, rel=0.03)
    assert 0.5 < np.std((edges.width - sigma) / edges.error) < 2


def test_lines_are_no_edges():
    def line(distance, *more):
        return blurred_step(distance + 0.5, *more) - blurred_step(distance - 0.5, *more)

    assert measure_edges(registered(1.0, SQUARE, line), SQUARE, NOISE).width.size == 0


def test_an_edge_that_one_view_alone_sees_is_not_believed():
    own, *others = registered(1.0, SQUARE, blurred_step)
    blind = [
        replace(view, flags=np.full_like(view.flags, Rejection.OCCLUDED)) for view in others
    ]  # fmt: skip
    assert measure_edges([own, *blind], SQUARE, NOISE).width.size == 0


def test_a_picture_without_edges_has_none():
    flat = registered(1.0, SQUARE, lambda distance, *_: 0 * distance)
    assert measure_edges(flat, SQUARE, NOISE).width.size == 0
