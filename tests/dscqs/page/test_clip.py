"""Lossless video is the same pixels in the browser as before it was coded."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dscqs.pixel_hash import hash_frames
from tests.support.waiting import PATIENCE

WIDTH, HEIGHT, COUNT = 74, 22, 30
"""Both eyes of 37 × 22; more frames than are decoded ahead."""

LOSSLESS = {
    "vp9": ["-c:v", "libvpx-vp9", "-lossless", "1"],
    "av1": ["-c:v", "libaom-av1", "-crf", "0", "-cpu-used", "8", "-aom-params", "lossless=1"],
}
VERIFY = """async ({url, memory}) => {
  const {Clip} = await import("/clip.js");
  const bytes = new Uint8Array(await (await fetch(url)).arrayBuffer());
  const clip = new Clip(bytes, {memory});
  return {hash: await clip.verify(), count: clip.count, ms: clip.frameMs, whole: clip.isWhole};
}"""


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    """(30, 22, 74, 3): noise that moves, and every code in each colour."""
    generator = np.random.default_rng(8)
    noise = generator.integers(0, 256, (COUNT, HEIGHT, WIDTH, 3), np.uint8)
    noise[:, :11] = noise[0, :11]
    return noise


def encode(path: Path, frames: np.ndarray, options: list[str], pixels: str = "gbrp") -> None:
    subprocess.run(
        [
            "ffmpeg", "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
            "-s", f"{WIDTH}x{HEIGHT}", "-r", "25", "-i", "-", *options, "-pix_fmt", pixels,
            str(path),
        ],
        input=frames.tobytes(), check=True, timeout=PATIENCE,
    )  # fmt: skip


@pytest.mark.parametrize("codec", list(LOSSLESS))
def test_every_pixel_of_every_frame_comes_through(tab: Any, made: Path, frames, codec):
    encode(made / f"{codec}.webm", frames, LOSSLESS[codec])
    found = tab.evaluate(VERIFY, {"url": f"/made/{codec}.webm", "memory": 2**24})
    assert found == {"hash": hash_frames(frames), "count": COUNT, "ms": 40, "whole": True}


def test_one_wrong_pixel_changes_the_hash(frames):
    wrong = frames.copy()
    wrong[17, 3, 5, 2] ^= 1
    assert hash_frames(wrong) != hash_frames(frames)


@pytest.mark.parametrize("codec", list(LOSSLESS))
def test_converted_colours_are_refused(tab: Any, made: Path, frames, codec):
    encode(made / "yuv.webm", frames, LOSSLESS[codec], "yuv444p")
    with pytest.raises(Exception, match="not coded as RGB"):
        tab.evaluate(VERIFY, {"url": "/made/yuv.webm", "memory": 2**24})


def test_a_file_cut_short_is_refused(tab: Any, made: Path, frames):
    encode(made / "whole.webm", frames, LOSSLESS["vp9"])
    whole = (made / "whole.webm").read_bytes()
    (made / "cut.webm").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(Exception, match="cut short"):
        tab.evaluate(VERIFY, {"url": "/made/cut.webm", "memory": 2**24})


def test_a_clip_too_long_for_the_memory_is_decoded_as_it_plays_twice(tab: Any, made: Path, frames):
    encode(made / "long.webm", frames, LOSSLESS["vp9"])
    found = tab.evaluate(
        """async (url) => {
          const {Clip} = await import("/clip.js");
          const {hex, sha256} = await import("/sha256.js");
          const bytes = new Uint8Array(await (await fetch(url)).arrayBuffer());
          const clip = new Clip(bytes, {memory: 2 ** 16});
          await clip.verify();
          const shown = [];
          for (let showing = 0; showing < 2; showing++) {
            await clip.begin();
            for (let index = 0; index < clip.count; index++) {
              let planes = null;
              while ((planes = clip.at(index)) === null)
                await new Promise((resolve) => setTimeout(resolve, 1));
              shown.push(hex(await sha256(planes)));
            }
          }
          clip.stop();
          return {whole: clip.isWhole, shown};
        }""",
        "/made/long.webm",
    )
    planes = frames[..., [1, 2, 0]].transpose(0, 3, 1, 2)  # G, B, R
    expected = [hashlib.sha256(np.ascontiguousarray(p).tobytes()).hexdigest() for p in planes]
    assert found == {"whole": False, "shown": 2 * expected}


@pytest.mark.parametrize("length", [0, 1, 55, 56, 63, 64, 65, 119, 120, 1000])
def test_sha_256_without_the_browsers_help(tab: Any, length):
    found = tab.evaluate(
        """async (length) => {
          const {hex, plainSha256, sha256} = await import("/sha256.js");
          const bytes = Uint8Array.from({length}, (_, i) => (7 * i) & 255);
          return [hex(plainSha256(bytes)), hex(await sha256(bytes))];
        }""",
        length,
    )
    data = bytes((7 * i) & 255 for i in range(length))
    assert found == 2 * [hashlib.sha256(data).hexdigest()]
