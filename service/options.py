"""Command-line options made from the fields of the settings' dataclasses."""

from __future__ import annotations

import argparse
import dataclasses
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from pipeline.config import option_name
from pipeline.job import FrameRange

Container = argparse.ArgumentParser | argparse._ArgumentGroup

ALIASES: Mapping[str, tuple[str, ...]] = {"quality": ("--crf",)}
"""Further spellings of options, by field name."""

NOTHING: Mapping[str, tuple[str, ...]] = {}


METHOD_WORDS = (
    "LR: pictures as they were observed. HR: the finer grid. K: the magnification. PSF: point "
    "spread function, the blur of camera and lens. Grey level: 1/255 of the range from black to "
    "white."
)
"""What the options of the method take for granted; told above them."""


def add_options(
    parser: Container,
    kind: type,
    *,
    leave_out: Iterable[str] = (),
    without: Mapping[str, tuple[str, ...]] = NOTHING,
    aliases: Mapping[str, tuple[str, ...]] = ALIASES,
) -> None:
    """Add one option for every field of a dataclass; an option not given is not set.

    Parameters
    ----------
    parser : argument parser or group
        Where the options go.
    kind : type
        A dataclass whose fields were made by :func:`pipeline.config.setting`.
    leave_out : iterable of str
        Fields that get no option here.
    without : mapping
        Choices that are not offered here, by field name.
    aliases : mapping
        Further spellings by field name.
    """
    hints = typing.get_type_hints(kind)
    for item in dataclasses.fields(kind):
        if item.name in leave_out:
            continue
        names = (*aliases.get(item.name, ()), option_name(item.name))
        if hints[item.name] is bool:
            parser.add_argument(
                *names, dest=item.name, action="store_true", default=argparse.SUPPRESS,
                help=_help(item),
            )  # fmt: skip
            continue
        choices = [one for one in item.metadata["choices"] if one not in without.get(item.name, ())]
        parser.add_argument(
            *names,
            dest=item.name,
            default=argparse.SUPPRESS,
            type=_reader(hints[item.name]),
            choices=choices or None,
            metavar=None if choices else _metavar(item),
            help=_help(item),
        )


def collect(arguments: argparse.Namespace, kind: type) -> dict[str, Any]:
    """Return the options of a dataclass that were given."""
    names = [item.name for item in dataclasses.fields(kind)]
    return {name: getattr(arguments, name) for name in names if hasattr(arguments, name)}


def _reader(hint: Any) -> Callable[[str], Any]:
    """Return what makes a value of the annotated type out of the text of an option."""
    if isinstance(hint, types.UnionType):
        hint = next(part for part in typing.get_args(hint) if part is not type(None))
    if typing.get_origin(hint) is tuple:
        return _names
    if hint is FrameRange:
        return FrameRange.parse
    readers: dict[Any, Callable[[str], Any]] = {int: int, float: _number, str: str, Path: Path}
    return readers[hint]


def _number(text: str) -> float:
    value = float(text)
    if value != value or value in (float("inf"), float("-inf")):
        raise ValueError(text)
    return value


def _names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(","))


_number.__name__ = "number"  # argparse says "invalid number value"


def _metavar(item: dataclasses.Field) -> str:
    kinds = {
        "views": "ID,ID,...", "left": "ID", "right": "ID", "frames": "A:B", "output": "FILE",
        "report": "FILE", "frames_dir": "FOLDER", "debug_dir": "FOLDER", "codec": "NAME",
        "host": "ADDRESS", "data": "FOLDER", "roots": "FOLDER,...", "token_file": "FILE",
        "zenoh_listen": "ENDPOINT,...", "zenoh_connect": "ENDPOINT,...", "zenoh_ca": "FILE",
        "zenoh_certificate": "FILE", "zenoh_key": "FILE", "zenoh_users": "FILE",
        "zenoh_user": "NAME", "zenoh_password_file": "FILE", "zenoh_rights": "FILE",
        "cluster": "ADDRESS",
    }  # fmt: skip
    return kinds.get(item.name, "N")


def _help(item: dataclasses.Field) -> str:
    text = item.metadata["help"]
    unit = item.metadata["unit"]
    if unit:
        text += f" [{unit}]"
    unsaid = item.default is None or item.default is False or item.default == FrameRange()
    if not unsaid and "(default" not in text:
        shown = (
            ",".join(map(str, item.default)) if isinstance(item.default, tuple) else item.default
        )
        text += f" (default: {'none' if shown == '' else shown})"
    return text.replace("%", "%%")
