"""The player against a clock that the test moves: what is late, stalls or is dropped is said."""

from __future__ import annotations

from typing import Any

import pytest

PERIOD = 16
PLAY = """async ({timing, clip, times, captions}) => {
  const {play} = await import("/player.js");
  const waiting = [];
  const drawn = [];
  const side = (name) => ({
    pixels: name, current: null, begin: async () => {}, rest: () => {},
    count: clip.count, frameMs: clip.frameMs ?? Infinity, isWhole: true,
    prepare(index) {
      this.current = index === clip.missing ? null : `${name}${index}`;
      return this.current;
    },
  });
  const done = play({
    presentation: {timing, captions, grey: 128},
    sides: {A: side("A"), B: side("B")},
    letters: {A: "letter A", B: "letter B"},
    screen: {
      needsScreen: true, isRedrawn: false,
      draw: (source) => drawn.push(source), requestFrame: (callback) => waiting.push(callback),
    },
    environment: {period: async () => 16, watch: () => () => {}},
  });
  await new Promise((resolve) => setTimeout(resolve));
  for (const time of times) waiting.splice(0).forEach((callback) => callback(time));
  return {log: await done, drawn: drawn.filter((source) => source !== null)};
}"""
TIMING = {"show_s": 0.16, "grey_s": 0.08, "showings": 1, "tolerance_s": 0.02}
STILL, CLIP = {"count": 1}, {"count": 10, "frameMs": PERIOD}


def play(
    tab: Any,
    clip: dict[str, Any],
    *missed: tuple[int, int],
    captions: bool = False,
    **timing: float,
) -> Any:
    """Play grey, A, grey, B (80, 160, 80, 160 ms); `missed` are refresh and how many more pass."""
    times = list(range(0, 1000, PERIOD))
    for refresh, count in missed:
        times = [time + (PERIOD * count if time >= refresh * PERIOD else 0) for time in times]
    asked = {"timing": {**TIMING, **timing}, "clip": clip, "times": times, "captions": captions}
    return tab.evaluate(PLAY, asked)


@pytest.mark.parametrize(("clip", "frames"), [(STILL, 1), (CLIP, 10)])
def test_what_goes_as_planned_has_no_fault(tab: Any, clip, frames):
    played = play(tab, clip)
    log = played["log"]
    assert log["faults"] == []
    assert [(one["what"], one["to_ms"] - one["from_ms"]) for one in log["intervals"]] == [
        ("grey", 80), ("A", 160), ("grey", 80), ("B", 160),
    ]  # fmt: skip
    assert [one["frames"] for one in log["intervals"]] == [1, frames, 1, frames]
    assert played["drawn"] == [f"{side}{index}" for side in "AB" for index in range(frames)]


def test_letters_lie_on_the_grey_before_each_side(tab: Any):
    played = play(tab, STILL, captions=True, showings=2)
    assert played["log"]["faults"] == []
    assert played["drawn"] == ["letter A", "A0", "letter B", "B0"] * 2


def test_a_refresh_missed_within_a_still_is_counted_and_does_no_harm(tab: Any):
    log = play(tab, STILL, (8, 2))["log"]
    assert log["faults"] == []
    assert [one["late"] for one in log["intervals"]] == [0, 2, 0, 0]


@pytest.mark.parametrize(
    ("clip", "missed", "timing", "kind", "said"),
    [
        (STILL, (14, 6), {}, "late", "A lasted 240"),
        (STILL, (2, 18), {"tolerance_s": 1}, "stall", "A was not shown at all"),
        (CLIP, (8, 6), {}, "stall", "no refresh for 112 ms"),
        (CLIP, (8, 2), {}, "dropped", "2 frame(s) before frame 5 of A"),
        ({**CLIP, "missing": 3}, (0, 0), {}, "late", "frame 3 of A was not decoded"),
    ],
)
def test_what_does_not_go_as_planned_is_a_fault(tab: Any, clip, missed, timing, kind, said):
    log = play(tab, clip, missed, **timing)["log"]
    (fault,) = log["faults"]
    assert fault["kind"] == kind
    assert said in fault["detail"]


def test_late_within_the_tolerance_of_the_plan_is_no_fault(tab: Any):
    assert play(tab, STILL, (14, 4))["log"]["faults"][0]["kind"] == "late"
    log = play(tab, STILL, (14, 4), tolerance_s=0.1)["log"]
    assert log["faults"] == []
    assert sum(one["late"] for one in log["intervals"]) == 4
