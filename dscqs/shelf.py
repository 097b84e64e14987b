"""The shelf: where the files of tests lie, padded, each under the hash of its bytes.

A file is copied when a test is made, and never changed afterwards; its hash is checked whenever
it is shown. The files of one content have the same length.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dscqs.errors import StimulusError, StimulusLost
from dscqs.plan import Plan
from dscqs.stimulus import (
    MEDIA_TYPES,
    RANDOM_BYTES,
    Padded,
    digest,
    freshen,
    inspect,
    pad,
    padded_length,
)


class Shelf:
    """The files of all tests in one folder.

    Parameters
    ----------
    folder : Path
        Made when the first test is.
    noise : callable
        Returns so many random bytes.
    """

    def __init__(self, folder: Path, *, noise: Callable[[int], bytes] = os.urandom) -> None:
        self._folder = folder
        self._noise = noise

    def take_in(self, plan: Plan, source: Path) -> dict[str, dict[str, Any]]:
        """Copy the stimuli of a plan; return what was stored, by ``content/condition``.

        Raises
        ------
        StimulusError
            If a file is missing, outside the folder ``source``, damaged, of the wrong kind,
            not the one whose hash the plan names, or unlike the others of its content.
        """
        found = {key: _read(source, plan.stimuli[key], key) for key in plan.used}
        infos = {key: inspect(data, f"{key}: {plan.stimuli[key]}") for key, data in found.items()}
        _check_alike(plan, infos)
        stored: dict[str, dict[str, Any]] = {}
        self._folder.mkdir(parents=True, exist_ok=True)
        for key, data in found.items():
            original = digest(data)
            if plan.hashes.get(key, original) != original:
                raise StimulusError(f"{key}: {plan.stimuli[key]} is not the file that was planned")
            content = key.split("/")[0]
            length = padded_length(
                [len(other) for name, other in found.items() if name.split("/")[0] == content]
            )
            padded = pad(data, length)
            name = digest(padded.data)
            self._write(name, padded.data)
            stored[key] = {
                "stored": name, "sha256": original, "length": length,
                "media_type": infos[key].media_type, "codec": infos[key].codec,
                "width": infos[key].width, "height": infos[key].height,
                "random_at": padded.random_at, "checksum": padded.checksum,
                "pixels": plan.pixels.get(key),
            }  # fmt: skip
        _sync(self._folder)
        return stored

    def serving(self, file: Mapping[str, Any]) -> bytes:
        """Return bytes for one showing, never the same twice; check the hash.

        Raises
        ------
        StimulusLost
            If the file is missing or was changed.
        """
        try:
            data = (self._folder / file["stored"]).read_bytes()
        except OSError as error:
            raise StimulusLost(f"a stored stimulus cannot be read: {error.strerror}") from error
        if digest(data) != file["stored"]:
            raise StimulusLost("a stored stimulus was changed; make the test anew")
        padded = Padded(data=data, random_at=file["random_at"], checksum=file["checksum"])
        return freshen(padded, self._noise(RANDOM_BYTES))

    def _write(self, name: str, data: bytes) -> None:
        if (self._folder / name).exists():
            return
        number, temporary = tempfile.mkstemp(dir=self._folder, suffix=".tmp")
        try:
            with os.fdopen(number, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, self._folder / name)
        except BaseException:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(temporary)
            raise


def _read(source: Path, name: str, key: str) -> bytes:
    path = (source / name).resolve()
    if not path.is_relative_to(source.resolve()):
        raise StimulusError(f"{key}: {name} lies outside the folder of the plan")
    try:
        return path.read_bytes()
    except OSError as error:
        raise StimulusError(f"{key}: {name} cannot be read: {error.strerror}") from error


def _check_alike(plan: Plan, infos: Mapping[str, Any]) -> None:
    wanted = MEDIA_TYPES[plan.kind]
    first: dict[str, tuple[str, Any]] = {}
    for key, info in infos.items():
        if info.media_type != wanted:
            raise StimulusError(
                f"{key}: is {info.media_type}, but a plan of {plan.kind}s: {wanted}"
            )
        if plan.layout == "sbs" and info.width % 2:
            raise StimulusError(f"{key}: {info.width} pixels wide, which two eyes cannot share")
        other, alike = first.setdefault(key.split("/")[0], (key, info))
        if info != alike:
            raise StimulusError(
                f"{key}: {info.width}×{info.height} {info.codec}, but {other} is "
                f"{alike.width}×{alike.height} {alike.codec}; an assessor could tell them apart"
            )


def _sync(folder: Path) -> None:
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
