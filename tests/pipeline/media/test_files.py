from __future__ import annotations

import errno
import os
import resource
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.errors import OutputError
from pipeline.media.files import (
    atomic_path,
    check_folder_writable,
    check_writable,
    remove_leftovers,
    write_atomic,
)
from tests.support import needed
from tests.support.waiting import PATIENCE


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own with 64 KiB, where one may be mounted."""
    folder = tmp_path / "disk"
    with needed.small_disk(folder, "64k"):
        yield folder


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_file_appears_under_its_name_only_at_the_end(tmp_path):
    final = tmp_path / "out.bin"

    with atomic_path(final) as temporary:
        temporary.write_bytes(b"half")
        assert not final.exists()
        assert temporary.parent == tmp_path

    assert final.read_bytes() == b"half"
    assert names(tmp_path) == ["out.bin"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, FileNotFoundError])
def test_after_an_error_the_old_file_stays_and_nothing_else(tmp_path, error):
    final = tmp_path / "out.bin"
    final.write_bytes(b"old")

    def write() -> None:
        with atomic_path(final) as temporary:
            temporary.write_bytes(b"new")
            raise error

    with pytest.raises(error):
        write()

    assert final.read_bytes() == b"old"
    assert names(tmp_path) == ["out.bin"]


def test_a_new_file_has_the_permissions_the_user_gives_to_new_files(tmp_path):
    (tmp_path / "plain").write_bytes(b"")

    write_atomic(tmp_path / "atomic", b"")

    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "atomic")]
    assert modes[0] == modes[1]


def test_a_link_is_followed_and_stays_a_link(tmp_path):
    target, link = tmp_path / "real.bin", tmp_path / "link.bin"
    target.write_bytes(b"old")
    link.symlink_to(target)

    write_atomic(link, b"new")

    assert link.is_symlink()
    assert target.read_bytes() == b"new"


def test_a_very_long_name_can_still_be_written(tmp_path):
    final = tmp_path / ("n" * 250 + ".mkv")

    write_atomic(final, b"x")

    assert final.read_bytes() == b"x"


def test_a_killed_writer_leaves_nothing_under_the_final_name(tmp_path):
    final = tmp_path / "out.bin"
    program = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from pipeline.media.files import atomic_path\n"
        "with atomic_path(Path(sys.argv[1])) as temporary:\n"
        "    temporary.write_bytes(b'x' * 100000)\n"
        "    print('written', flush=True)\n"
        "    time.sleep(600)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(final)], stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout.readline() == "written\n"
        writer.send_signal(signal.SIGKILL)
        writer.wait(PATIENCE)

    assert not final.exists()
    assert len(names(tmp_path)) == 1
    assert remove_leftovers(final) == 1
    assert names(tmp_path) == []


def test_leftovers_of_other_files_are_left_alone(tmp_path):
    for name in (".a.mkv.0123.tmp", ".b.mkv.0123.tmp", "a.mkv.tmp", "a.mkv"):
        (tmp_path / name).write_bytes(b"")

    assert remove_leftovers(tmp_path / "a.mkv") == 1
    assert names(tmp_path) == [".b.mkv.0123.tmp", "a.mkv", "a.mkv.tmp"]
    assert remove_leftovers(tmp_path / "nowhere" / "a.mkv") == 0


def test_a_writable_path_is_accepted_and_untouched(tmp_path):
    existing = tmp_path / "out.mkv"
    existing.write_bytes(b"old")

    check_writable(existing)
    check_writable(tmp_path / "new.mkv")

    assert existing.read_bytes() == b"old"
    assert names(tmp_path) == ["out.mkv"]


def test_a_missing_folder_is_named_with_what_to_do(tmp_path):
    with pytest.raises(OutputError, match=r"no folder .*missing; create it first"):
        check_writable(tmp_path / "missing" / "out.mkv")


def test_a_folder_or_a_device_is_no_output_file(tmp_path):
    with pytest.raises(OutputError, match="it is a folder"):
        check_writable(tmp_path)
    with pytest.raises(OutputError, match="not an ordinary file"):
        check_writable(Path("/dev/null"))
    with pytest.raises(OutputError, match="it is a folder"):
        write_atomic(tmp_path, b"x")
    assert Path("/dev/null").is_char_device()


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"")

    with pytest.raises(OutputError, match="parent is a file"):
        check_writable(tmp_path / "file" / "out.mkv")
    with pytest.raises(OutputError, match="it is a file, not a folder"):
        check_folder_writable(tmp_path / "file")


def test_a_folder_for_pictures_is_made(tmp_path):
    check_folder_writable(tmp_path / "a" / "b")

    assert names(tmp_path / "a" / "b") == []


def test_a_read_only_disk_is_found_before_the_work(small_disk):
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)

    with pytest.raises(OutputError, match="read-only"):
        check_writable(small_disk / "out.mkv")
    with pytest.raises(OutputError, match="read-only"):
        check_folder_writable(small_disk)


def test_a_full_disk_is_an_error_that_says_so(small_disk):
    with pytest.raises(OutputError, match=r"out\.bin: cannot be written: the disk is full"):
        write_atomic(small_disk / "out.bin", bytes(200_000))

    assert names(small_disk) == []


def test_a_full_disk_met_by_the_body_is_an_output_error(tmp_path):
    with (
        pytest.raises(OutputError, match="the disk is full"),
        atomic_path(tmp_path / "out.bin"),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    assert names(tmp_path) == []


def test_a_limit_on_the_size_of_files_is_an_error_that_says_so(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(OutputError, match="grew beyond the allowed size"):
            write_atomic(tmp_path / "out.bin", bytes(20_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    assert names(tmp_path) == []
