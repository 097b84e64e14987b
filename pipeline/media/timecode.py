"""Time codes (SMPTE ST 12-1): what editors find frames by. Arithmetic alone."""

from __future__ import annotations

import re
from fractions import Fraction

COUNTED_RATES = (24, 25, 30, 48, 50, 60, 100, 120)
"""Frames a second, rounded, whose time codes can be written."""

_FORM = re.compile(r"(\d\d):([0-5]\d):([0-5]\d)([:;.])(\d\d)")


def later(timecode: str, frames: int, fps: Fraction) -> str | None:
    """Return the time code so many frames later; None where it is none of that rate.

    With a semicolon before the frames two (of 60 a second four) numbers are left out in each
    minute but every tenth, so that 30000/1001 frames a second keep up with the clock.

    Examples
    --------
    >>> later("01:00:59;28", 2, Fraction(30000, 1001)), later("23:59:59:24", 1, Fraction(25))
    ('01:01:00;02', '00:00:00:00')
    >>> later("01:00:00:00", 0, Fraction(15)) is None
    True
    """
    found, rate = _FORM.fullmatch(timecode), round(fps)
    if found is None or rate not in COUNTED_RATES:
        return None
    hours, minutes, seconds, frame = (int(found[place]) for place in (1, 2, 3, 5))
    is_dropped = found[4] != ":"
    if frame >= rate or (is_dropped and rate % 30):
        return None
    minute, dropped = 60 * hours + minutes, rate // 15 if is_dropped else 0
    number = (60 * minute + seconds) * rate + frame - dropped * (minute - minute // 10)
    whole_minute, ten_minutes = 60 * rate, 600 * rate - 9 * dropped
    tens, rest = divmod((number + frames) % (144 * ten_minutes), ten_minutes)
    if rest >= whole_minute:
        rest += dropped * (1 + (rest - whole_minute) // (whole_minute - dropped))
    seconds, frame = divmod(600 * rate * tens + rest, rate)
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours:02}:{minutes:02}:{seconds:02}{';' if is_dropped else ':'}{frame:02}"
