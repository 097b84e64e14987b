"""The displays that a test can run on: profiles as data, those that ship and those calibrated."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dscqs.errors import DisplayError, NotFound

MODES = (
    "mono-left", "mono-right", "sbs-full", "sbs-half", "tab-full", "tab-half", "rows", "columns",
    "checkerboard", "anaglyph", "dual", "frame-sequential", "webxr",
)  # fmt: skip
"""How a display takes two eyes; ``dscqs/page/layout.js`` says where each pixel goes."""

GLASSES = ("none", "polarising", "shutter", "red-cyan")
EYE_CODES = ("none", "blue-line")
"""How frame-sequential glasses learn whose frame it is."""

NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")


@dataclass(frozen=True, kw_only=True)
class DisplayProfile:
    """One display.

    Parameters
    ----------
    title : str
        What it is, for people.
    mode : str
        One of ``MODES``.
    width_px, height_px : int
        The whole signal: both projectors of ``dual``, both eyes of the full layouts.
    pixel_pitch_mm : float or None
        Distance from pixel to pixel on the screen [mm]; None until it was measured.
    distance_heights : float
        Viewing distance in heights of the screen.
    swap : bool
        Left and right are exchanged.
    phase : int
        0 or 1: the eye of the first row, column or square (0: left).
    crosstalk : float or None
        Part of one eye's light that the other sees, 0…1, as it was matched; None: not measured.
    calibrated : str or None
        When, and by whom: free text.
    """

    title: str
    mode: str
    width_px: int
    height_px: int
    distance_heights: float
    glasses: str = "none"
    pixel_pitch_mm: float | None = None
    eye_code: str = "none"
    swap: bool = False
    phase: int = 0
    crosstalk: float | None = None
    calibrated: str | None = None

    def __post_init__(self) -> None:
        for name, most in (("title", 200), ("calibrated", 200)):
            value = getattr(self, name)
            if not (isinstance(value, str) and 0 < len(value) <= most) and (
                value is not None or name == "title"
            ):
                raise DisplayError(f"{name}: must be a text of 1 to {most} characters")
        for name, known in (("mode", MODES), ("glasses", GLASSES), ("eye_code", EYE_CODES)):
            if getattr(self, name) not in known:
                raise DisplayError(f"{name}: {getattr(self, name)!r} is none of {', '.join(known)}")
        for name, most in (("width_px", 16384), ("height_px", 16384)):
            if type(getattr(self, name)) is not int or not 16 <= getattr(self, name) <= most:
                raise DisplayError(f"{name}: must be a whole number from 16 to {most}")
        _check_number("distance_heights", self.distance_heights, 0.3, 20)
        if self.pixel_pitch_mm is not None:
            _check_number("pixel_pitch_mm", self.pixel_pitch_mm, 0.005, 20)
        if self.crosstalk is not None:
            _check_number("crosstalk", self.crosstalk, 0, 1)
        if type(self.phase) is not int or self.phase not in (0, 1):
            raise DisplayError("phase: must be 0 or 1")
        if not isinstance(self.swap, bool):
            raise DisplayError("swap: must be true or false")
        across, down = _halves(self.mode)
        if self.width_px % across or self.height_px % down:
            raise DisplayError(f"mode {self.mode}: width_px and height_px must be two equal halves")

    @property
    def eye_px(self) -> tuple[int, int]:
        """Width and height of what one eye gets [pixel of the stimulus]."""
        across, down = (1, 1) if self.mode.endswith("-half") else _halves(self.mode)
        return self.width_px // across, self.height_px // down

    def as_dict(self) -> dict[str, object]:
        """Return the fields, as JSON holds them."""
        return dataclasses.asdict(self)


def profile_from_dict(data: object) -> DisplayProfile:
    """Return the profile that JSON says, or raise a :class:`DisplayError` that names the field."""
    if not isinstance(data, Mapping):
        raise DisplayError("the profile must be an object")
    fields = {item.name: item for item in dataclasses.fields(DisplayProfile)}
    for name in data:
        if name not in fields:
            raise DisplayError(f"{name}: no such field (known: {', '.join(fields)})")
    for name, item in fields.items():
        if name not in data and item.default is dataclasses.MISSING:
            raise DisplayError(f"{name}: is missing")
    return DisplayProfile(**data)


@cache
def shipped_profiles() -> Mapping[str, DisplayProfile]:
    """Return the profiles that ship, by name."""
    text = Path(__file__).with_name("displays.json").read_text(encoding="utf-8")
    return {name: profile_from_dict(data) for name, data in json.loads(text).items()}


class DisplayShelf:
    """The profiles of one laboratory: a JSON file for each one calibrated, over those that ship."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def all(self) -> dict[str, DisplayProfile]:
        """Return every profile by its name."""
        found = dict(shipped_profiles())
        for path in sorted(self._folder.glob("*.json")):
            found[path.stem] = profile_from_dict(json.loads(path.read_text(encoding="utf-8")))
        return found

    def get(self, name: str) -> DisplayProfile:
        """Return one profile, or raise :class:`NotFound`."""
        profiles = self.all()
        if name not in profiles:
            raise NotFound(f"display: {name!r} is none of {', '.join(profiles)}")
        return profiles[name]

    def put(self, name: str, profile: DisplayProfile) -> None:
        """Keep a profile; it is on disk, whole, when this returns."""
        if not NAME.fullmatch(name):
            raise DisplayError(f"name: {name!r} must be 1 to 64 of a-z, 0-9 and '-'")
        self._folder.mkdir(parents=True, exist_ok=True)
        unfinished = self._folder / f".{name}.{os.getpid()}.tmp"
        with unfinished.open("w", encoding="utf-8") as file:
            json.dump(profile.as_dict(), file, ensure_ascii=False, indent=2)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(self._folder / f"{name}.json")
        folder = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _halves(mode: str) -> tuple[int, int]:
    """Return into how many parts a mode divides the signal, across and down."""
    return {
        "sbs-full": (2, 1), "sbs-half": (2, 1), "dual": (2, 1),
        "tab-full": (1, 2), "tab-half": (1, 2),
    }.get(mode, (1, 1))  # fmt: skip


def _check_number(name: str, value: object, least: float, most: float) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise DisplayError(f"{name}: {value!r} is not a number")
    if not least <= value <= most:
        raise DisplayError(f"{name}: {value} is not from {least} to {most}")
