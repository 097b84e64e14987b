"""A depth map cleaned only where it is asked for is there what it is when all of it is cleaned."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.registration.cleaning import cleaned_where
from pipeline.registration.prepare import cleaned


@pytest.mark.parametrize("shape", [(4, 30), (5, 5), (33, 17), (40, 100), (61, 301)])
@pytest.mark.parametrize("share", [0.01, 0.2, 1.0])
@pytest.mark.parametrize("kind", ["all differ", "few levels", "unknown here and there", "flat"])
def test_it_is_what_it_is_when_all_is_cleaned(shape, share, kind):
    chance = np.random.default_rng(0)
    depth_map = chance.random(shape).astype(np.float32)
    if kind == "few levels":
        depth_map = np.rint(4 * depth_map)
    elif kind == "unknown here and there":
        depth_map[chance.random(shape) < 0.03] = np.nan
    elif kind == "flat":
        depth_map[:] = 0.5
    wanted = chance.random(shape) < share
    found = cleaned_where(depth_map, wanted)
    np.testing.assert_array_equal(found[wanted], cleaned(depth_map)[wanted])


def test_a_map_that_must_not_be_written_to_is_only_read():
    depth_map = np.arange(600, dtype=np.float32).reshape(20, 30)
    depth_map.flags.writeable = False
    wanted = np.ones(depth_map.shape, np.bool_)
    np.testing.assert_array_equal(cleaned_where(depth_map, wanted), cleaned(depth_map))
