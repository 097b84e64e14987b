"""Whole sessions in a real browser against the real server."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest

from tests.service.dscqs_pages.conftest import HEIGHT, TIMING, WIDTH
from tests.service.dscqs_pages.exports import document_of, given, logs_of, sides_of, votes_of


def test_a_whole_session(enter, make_test, operator, plan):
    plan = {
        **plan, "break_every": 3, "break_s": 0, "training": ["meadow/sr"],
        "stages": ["instructions", "screening", "stereo_acuity", "fatigue_before", "fatigue_after"],
        "stimuli": {**plan["stimuli"], "meadow/original": "meadow-original.png",
                    "meadow/sr": "meadow-sr.png"},
    }  # fmt: skip
    test = make_test(plan)
    seat = enter(test)
    seat.wait_for("instructions")
    seat.press_main()
    seat.fill_screening()
    seat.leave_out_stereo_acuity()
    seat.fill_fatigue()
    chance = random.Random(4)
    for _ in range(1 + 1 + 4):
        seat.come_to_vote()
        seat.vote(chance.uniform(0, 100), chance.uniform(0, 100))
    seat.fill_fatigue()
    seat.wait_for("thanks")

    votes = votes_of(operator, test)
    assert [vote["kind"] for vote in votes] == ["training", "dummy", *["test"] * 4]
    assert given(votes) == seat.clicked
    for vote, drawn in zip(votes, seat.drawn, strict=True):
        assert [item["rgb"] for item in drawn if item["stereo"]] == sides_of(vote)
    (session,) = document_of(operator, test)["sessions"]
    forms = session["forms"]
    assert forms["screening"]["colour"] == {"by": "nobody"}
    assert forms["stereo_acuity"]["done"] is False
    assert set(forms["fatigue_after"]) == set(forms["fatigue_before"])


def test_what_the_page_says_of_time_is_what_was_drawn(enter, make_test, operator, plan):
    timing = {**TIMING, "show_s": 0.7, "grey_s": 0.3, "showings": 2}
    test = make_test({**plan, "grey": 74, "timing": timing})
    seat = enter(test)
    seat.come_to_vote()
    shown = logs_of(operator, test)[-1]
    log = shown["log"]
    assert shown["outcome"] == "ok"
    assert log["faults"] == []
    assert [item["what"] for item in log["intervals"]] == ["grey", "A", "grey", "B"] * 2
    assert [item["planned_ms"] for item in log["intervals"]] == [300, 700] * 4
    drawn = [item["at"] for item in seat.drawn[0]]
    assert len(drawn) == len(log["intervals"])
    assert [item["rgb"] for item in seat.drawn[0] if not item["stereo"]] == [[74] * 3] * 4
    period = 1000 / log["refresh_hz"]
    missed_before = 0  # by the interval before: it ended late, and this one began late
    for index, item in enumerate(log["intervals"]):
        off = period * (3 + missed_before + item["late"])
        lasted = item["to_ms"] - item["from_ms"]
        assert lasted == pytest.approx(item["planned_ms"], abs=off)
        if index + 1 < len(drawn):
            assert drawn[index + 1] - drawn[index] == pytest.approx(lasted, abs=off)
        missed_before = item["late"]
    seat.vote(60, 40)
    seat.wait_until_sent()
    (vote,) = votes_of(operator, test)
    assert [item["rgb"] for item in seat.drawn[0] if item["stereo"]] == 2 * sides_of(vote)


def test_reload_at_every_step_resumes_there(enter, make_test, operator, plan):
    test = make_test({**plan, "dummies": 0, "contents": ["ballet"], "break_every": 1, "break_s": 0,
                      "stimuli": {key: name for key, name in plan["stimuli"].items()
                                  if key.startswith("ballet")},
                      "stages": ["instructions", "screening", "stereo_acuity", "fatigue_before",
                                 "fatigue_after"]})  # fmt: skip
    seat = enter(test)
    for name, act in (
        ("instructions", seat.press_main), ("screening", seat.fill_screening),
        ("stereo-acuity", seat.leave_out_stereo_acuity), ("fatigue", seat.fill_fatigue),
    ):  # fmt: skip
        seat.wait_for(name)
        seat.reload()
        seat.wait_for(name)
        act()
    for index in range(2):
        seat.wait_for("ready", "pause")
        if seat.name == "pause":
            seat.reload()
            seat.wait_for("pause")
            seat.press_main()
        seat.wait_for("ready")
        seat.reload()
        seat.wait_for("ready")
        seat.press_main()
        seat.wait_until_drawn(1)
        seat.reload()  # in the middle of the showing
        seat.come_to_vote()
        seat.grade(0, 70)
        seat.reload()  # with one grade given: the pair is shown again, nothing is kept
        seat.come_to_vote()
        assert seat.page.locator(".handle:visible").count() == 0
        seat.vote(80 - index, 30 + index)
    seat.wait_for("fatigue")
    seat.reload()
    seat.fill_fatigue()
    seat.wait_for("thanks")
    seat.reload()
    seat.wait_for("thanks")
    assert given(votes_of(operator, test)) == seat.clicked


def test_two_tabs_cannot_fork_a_session(enter, make_test, operator, plan):
    test = make_test(plan)
    first = enter(test)
    first.come_to_vote()
    second = type(first)(first.page.context.new_page())
    second.open(first.page.url)
    second.come_to_vote()
    first.page.bring_to_front()
    first.grade(0, 90)
    first.grade(1, 90)
    first.press_main()
    first.wait_for("elsewhere")
    assert votes_of(operator, test) == []
    second.page.bring_to_front()
    second.vote(60, 20)
    second.come_to_vote()
    first.page.bring_to_front()
    first.press_main()  # it is wanted here after all: the next pair, not the one before
    first.come_to_vote()
    first.vote(40, 30)
    first.come_to_vote()
    assert given(votes_of(operator, test)) == [second.clicked[0], first.clicked[0]]


def test_a_vote_waits_for_the_network_and_counts_once(enter, make_test, operator, plan):
    test = make_test(plan)
    seat = enter(test)
    seat.come_to_vote()
    seat.page.context.set_offline(True)
    seat.vote(55, 45)
    seat.page.wait_for_selector("#banner:not(:empty)")
    assert votes_of(operator, test) == []
    seat.page.context.set_offline(False)
    seat.come_to_vote()
    assert seat.page.locator("#banner").inner_text() == ""
    assert given(votes_of(operator, test)) == seat.clicked


def test_a_vote_that_was_being_sent_survives_a_reload(enter, make_test, operator, plan):
    test = make_test(plan)
    seat = enter(test)
    seat.come_to_vote()
    seat.page.route("**/grades", lambda route: route.abort())
    seat.vote(55, 45)
    seat.page.wait_for_selector("#banner:not(:empty)")
    seat.page.unroute("**/grades")
    seat.reload()
    seat.come_to_vote()
    assert given(votes_of(operator, test)) == seat.clicked


@pytest.mark.parametrize(
    ("disturb", "kind"),
    [
        ("document.exitFullscreen()", "fullscreen"),
        ("window.dispatchEvent(new Event('blur'))", "focus"),
        (
            "document.querySelector('#display').getContext('webgl2')"
            ".getExtension('WEBGL_lose_context').loseContext()",
            "graphics",
        ),
    ],
)
def test_a_disturbed_showing_is_offered_again(enter, make_test, operator, plan, disturb, kind):
    test = make_test(plan)
    seat = enter(test)
    seat.wait_for("ready")
    seat.take_screen()
    seat.stand_still_after(2)
    seat.press_main()
    seat.wait_until_drawn(2)
    seat.page.evaluate(disturb)
    seat.wait_for("failed")
    (log,) = logs_of(operator, test)
    assert log["outcome"] == "failed"
    assert [fault["kind"] for fault in log["log"]["faults"]] == [kind]
    seat.stand_still_after(math.inf)
    seat.press_main()
    seat.come_to_vote()
    seat.vote(50, 50)
    seat.wait_until_sent()
    (vote,) = votes_of(operator, test)
    assert vote["failed_showings"] == "1"


def test_a_window_that_would_scale_is_refused(enter, make_test, operator, plan):
    test = make_test(plan)
    seat = enter(test, viewport={"width": WIDTH + 20, "height": HEIGHT})
    seat.wait_for("ready")
    seat.press_main()
    seat.wait_for("display")
    assert f"{WIDTH + 20} × {HEIGHT}" in seat.page.inner_text("main")
    assert f"{WIDTH} × {HEIGHT}" in seat.page.inner_text("main")
    seat.page.set_viewport_size({"width": WIDTH, "height": HEIGHT})
    seat.press_main()
    seat.come_to_vote()


def test_a_stimulus_changed_on_its_way_is_not_shown(enter, make_test, operator, plan):
    test = make_test(plan)
    seat = enter(test)

    def spoil(route: Any) -> None:
        answer = route.fetch()
        body = bytearray(answer.body())
        body[-2000] ^= 1  # in the filler: the picture would look the same
        route.fulfill(response=answer, body=bytes(body))

    seat.page.route("**/stimulus/*", spoil)
    seat.wait_for("ready")
    seat.press_main()
    seat.wait_for("failed")
    (log,) = logs_of(operator, test)
    assert log["log"]["faults"][0]["kind"] == "bytes"
    assert log["log"]["intervals"] == []
    seat.page.unroute("**/stimulus/*")
    seat.press_main()
    seat.come_to_vote()


def test_free_switching_needs_both_and_may_look_again(enter, make_test, operator, plan):
    test = make_test({**plan, "variant": "I"})
    seat = enter(test)
    seat.wait_for("ready")
    seat.press_main()
    seat.wait_until_drawn(1)
    seat.page.keyboard.press("Enter")  # only A was seen: nothing happens
    seat.page.keyboard.press("b")
    seat.page.keyboard.press(" ")
    seat.page.keyboard.press("Enter")
    seat.wait_for("vote")
    (log,) = logs_of(operator, test)
    assert [item["what"] for item in log["log"]["intervals"]] == ["A", "B", "A"]
    seen = seat.page.evaluate("window.drawn.length")
    seat.page.click("button:has-text('Look again')")
    seat.wait_until_drawn(seen + 1)
    seat.page.keyboard.press("b")
    seat.page.keyboard.press("Enter")
    seat.wait_for("vote")
    seat.vote(66, 44)
    seat.wait_until_sent()
    assert given(votes_of(operator, test)) == seat.clicked
