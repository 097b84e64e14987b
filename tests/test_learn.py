"""What filters are learned from: taps that made a picture are found again, views lie as told."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.learn import Sums, of_photograph
from pipeline.reconstruction.learned import FilterBank, num_classes
from pipeline.reconstruction.psf import GaussianPsf
from tests.support.views import make_truth


def test_the_taps_that_made_a_picture_are_found_again():
    image = make_truth((200, 220))
    taps = np.zeros((num_classes(False), 24), np.float32)
    taps[:, 23], taps[:, 17], taps[:, 10] = -0.25, 0.125, 0.05
    sums = Sums.empty(num_classes(False))
    sums.add(image, FilterBank(taps).apply(image), None)
    found = sums.solved()
    seen = np.einsum("kii->k", sums.of_squares) > 1e7
    assert seen.sum() > 10
    np.testing.assert_allclose(found.taps[seen], taps[seen], atol=0.01)


@pytest.mark.parametrize("magnification", [2, 3])
def test_every_view_of_a_photograph_shows_what_lies_where_it_lands(tmp_path, magnification):
    smooth = cv2.GaussianBlur(make_truth((90, 120)), (0, 0), 5)
    cv2.imwrite(str(tmp_path / "smooth.png"), smooth)
    psf = GaussianPsf.of(1.0)
    example = of_photograph(tmp_path / "smooth.png", magnification, psf, noise=0.0)
    assert [view.is_reference for view in example.registered] == [True] + 7 * [False]
    blurred = cv2.GaussianBlur(example.truth, (7, 7), psf.sigma, borderType=cv2.BORDER_REFLECT)
    for view in example.registered:
        place = magnification * view.position
        shown = cv2.remap(blurred, place[..., 0], place[..., 1], cv2.INTER_CUBIC)
        away = np.abs(shown - view.observed)
        inner = np.zeros(away.shape, bool)
        inner[6:-6, 6:-6] = view.flags[6:-6, 6:-6] == 0
        assert away[inner].mean() < 0.6  # rounding, and what views are misplaced by
