from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from pipeline import numba_cache
from pipeline.numba_cache import KEPT, edition, prepare_numba_cache
from tests.support.waiting import PATIENCE


def test_a_folder_that_is_set_stays(tmp_path):
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "mine"), "DEPTHSR_CACHE": str(tmp_path)}
    assert prepare_numba_cache(environment) == tmp_path / "mine"
    assert environment["NUMBA_CACHE_DIR"] == str(tmp_path / "mine")


@pytest.mark.parametrize(
    ("variable", "below"),
    [
        ("DEPTHSR_CACHE", "numba"),
        ("XDG_CACHE_HOME", "depthsr/numba"),
        ("HOME", ".cache/depthsr/numba"),
    ],
)
def test_folder_follows_the_environment(tmp_path, variable, below):
    environment = {variable: str(tmp_path)}
    folder = prepare_numba_cache(environment)
    assert folder == tmp_path / below / edition()
    assert environment["NUMBA_CACHE_DIR"] == str(folder)
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def test_where_nothing_can_be_written_a_temporary_folder_serves(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    folder = prepare_numba_cache({"HOME": str(tmp_path / "file")})
    assert folder.parent.parent == tmp_path / "tmp"
    assert not folder.parent.stat().st_mode & 0o077


def test_a_temporary_folder_of_somebody_else_is_not_trusted(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    open_to_all = tmp_path / f"depthsr-numba-{os.getuid()}"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    assert prepare_numba_cache({"HOME": str(tmp_path / "file")}).parent != open_to_all


def test_what_a_read_only_installation_holds_is_taken_along(tmp_path, monkeypatch):
    built_ahead = tmp_path / "installed" / "numba" / edition() / "pipeline_1"
    built_ahead.mkdir(parents=True)
    (built_ahead / "kernel.nbi").write_bytes(b"index")
    (built_ahead / "kernel.1.nbc").write_bytes(b"code")
    can_write = numba_cache._can_write
    monkeypatch.setattr(
        numba_cache,
        "_can_write",
        lambda folder: "installed" not in str(folder) and can_write(folder),
    )
    environment = {"DEPTHSR_CACHE": str(tmp_path / "installed"), "HOME": str(tmp_path)}
    folder = prepare_numba_cache(environment)
    assert folder == tmp_path / ".cache/depthsr/numba" / edition()
    assert (folder / "pipeline_1/kernel.1.nbc").read_bytes() == b"code"


def test_kernels_of_other_sources_are_not_taken_for_these(tmp_path):
    """The kernel's file is as it was; a constant that is compiled into it from another is not."""
    package = tmp_path / "pipeline"
    package.mkdir()
    shutil.copy(numba_cache.__file__, package)
    (package / "__init__.py").touch()
    (package / "inner.py").write_text(
        "import numba\nfrom pipeline.amount import MORE\n\n"
        "@numba.njit\ndef part(x):\n    return x + MORE\n"
    )
    (package / "outer.py").write_text(
        "import numba\nfrom pipeline.inner import part\n\n"
        "@numba.njit(cache=True)\ndef whole(x):\n    return part(x)\n"
    )
    program = (
        "from pipeline.numba_cache import prepare_numba_cache\n"
        "prepare_numba_cache()\nfrom pipeline.outer import whole\nprint(whole(2))\n"
    )
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA")}
    environment |= {"DEPTHSR_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    said = []
    for more in (1, 5, 1):
        (package / "amount.py").write_text(f"MORE = {more}\n")
        done = subprocess.run(
            [sys.executable, "-B", "-c", program], env=environment, cwd=tmp_path, check=True,
            capture_output=True, text=True, timeout=PATIENCE,
        )  # fmt: skip
        said.append(int(done.stdout))
    assert said == [3, 7, 3]


def test_what_has_not_been_used_for_long_is_removed(tmp_path):
    environment = {"DEPTHSR_CACHE": str(tmp_path)}
    for name, age in (("used", 0.9 * KEPT), ("unused", 1.1 * KEPT)):
        (tmp_path / "numba" / name / "pipeline_1").mkdir(parents=True)
        os.utime(tmp_path / "numba" / name, (time.time() - age,) * 2)
    folder = prepare_numba_cache(environment)
    assert {path.name for path in (tmp_path / "numba").iterdir()} == {"used", folder.name}


def test_numba_writes_where_it_was_told_to(tmp_path):
    """In a process of its own: a compiled function ends up in the folder."""
    (tmp_path / "kernel.py").write_text(
        "import numba\n@numba.njit(cache=True)\ndef twice(x):\n    return x + x\n"
    )
    program = (
        "from pipeline.numba_cache import prepare_numba_cache\n"
        "prepare_numba_cache()\nimport kernel\nassert kernel.twice(2) == 4\n"
    )
    root = Path(__file__).parents[2]
    environment = {
        key: value for key, value in os.environ.items() if not key.startswith(("NUMBA", "DEPTHSR"))
    }
    environment |= {
        "DEPTHSR_CACHE": str(tmp_path / "cache"),
        "PYTHONPATH": f"{root}{os.pathsep}{tmp_path}",
    }
    subprocess.run([sys.executable, "-c", program], env=environment, check=True, timeout=PATIENCE)
    assert list((tmp_path / "cache" / "numba").rglob("kernel.twice*.nbi"))
