"""The staircase of the tests of the eyes, walked by a thousand assessors."""

from __future__ import annotations

from typing import Any

import pytest

WALK = """async ({levels, seesAt, count}) => {
  const {answer, begin, threshold} = await import("/staircase.js");
  const {pick, randomFrom} = await import("/random.js");
  return Array.from({length: count}, (_, seed) => {
    const random = randomFrom(seed);
    let state = begin(levels);
    while (!state.isOver) state = answer(state, state.at <= seesAt || pick(random, 3) === 0);
    return threshold(state);
  });
}"""


def walk(tab: Any, shown: list[bool], sees_at: int) -> list[int | None]:
    """Return what is recorded of assessors who see that far, and guess one of three below."""
    levels = [{"value": index, "isShown": is_shown} for index, is_shown in enumerate(shown)]
    return tab.evaluate(WALK, {"levels": levels, "seesAt": sees_at, "count": 1000})


@pytest.mark.parametrize("sees_at", [0, 4])
def test_guesses_hardly_ever_pass_for_sight(tab: Any, sees_at):
    """By chance, a level is passed once in 27 times and two of them once in 729."""
    found = walk(tab, [True] * 10, sees_at)
    assert min(found) == sees_at
    assert found.count(sees_at) == pytest.approx(1000 * 26 / 27, abs=20)
    assert sum(one > sees_at + 1 for one in found) < 7


def test_who_sees_nothing_passes_nothing(tab: Any):
    found = walk(tab, [True] * 10, -1)
    assert found.count(None) == pytest.approx(1000 * 26 / 27, abs=20)


def test_levels_that_are_not_shown_are_left_out(tab: Any):
    assert set(walk(tab, [False, True, True, False, True, False], 5)) == {4}
