"""What a stream can be told: how it is assembled, computed and published."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from pipeline.config import option_name, setting
from pipeline.errors import ConfigurationError


class Rule(StrEnum):
    """What to do with a frame that is not as it should be."""

    USE = "use"
    DROP = "drop"


RULES = tuple(Rule)


@dataclass(frozen=True, kw_only=True)
class StreamOptions:
    """How frames are put together and sent out."""

    wait: float = setting(0.2, "time a frame may lack a part", unit="seconds")
    window: int = setting(8, "frames that may lack parts at the same time", unit="frames")
    missing_view: str = setting(
        "drop", "a frame without a view that is not of the stereo pair", choices=RULES
    )
    missing_depth: str = setting("use", "a frame without a depth map", choices=RULES)
    max_skew: float = setting(
        0.0, "most that capture times of a frame may differ (0: half a frame)", unit="seconds"
    )
    skewed: str = setting("use", "a frame whose capture times differ by more", choices=RULES)
    quality: int = setting(20, "CRF of the H.264 video, 0 (lossless) to 51")
    jpeg_quality: int = setting(90, "quality of JPEG pictures, 1 to 100")
    real_time: bool = setting(True, "leave work out of frames where the rate asks for it")
    before: bool = setting(True, "show the observed views beside the result in browsers")
    idle: float = setting(60.0, "silence after which the worker is ended", unit="seconds")

    def __post_init__(self) -> None:
        limits = {
            "wait": (0.0, 10.0), "window": (1, 64), "max_skew": (0.0, 10.0),
            "quality": (0, 51), "jpeg_quality": (1, 100), "idle": (1.0, 86400.0),
        }  # fmt: skip
        for name, (least, most) in limits.items():
            if not least <= getattr(self, name) <= most:
                raise ConfigurationError(
                    f"{option_name(name)}: must be {least} to {most}, not {getattr(self, name)}"
                )
        for name in ("missing_view", "missing_depth", "skewed"):
            if getattr(self, name) not in RULES:
                raise ConfigurationError(f"{option_name(name)}: must be use or drop")
