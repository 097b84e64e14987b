from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.media.live_frames import decode_color
from service.bus.bus import RAW
from service.streams.messages import (
    InputHeader,
    MessageError,
    OutputHeader,
    read_input_header,
    read_picture,
    write_input_header,
)
from service.streams.receiver import read_output_header

PAGE = Path(__file__).parents[3] / "docs" / "zenoh.md"
NUMBERS = st.integers(0, (1 << 63) - 1)


@given(
    header=st.builds(
        InputHeader,
        frame_index=NUMBERS, capture_time_ns=NUMBERS, width=NUMBERS, height=NUMBERS,
        pixel_format=st.text(max_size=32),
    )
)  # fmt: skip
def test_a_header_is_read_as_it_was_written(header):
    assert read_input_header(write_input_header(header)) == header


@given(attachment=st.binary(max_size=200))
def test_anything_else_is_refused_in_one_line(attachment):
    with pytest.raises(MessageError) as caught:
        read_input_header(attachment)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        (b"", "missing"), (b"[1]", "object"), (b"{}", "frame_index"),
        (b'{"frame_index": 1}', "capture_time_ns"),
        (b'{"frame_index": -1, "capture_time_ns": 1}', "frame_index"),
        (b'{"frame_index": true, "capture_time_ns": 1}', "frame_index"),
        (b'{"frame_index": 1.0, "capture_time_ns": 1}', "frame_index"),
        (b'{"frame_index": 9223372036854775808, "capture_time_ns": 1}', "frame_index"),
        (b'{"frame_index": 1, "capture_time_ns": 1, "pixel_format": 7}', "pixel_format"),
        (b'{"a": ' * 3000, "longer"), (b"[" * 4000, "JSON"), (b"1" * 4096, "JSON"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(said, wrong):
    with pytest.raises(MessageError, match=wrong):
        read_input_header(said)


def test_what_the_page_shows_byte_for_byte_is_read():
    block = next(
        text for text in re.findall(r"```text\n(.*?)```", PAGE.read_text(), re.S) if "7b 22" in text
    )
    attachment = bytes.fromhex(" ".join(re.findall(r"(?:\b[0-9a-f]{2} ?){16,}|\b22 7d", block)))
    payload = bytes.fromhex(re.search(r"payload +([0-9a-f ]+)", block)[1])
    header = read_input_header(attachment)
    assert header.frame_index == 7
    assert json.loads(attachment) == json.loads(re.search(r"\{.*\}", block)[0])
    picture = decode_color(read_picture(RAW, payload, header), max_pixels=100)
    assert picture.luma.shape == (2, 4)
    assert picture.luma[1].tolist() == [0x80, 0xA0, 0xC0, 0xE0]


def test_every_key_of_what_a_stream_sends_is_on_the_page():
    text = PAGE.read_text()
    rows = set(re.findall(r"`(\w+)`", text))
    assert set(OutputHeader.__dataclass_fields__) <= rows
    assert set(InputHeader.__dataclass_fields__) <= rows
    header = OutputHeader(
        sequence=1, run=1, frame_index=2, position=2, capture_time_ns=3, published_time_ns=4,
        fps="15/1", width=8, height=4, layout="sbs",
    )  # fmt: skip
    assert read_output_header(header.encoded())["sequence"] == 1
    assert read_output_header(b"{}") is None
