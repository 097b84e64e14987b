"""Tables of images: compiled loops find what they point to, and nothing else is let in."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from pipeline.reconstruction.tables import bytes_at, floats_at, table_of


@njit
def _add_bytes(table):
    for number in range(table.shape[0]):
        image, more = floats_at(table, number, 0), bytes_at(table, number, 1)
        for row in range(image.shape[0]):
            for column in range(image.shape[1]):
                image[row, column] += more[row, column]


def test_a_loop_finds_images_of_several_sizes_where_they_lie():
    chance = np.random.default_rng(0)
    rows = [
        (chance.random(shape, np.float32), chance.integers(0, 256, shape, np.uint8))
        for shape in ((3, 5), (7, 2), (0, 4))
    ]
    expected = [image + more for image, more in rows]
    _add_bytes(table_of(rows))
    for (image, _), sums in zip(rows, expected, strict=True):
        np.testing.assert_array_equal(image, sums)


def test_no_rows_are_an_empty_table():
    assert len(table_of([])) == 0


def test_images_in_pieces_or_of_other_sizes_are_refused():
    image = np.zeros((4, 6), np.float32)
    for other in (image[:, ::2], image[:, 1:], image.T, image[:3]):
        with pytest.raises(ValueError, match="in one piece"):
            table_of([(image, other)])


def test_images_of_other_numbers_are_refused():
    image = np.zeros((4, 6), np.float32)
    for kind in (np.float64, np.int16, np.bool_):
        with pytest.raises(ValueError, match="float32 or uint8"):
            table_of([(image, image.astype(kind))])
