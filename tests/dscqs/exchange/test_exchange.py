"""Votes to other formats and back; what others wrote; what is refused, and how."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dscqs.errors import VotesError
from dscqs.exchange.files import Format, format_scores, parse_scores, read_scores
from dscqs.exchange.sujson import from_sujson, to_sujson
from dscqs.exchange.sureal import from_sureal, to_sureal
from dscqs.votes import Method, Order, Vote, make_table

GRADE = st.integers(0, 1000).map(lambda tenths: tenths / 10)
NAME = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cs", "Cc", "Zs", "Zl", "Zp")), min_size=1,
    max_size=8,
)  # fmt: skip


@st.composite
def tables(draw):
    """Double-stimulus votes with gaps, dummies, two dimensions, odd names, further columns."""
    names = [draw(st.lists(NAME, min_size=1, max_size=3, unique=True)) for _ in range(4)]
    keys = draw(
        st.lists(
            st.tuples(*(st.sampled_from(each) for each in names), st.integers(1, 3),
                      st.sampled_from(["quality", "comfort"])),
            min_size=1, max_size=12, unique=True,
        )
    )  # fmt: skip
    grade = st.one_of(st.none(), GRADE)
    first = Vote(
        assessor=names[0][0], display=names[1][0], content=names[2][0], condition=names[3][0],
        kind="dummy", grade_reference=50.0, grade_test=40.0,
    )  # fmt: skip
    return make_table(
        [
            first,
            *(
                Vote(
                    assessor=a, display=d, content=k, condition=c, repetition=r, dimension=m,
                    grade_reference=draw(grade), grade_test=draw(grade),
                    extra={"order": str(draw(st.integers(1, 99)))} if draw(st.booleans()) else {},
                )
                for a, d, k, c, r, m in keys
            ),
        ],
        name="made up",
    )  # fmt: skip


@given(table=tables())
@settings(max_examples=15, deadline=None)
def test_sujson_gives_back_every_vote(table):
    text = format_scores(table, Format.SUJSON)
    assert parse_scores(text).votes == table.votes


@given(table=tables())
@settings(max_examples=15, deadline=None)
def test_tidy_csv_gives_back_every_vote(table):
    found = parse_scores(format_scores(table, Format.CSV, notes=["made up"])).votes
    columns = {name for vote in table.votes for name in vote.extra}
    wanted = [
        dataclasses.replace(vote, extra={name: vote.extra.get(name, "") for name in columns})
        for vote in table.votes
    ]
    assert list(found) == wanted


PLANNED = Order(
    displays=("polarised", "auto"), contents=("street", "ballet"), conditions=("sr", "bicubic"),
    dimensions=("quality", "comfort"),
)  # fmt: skip
AS_SHOWN = make_table(
    [
        Vote(assessor="a1", display=display, content=content, condition=condition,
             dimension=dimension, grade_reference=60.0, grade_test=50.0)
        for dimension in ("comfort", "quality")
        for display in ("auto", "polarised")
        for content in ("lawn", "ballet", "street")
        for condition in ("bicubic", "sr")
    ],
    order=PLANNED,
)  # fmt: skip


@pytest.mark.parametrize("kind", [Format.CSV, Format.SUJSON])
def test_the_order_of_the_plan_goes_with_the_votes(kind):
    found = parse_scores(format_scores(AS_SHOWN, kind))
    assert (found.order, found.votes) == (PLANNED, AS_SHOWN.votes)


def test_a_note_that_says_no_order_is_a_note():
    lines = ["# conditions: sr, bicubic", "# contents: [1]", '# displays: ["auto"]', "#"]
    text = "\n".join([*lines, "assessor,content,condition,difference", "a1,c,x,3"])
    assert parse_scores(text).order == Order(displays=("auto",))


def test_files_of_others_have_the_order_of_the_plan():
    sujson = to_sujson(AS_SHOWN)
    names = {key: [one["name"] for one in sujson[key]] for key in ("src", "hrc")}
    assert names == {"src": ["street", "ballet", "lawn"], "hrc": ["sr", "bicubic"]}
    assert [one["characteristics"]["dimension"] for one in sujson["questions"][::2]] == [
        "quality", "comfort",
    ]  # fmt: skip
    sureal = to_sureal(AS_SHOWN, display="auto", dimension="quality")
    assert [one["content_name"] for one in sureal["ref_videos"]] == names["src"]
    assert [one["path"] for one in sureal["dis_videos"][3:]] == [
        f"{content}/{condition}" for content in names["src"] for condition in names["hrc"]
    ]


def test_a_dataset_of_sureal_holds_grades_and_the_reference_as_a_stimulus():
    table = make_table(
        Vote(assessor=a, display="d", content=k, condition=c, repetition=r,
             grade_reference=80.0 + r, grade_test=60.0 + i)
        for i, a in enumerate(("ann", "bob"))
        for k in ("k1", "k2") for c in ("bicubic", "sharp") for r in (1, 2)
    )  # fmt: skip
    made = to_sureal(table, display="d", dimension="quality")
    assert made["ref_score"] == 100
    assert [video["path"] for video in made["ref_videos"]] == ["k1/reference", "k2/reference"]
    by_path = {video["path"]: video["os"] for video in made["dis_videos"]}
    assert by_path["k2/sharp"] == {"ann": [60.0, 60.0], "bob": [61.0, 61.0]}
    assert by_path["k1/reference"]["ann"] == [81.0, 82.0, 81.0, 82.0]
    back = from_sureal(made, "x")
    assert back.method is Method.SCORE
    assert len(back.votes) == 2 * 2 * (2 * 2 + 4)


def test_differences_of_a_dataset_of_sureal_are_turned():
    table = make_table([Vote(assessor="a", content="k", condition="c", difference=-12.5)])
    (video,) = to_sureal(table, display="display", dimension="quality")["dis_videos"]
    assert video["os"] == {"a": 112.5}


def test_public_datasets_of_sureal(subjective_dir):
    """Lists and objects of scores, with repetitions, as in the files that sureal tests with."""
    for name, votes, repetitions in (("mini_dict", 9, 1), ("mini_repetitions", 13, 3)):
        data = json.loads((subjective_dir / f"{name}.json").read_text())
        dataset = {
            "dataset_name": name,
            "ref_videos": [{"content_id": 0, "content_name": "foo", "path": "png/foo.png"}],
            "dis_videos": [
                {"content_id": shown["content_id"], "asset_id": shown["asset_id"],
                 "path": f"png/{shown['label']}",
                 "os": dict(zip(data["observers"], scores, strict=True))}
                for shown, scores in zip(data["presentations"], data["scores"], strict=True)
            ],
        }  # fmt: skip
        table = parse_scores(json.dumps(dataset))
        assert len(table.votes) == votes
        assert {vote.condition for vote in table.votes} == {"baz1.png", "baz2.png", "baz3.png"}
        assert {vote.content for vote in table.votes} == {"foo", "1"}
        assert max(vote.repetition for vote in table.votes) == repetitions
    means = [
        np.mean([vote.score for vote in table.votes if vote.condition == name])
        for name in ("baz1.png", "baz2.png")
    ]
    assert means == pytest.approx([np.mean([4, 1, 3, 2]), np.mean([1, 3, 3, 1, 2, 2])])


FOREIGN = {
    "dataset_name": "of another laboratory",
    "scales": [{"id": 1, "name": "ACR5", "range": {"min": 1, "max": 5}}],
    "questions": [{"id": 1, "question": "Please rate the overall quality", "scale_id": 1}],
    "src": [{"id": 1, "name": "BigBuckBunny"}],
    "hrc": [{"id": 1, "characteristics": {"codec": "H264"}}, {"id": 2, "name": "slow"}],
    "pvs": [
        {"id": 1, "src_id": 1, "hrc_id": 1, "path": "/one.yuv"},
        {"id": 2, "src_id": 1, "hrc_id": 2, "path": "/two.yuv"},
        {"id": 3, "path": "/three.yuv"},
    ],
    "subjects": [{"id": 1}, {"id": 2, "name": "bob"}],
    "trials": [
        {"id": 1, "subject_id": 1, "pvs_id": [1, 2], "score_id": [1, 2]},
        {"id": 2, "subject_id": 1, "pvs_id": 1, "score_id": 3},
        {"id": 3, "subject_id": 2, "pvs_id": 3, "score_id": [4]},
    ],
    "scores": [
        {"id": 1, "question_id": 1, "score": 4, "pvs_id": 1},
        {"id": 2, "question_id": 1, "score": 3, "pvs_id": 2},
        {"id": 3, "question_id": 1, "score": 5},
        {"id": 4, "question_id": 1, "score": 2, "pvs_id": 3},
        {"id": 5, "question_id": 1, "score": 3.5, "pvs_id": 1},
    ],
}


def test_sujson_of_others_is_read_by_names_or_numbers():
    table = from_sujson(FOREIGN, "x.json")
    assert table.name == "of another laboratory"
    assert [
        (v.assessor, v.content, v.condition, v.repetition, v.score) for v in table.votes
    ] == [
        ("1", "BigBuckBunny", "1", 1, 4.0),
        ("1", "BigBuckBunny", "slow", 1, 3.0),
        ("1", "BigBuckBunny", "1", 2, 5.0),
        ("bob", "all", "/three.yuv", 1, 2.0),
    ]  # fmt: skip
    assert {vote.dimension for vote in table.votes} == {"quality"}


def changed(way, value):
    """Return the document of others with one value replaced."""
    document = json.loads(json.dumps(FOREIGN))
    *steps, last = way
    place = document
    for step in steps:
        place = place[step]
    place[last] = value
    return document


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (changed(["scores", 1, "score"], 7), "scores[1].score: 7 is outside its scale, 1 … 5"),
        (changed(["scores", 1, "score"], "4"), "scores[1].score: '4' is not a number"),
        (changed(["scores", 0, "pvs_id"], [1, 2]), "compares stimuli"),
        (changed(["trials", 0, "subject_id"], 9), "there is no subjects[id = 9]"),
        (changed(["trials", 0, "score_id"], [1, 8]), "there is no scores[id = 8]"),
        (changed(["pvs", 1, "id"], 1), "pvs[1]: id 1 is there twice"),
        (changed(["trials"], {}), "trials: must be a list"),
        (changed(["subjects"], None), "has no 'subjects'"),
        (changed(["trials", 2], 5), "trials[2]: must be an object"),
    ],
)
def test_sujson_that_contradicts_itself_is_refused_by_place_and_rule(document, message):
    with pytest.raises(VotesError) as caught:
        parse_scores(json.dumps(document), name="x.json")
    assert str(caught.value).startswith("x.json")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"trials": [],\n "scores": [1,]}', "x.json, line 2: is not JSON"),
        ('{"dis_videos": NaN}', "x.json: NaN is not JSON (a missing vote is null)"),
        ('{"votes": []}', "neither suJSON"),
        ("[]", "neither suJSON"),
        ('{"dis_videos": []}', "there is no vote in it"),
        ('{"dis_videos": [{"content_id": 0, "asset_id": 1}]}', "dis_videos[0]: has no 'os'"),
        ('{"dis_videos": [{"content_id": 0, "asset_id": 1, "os": [1, "x"]}]}',
         "dis_videos[0].os[1]: 'x' is not a number"),
        ('{"dis_videos": [{"content_id": 0, "asset_id": 1, "os": {"a": [1, true]}}]}',
         "dis_videos[0].os['a'][1]: True is not a number"),
        ("[" * 100000, "x.json"),
    ],
)  # fmt: skip
def test_json_of_nothing_known_is_refused(text, message):
    with pytest.raises(VotesError, match=r"x\.json") as caught:
        parse_scores(text, name="x.json")
    assert message in str(caught.value)


def test_python_is_never_executed(tmp_path):
    path = tmp_path / "dataset.py"
    path.write_text("raise SystemExit('executed')\n")
    with pytest.raises(VotesError, match="would have to be executed"):
        read_scores(path)


def test_a_dataset_of_sureal_has_one_display():
    table = make_table(
        Vote(assessor="a", display=d, content="k", condition="c", difference=1.0) for d in "xy"
    )
    with pytest.raises(VotesError, match="several: x, y"):
        format_scores(table, Format.SUREAL)
    assert '"os"' in format_scores(table, Format.SUREAL, display="y")
    with pytest.raises(VotesError, match="no vote on display 'z'"):
        format_scores(table, Format.SUREAL, display="z")


def test_sujson_writes_what_a_reader_of_the_format_wants():
    table = make_table(
        [Vote(assessor="a", content="k", condition="c", grade_reference=80.0, grade_test=60.5)]
    )
    made = to_sujson(table)
    assert [item["score"] for item in made["scores"]] == [80.0, 60.5]
    assert [item["range"] for item in made["scales"]] == [{"min": 0, "max": 100}] * 2
    assert all("higher is better" in item["description"] for item in made["scales"])
    (trial,) = made["trials"]
    assert trial["score_id"] == [1, 2]
    assert trial["characteristics"] == {
        "display": "display", "repetition": 1, "dimension": "quality", "kind": "test",
    }  # fmt: skip
