from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from service.bus.keys import Output
from service.streams.sequences import Sequences, last_run

OUTPUTS = list(Output)


@given(taken=st.lists(st.lists(st.sampled_from(OUTPUTS), max_size=20), max_size=5))
def test_numbers_go_on_with_the_next_worker_however_the_last_one_ended(tmp_path_factory, taken):
    path = tmp_path_factory.mktemp("numbers") / "s.sequences"
    assert last_run(path) == 0
    given = {which: [] for which in OUTPUTS}
    for run, outputs in enumerate(taken, start=1):
        sequences = Sequences(path, run=run)  # the one before was never closed
        assert last_run(path) == run
        for which in outputs:
            given[which].append(sequences.take(which))
            assert sequences.last(which) == given[which][-1]
    assert all(numbers == list(range(len(numbers))) for numbers in given.values())


def test_a_stream_works_without_the_file(tmp_path, caplog):
    path = tmp_path / "gone" / "s.sequences"
    sequences = Sequences(path, run=3)
    assert [sequences.take(Output.SBS) for _ in range(2)] == [0, 1]
    assert "cannot be kept" in caplog.text
    assert last_run(path) == 0


def test_a_torn_file_is_made_whole(tmp_path):
    path = tmp_path / "s.sequences"
    path.write_bytes(b"\1")
    assert last_run(path) == 0
    assert Sequences(path).take(Output.LEFT) == 0
    assert last_run(path) == 1
