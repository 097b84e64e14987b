"""What an assessor gets tells nothing of what it is: names, headers, sizes, bytes, times.

The measure of everything is a test condition that *is* the reference (the same file): whatever
tells its servings from those of the reference would tell sides apart by something else than the
picture. Conditions of other pictures have files of other lengths, and must not differ in
anything around the picture either.
"""

from __future__ import annotations

import json
import shutil
import time
from collections import defaultdict

import httpx
import numpy as np
import pytest
from scipy import stats

from dscqs.stimulus import RANDOM_BYTES
from service.dscqs_client import OperatorClient
from service.http.dscqs_access import TOKEN_FILE
from tests.service.dscqs.support import REFERENCE, walk, write_stimuli
from tests.support.assessor_client import AssessorClient
from tests.support.waiting import PATIENCE

SERVINGS = 150
"""Presentations that are asked for, two sides each."""

CHANCE = 1e-9
"""Probability below which what was seen is no chance: these draws are new in every run.

What has a structure lies far below it: one byte value that never comes gives less than 1e-50, and
75 times of which each is on the same side give 1e-13.
"""


@pytest.fixture(scope="module")
def servings(served, stimuli):
    """Answers by what they were of: ``reference``, ``same`` (the same file), ``test``."""
    (served.root / "set1" / "copy.png").write_bytes(
        (served.root / "set1" / stimuli["ballet/original"]).read_bytes()
    )
    plan = {
        "name": "privacy", "folder": "set1", "contents": ["ballet"], "dummies": 0, "stages": [],
        "conditions": ["same", "sr"], "reference": REFERENCE, "repetitions": 2,
        "stimuli": {
            "ballet/original": stimuli["ballet/original"], "ballet/same": "copy.png",
            "ballet/sr": stimuli["ballet/sr"],
        },
    }  # fmt: skip
    found = defaultdict(list)
    with httpx.Client(base_url=served.url, timeout=PATIENCE) as http:
        operator = OperatorClient(http=http)
        operator.login(served.token)
        test = operator.make_test(plan)
        with httpx.Client(base_url=served.url, timeout=PATIENCE) as browser:
            client = AssessorClient(http=browser)
            client.enter(operator.invite(test, "a1", "polarised"))
            order = operator.document(test)["sessions"][0]["order"]
            for item in order:
                for sides in SERVINGS // len(order) // 2 * ["AB", "BA"]:
                    _serve(client, item, sides, found)
                client.shown()
                client.grade({"quality": {"A": 50.0, "B": 50.0}})
    return found


def _serve(client, item, sides, found):
    offered = client.http.get("/dscqs/api/assessor/presentation")
    client.presentation = offered.json()
    number = sum(map(len, found.values())) // 2
    for side in sides:
        is_reference = item["reference_is_a"] == (side == "A")
        kind = "reference" if is_reference else "same" if item["condition"] == "same" else "test"
        begin = time.perf_counter()
        answer = client.http.get(client.presentation["sides"][side])
        seconds = time.perf_counter() - begin
        assert answer.status_code == 200
        found[kind].append((client.presentation["sides"][side], answer, seconds, side, number))


def test_there_is_something_to_compare(servings):
    counts = {kind: len(answers) for kind, answers in servings.items()}
    assert counts["reference"] == counts["same"] + counts["test"]
    assert min(counts.values()) >= SERVINGS // 3


def test_addresses_are_of_one_form_and_never_the_same(servings):
    addresses = [address for answers in servings.values() for address, *_ in answers]
    assert len(set(addresses)) == len(addresses)
    assert len({len(address) for address in addresses}) == 1
    letters = "".join(address.rsplit("/", 1)[1] for address in addresses)
    assert len(set(letters)) == 64  # base64url, every letter of it


def test_headers_are_the_same_but_for_date_and_digest(servings):
    seen = {
        tuple(
            (name, value) for name, value in answer.headers.items()
            if name not in ("date", "repr-digest")
        )
        for answers in servings.values() for _, answer, *_ in answers
    }  # fmt: skip
    assert len(seen) == 1
    names = {name for name, _ in seen.pop()}
    assert not names & {"etag", "last-modified", "content-disposition", "accept-ranges"}


def test_all_have_one_length_and_none_the_bytes_of_another(servings):
    bodies = [answer.content for answers in servings.values() for _, answer, *_ in answers]
    assert len({len(body) for body in bodies}) == 1
    assert len(set(bodies)) == len(bodies)
    digests = [a.headers["repr-digest"] for answers in servings.values() for _, a, *_ in answers]
    assert len(set(digests)) == len(digests)


def test_the_same_picture_differs_in_random_bytes_only(servings):
    """Reference and test of the same picture: equal up to the filler's end, random after it."""
    tails = []
    heads = set()
    for kind in ("reference", "same"):
        for _, answer, *_ in servings[kind]:
            body, end = answer.content, len(answer.content) - 16
            heads.add(body[: end - RANDOM_BYTES])
            tails.append((kind, body[end - RANDOM_BYTES : end]))
    assert len(heads) == 1
    counts = [
        [sum(tail.count(value) for kind, tail in tails if kind == wanted) for value in range(256)]
        for wanted in ("reference", "same")
    ]
    for observed in counts:
        assert stats.chisquare(observed).pvalue > CHANCE
    assert stats.chi2_contingency(counts).pvalue > CHANCE


def test_what_is_not_random_would_be_seen(servings):
    """One byte value missing, or one kind with its own: both are below what chance can do."""
    size = RANDOM_BYTES * len(servings["same"])
    one_missing = np.append(np.full(255, size / 255), 0)
    assert stats.chisquare(one_missing).pvalue < CHANCE
    assert stats.chi2_contingency([np.full(256, size / 256), one_missing]).pvalue < CHANCE
    later = 1e-6 * np.arange(1, len(servings["same"]) + 1)
    assert stats.wilcoxon(later).pvalue < CHANCE


@pytest.mark.parametrize("kind", ["same", "test"])
def test_times_do_not_tell_reference_from_test(servings, kind):
    """Although the files differ in length by a factor of three.

    Both sides of one presentation are asked for in turn, each of them first as often as the
    other: what else the machine does at that time, and the first's being first, concern both.
    """
    reference = {number: seconds for *_, seconds, _, number in servings["reference"]}
    differences = [seconds - reference[number] for *_, seconds, _, number in servings[kind]]
    assert stats.wilcoxon(differences).pvalue > CHANCE


def test_sides_are_no_hint(servings):
    sides = [side for *_, side, _ in servings["reference"]]
    assert sides.count("A") == len(sides) / 2


def test_nothing_that_is_sent_names_a_stimulus(operator, enter, plan, served):
    """Every byte of a whole session, heads and bodies, the pictures' own among them.

    Names are long, since random bytes and addresses hold any four letters once in some hundred
    sessions.
    """
    folder = "folder-of-stimuli"
    shutil.copytree(served.root / "set1", served.root / folder)
    test = operator.make_test({**plan, "folder": folder})
    client = enter(test)
    sent: list[bytes] = []

    def keep(answer: httpx.Response) -> None:
        answer.read()
        sent.append(answer.content)
        sent.extend(name + b": " + value for name, value in answer.headers.raw)

    client.http.event_hooks["response"].append(keep)
    walk(client)
    said = b"\n".join(sent).lower()
    record = operator.http.get(f"/dscqs/api/operator/tests/{test}").json()
    document = operator.document(test)
    words = {REFERENCE, "bicubic", "ballet", "street", "meadow", "reference"}
    words |= {"dummy", "condition"}
    words |= {name for name in record["plan"]["stimuli"].values()}
    words |= {file["sha256"] for file in document["files"].values()}
    words |= {test, document["sessions"][0]["session"], "reference_is_a", folder}
    assert len(sent) > 100
    assert [word for word in words if word.lower().encode() in said] == []


def test_presentations_look_alike_whatever_they_are(operator, enter, plan):
    """Training, dummies and what counts; other contents, other conditions."""
    client = enter(operator.make_test(plan))
    shapes = set()

    def look(state: dict) -> bool:
        if state["stage"] in ("training", "presentation"):
            view = client.present()
            view.pop("ticket")
            view.pop("sides")
            shapes.add(json.dumps(view))
        return False

    walk(client, until=look)
    assert len(shapes) == 1


def test_an_assessor_can_read_nothing_else(operator, plan, make_service, tmp_path):
    """With the cookie of an assessor, every address of the service, on one with tokens."""
    (tmp_path / "tokens").write_text("lab assess 0123456789abcdef\nboss read 0123456789abcdeg\n")
    write_stimuli(tmp_path / "roots" / "set1")
    service = make_service(
        "--workers", "0", "--token-file", str(tmp_path / "tokens"),
        "--roots", str(tmp_path / "roots"),
    )  # fmt: skip
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as http:
        lab = OperatorClient(http=http)
        assert not (service.data / TOKEN_FILE).exists()
        lab.login("0123456789abcdef")
        test = lab.make_test(plan)
        link = lab.invite(test, "a1", "polarised")
        description = http.get("/api/openapi.json").json()
        with httpx.Client(base_url=service.url, timeout=PATIENCE) as browser:
            AssessorClient(http=browser).enter(link)
            read = []
            for path, methods in description["paths"].items():
                if "get" not in methods or path.startswith(("/dscqs/api/assessor", "/dscqs/pages")):
                    continue
                for name in (test, "x"):
                    asked = path
                    while "{" in asked:
                        begin, end = asked.index("{"), asked.index("}")
                        asked = asked[:begin] + name + asked[end + 1 :]
                    answer = browser.get(asked)
                    if answer.status_code == 200:
                        read.append(path)
        wrong = OperatorClient(http=http)
        assert http.post("/dscqs/api/operator/logout").status_code == 204
        assert wrong.http.get("/dscqs/api/operator/tests").status_code == 401
        for token in ("0123456789abcdeg", "no token at all!"):
            answer = http.post("/dscqs/api/operator/login", json={"token": token})
            assert answer.status_code == 401
    assert set(read) <= {"/healthz", "/readyz", "/api/v1/settings-schema"}
