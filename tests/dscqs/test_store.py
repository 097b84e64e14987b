"""One contract for the store on disk and its twin in memory; what the one on disk does besides."""

from __future__ import annotations

import dataclasses
import sqlite3
import threading

import pytest

from dscqs.errors import DscqsError, NotFound, OrderError, UsedUp
from dscqs.sqlite_store import SqliteSessionStore
from dscqs.store import MemorySessionStore, SessionRecord, SessionStore, TestRecord
from tests.support.waiting import PATIENCE

TEST = TestRecord(id="t1", name="set 1", plan={"name": "set 1"}, files={}, created=1.0)
SESSION = SessionRecord(
    id="s1", test="t1", number=0, assessor="a1", display="auto", language="en",
    order=({"content": "c", "kind": "test"},), order_version=1, created=2.0,
)  # fmt: skip


@pytest.fixture(params=["memory", "sqlite"])
def store(request, tmp_path):
    clock = iter(range(10, 1000)).__next__
    made: SessionStore = (
        MemorySessionStore(clock)
        if request.param == "memory"
        else SqliteSessionStore(tmp_path / "dscqs.sqlite", clock=clock)
    )
    made.add_test(TEST)
    made.add_session(SESSION)
    yield made
    made.close()


def test_what_was_added_is_there(store):
    assert store.test("t1") == TEST
    assert store.tests() == [TEST]
    assert store.session("s1") == SESSION
    assert store.sessions("t1") == [SESSION]


def test_what_was_not_added_is_not(store):
    for ask in (store.test, store.session):
        with pytest.raises(NotFound):
            ask("nothing")
    assert store.sessions("nothing") == []
    assert store.session_of("nothing") is None
    with pytest.raises(NotFound):
        store.use_link("nothing", "c")


def test_one_session_for_assessor_and_display(store):
    with pytest.raises(OrderError, match="a1 has a session on auto"):
        store.add_session(dataclasses.replace(SESSION, id="s2"))
    store.add_session(dataclasses.replace(SESSION, id="s2", display="polarised"))
    assert [record.id for record in store.sessions("t1")] == ["s1", "s2"]


def test_events_have_numbers_and_times(store):
    store.append("s1", [("joined", {}), ("continued", {"stage": "break"})])
    store.append("s1", [("paused", {})])
    events = store.events("s1")
    assert [(event.sequence, event.name) for event in events] == [
        (1, "joined"), (2, "continued"), (3, "paused"),
    ]  # fmt: skip
    assert events[1].data == {"stage": "break"}
    assert [event.at for event in events] == sorted(event.at for event in events)


def test_answers_can_be_erased_and_events_stay(store):
    store.append("s1", [("formfilled", {"stage": "screening"})], form=("screening", {"age": 31}))
    assert store.forms("s1") == {"screening": {"age": 31}}
    store.erase("s1")
    assert store.forms("s1") == {}
    assert len(store.events("s1")) == 1


def test_a_link_works_once_and_the_newest_cookie_counts(store):
    store.add_link("old", "s1")
    store.add_link("link", "s1")
    with pytest.raises(UsedUp):
        store.use_link("old", "c0")
    assert store.use_link("link", "c1") == "s1"
    with pytest.raises(UsedUp):
        store.use_link("link", "c2")
    assert store.use_link("link", "c1") == "s1"  # the first answer was lost
    assert store.session_of("c1") == "s1"
    store.add_link("next", "s1")
    assert store.session_of("c1") == "s1"  # until the new link is opened
    store.use_link("next", "c3")
    assert (store.session_of("c1"), store.session_of("c3")) == (None, "s1")


def test_a_file_holds_what_was_stored_and_nothing_of_what_was_erased(tmp_path):
    path = tmp_path / "dscqs.sqlite"
    store = SqliteSessionStore(path)
    store.add_test(TEST)
    store.add_session(SESSION)
    store.append("s1", [("formfilled", {})], form=("screening", {"eyes": "weak-left-eye " * 400}))
    assert any(b"weak-left-eye" in file.read_bytes() for file in tmp_path.iterdir())
    store.erase("s1")
    assert not any(b"weak-left-eye" in file.read_bytes() for file in tmp_path.iterdir())
    store.close()
    again = SqliteSessionStore(path)
    assert len(again.events("s1")) == 1
    again.close()


@pytest.mark.parametrize("table", ["test", "session", "event"])
@pytest.mark.parametrize("change", ["DELETE FROM {}", "UPDATE {} SET rowid = rowid"])
def test_tables_only_grow(tmp_path, table, change):
    store = SqliteSessionStore(tmp_path / "dscqs.sqlite")
    store.add_test(TEST)
    store.add_session(SESSION)
    store.append("s1", [("joined", {})])
    store.close()
    change = change.replace("rowid", "at") if table == "event" else change
    db = sqlite3.connect(tmp_path / "dscqs.sqlite")
    with pytest.raises(sqlite3.IntegrityError, match="only grows"):
        db.execute(change.format(table))
    db.close()


def test_half_of_an_append_is_none_of_it(tmp_path):
    store = SqliteSessionStore(tmp_path / "dscqs.sqlite")
    store.add_test(TEST)
    store.add_session(SESSION)
    with pytest.raises(TypeError):
        store.append("s1", [("joined", {}), ("noted", {"detail": object()})])
    assert store.events("s1") == []
    store.close()


def test_a_file_of_the_future_is_left_alone(tmp_path):
    SqliteSessionStore(tmp_path / "dscqs.sqlite").close()
    with sqlite3.connect(tmp_path / "dscqs.sqlite") as db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(DscqsError, match="newer depthsr"):
        SqliteSessionStore(tmp_path / "dscqs.sqlite")


def test_a_disk_that_is_full_takes_no_vote_and_loses_none(tmp_path):
    store = SqliteSessionStore(tmp_path / "full.sqlite")
    store.add_test(TEST)
    store.add_session(SESSION)
    store.append("s1", [("joined", {})])
    pages = store._db.execute("PRAGMA page_count").fetchone()[0]
    store._db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(sqlite3.OperationalError, match="full"):
        store.append("s1", [("noted", {"detail": "x" * 100_000})])
    assert [event.name for event in store.events("s1")] == ["joined"]
    store._db.execute("PRAGMA max_page_count = 100000")
    store.append("s1", [("noted", {})])
    assert [event.name for event in store.events("s1")] == ["joined", "noted"]
    store.close()


def test_appends_of_many_at_once_are_all_there_and_a_bad_one_harms_no_other(tmp_path):
    store = SqliteSessionStore(tmp_path / "dscqs.sqlite")
    store.add_test(TEST)
    for number in range(8):
        one = dataclasses.replace(SESSION, id=f"s{number}", assessor=f"a{number}")
        store.add_session(one)
    refused = []

    def append(number: int) -> None:
        for at in range(20):
            store.append(f"s{number}", [("noted", {"at": at}), ("noted", {"at": at})])
            try:
                store.append("nobody", [("noted", {})])
            except sqlite3.IntegrityError:
                refused.append(number)

    threads = [threading.Thread(target=append, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert len(refused) == 8 * 20
    for number in range(8):
        events = store.events(f"s{number}")
        assert [event.sequence for event in events] == [*range(1, 41)]
        assert [event.data["at"] for event in events] == [at for at in range(20) for _ in "12"]
    store.close()
