"""What the RGB values of pictures stand for, in the code points of ITU-T H.273.

Nothing is converted by it: super-resolution takes the values as they are, and what is written says
of them what was said of what was read.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

PRIMARIES = {
    1: "bt709", 4: "bt470m", 5: "bt470bg", 6: "smpte170m", 7: "smpte240m", 8: "film",
    9: "bt2020", 10: "smpte428", 11: "smpte431", 12: "smpte432", 22: "ebu3213",
}  # fmt: skip
"""Names of the colour primaries (H.273, table 2), as FFmpeg spells them."""

TRANSFERS = {
    1: "bt709", 4: "gamma22", 5: "gamma28", 6: "smpte170m", 7: "smpte240m", 8: "linear",
    9: "log100", 10: "log316", 11: "iec61966-2-4", 12: "bt1361e", 13: "iec61966-2-1",
    14: "bt2020-10", 15: "bt2020-12", 16: "smpte2084", 17: "smpte428", 18: "arib-std-b67",
}  # fmt: skip
"""Names of the transfer characteristics (H.273, table 3), likewise."""

BT709, BT2020 = 1, 9
HDR = PQ, HLG = 16, 18
"""Transfers of high dynamic range (ITU-R BT.2100)."""

Chromaticity = tuple[Fraction, Fraction]
"""CIE 1931 (x, y)."""


@dataclass(frozen=True, kw_only=True)
class MasteringDisplay:
    """The display that pictures were graded on (SMPTE ST 2086)."""

    red: Chromaticity
    green: Chromaticity
    blue: Chromaticity
    white: Chromaticity
    darkest: Fraction
    """Luminance of black, cd/m²."""
    brightest: Fraction
    """Luminance of white, cd/m²."""


@dataclass(frozen=True, kw_only=True)
class LightLevel:
    """How bright the brightest pixel and the brightest frame are (CTA-861.3), cd/m²."""

    pixel: int
    frame: int


@dataclass(frozen=True, kw_only=True)
class Colorimetry:
    """What is said of RGB pictures; of what says nothing, BT.709."""

    primaries: int = BT709
    transfer: int = BT709
    mastering: MasteringDisplay | None = None
    light_level: LightLevel | None = None

    @classmethod
    def told(
        cls,
        primaries: int,
        transfer: int,
        mastering: MasteringDisplay | None = None,
        light_level: LightLevel | None = None,
    ) -> Colorimetry:
        """Return what a file says; code points that mean nothing are taken for BT.709.

        Examples
        --------
        >>> Colorimetry.told(9, 2).names
        ('bt2020', 'bt709')
        """
        return cls(
            primaries=primaries if primaries in PRIMARIES else BT709,
            transfer=transfer if transfer in TRANSFERS else BT709,
            mastering=mastering,
            light_level=light_level,
        )

    @property
    def names(self) -> tuple[str, str]:
        """Of the primaries and of the transfer."""
        return PRIMARIES[self.primaries], TRANSFERS[self.transfer]

    @property
    def is_usual(self) -> bool:
        """Whether it is what players assume where nothing is said."""
        return (self.primaries, self.transfer) == (BT709, BT709)

    @property
    def is_hdr(self) -> bool:
        """Whether the transfer is one of high dynamic range."""
        return self.transfer in HDR

    @property
    def says_light(self) -> bool:
        """Whether it says how bright pictures are, as HDR10 does."""
        return self.mastering is not None or self.light_level is not None
