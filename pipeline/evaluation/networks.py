"""The only door to ncnn: networks of other projects, run on the processor.

Neither ncnn nor the packages that carry the weights are dependencies. They are looked for in
the folder that ``DEPTHSR_PEERS`` names (``make peers`` fills ``.peers``), then among the
installed packages; of the latter only the model files are read, no line of theirs is run.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.errors import ConfigurationError

DEFAULT_FOLDER = ".peers"
"""Where ``make peers`` puts the packages, from the working folder."""


@dataclass(frozen=True, kw_only=True)
class Network:
    """A network inside a package: where it is, and what its ends are called."""

    package: str
    """Import name of the package that carries it."""
    path: str
    """Of the two model files inside the package, without .param and .bin."""
    input: str
    output: str


def packages_folder() -> Path:
    """Return the folder of the peers' packages, whether it is there or not.

    Raises
    ------
    ConfigurationError
        If ``DEPTHSR_PEERS`` is set and names no folder.
    """
    named = os.environ.get("DEPTHSR_PEERS", "")
    if named and not Path(named).is_dir():
        raise ConfigurationError(f"DEPTHSR_PEERS: {named} is no folder; `make peers` makes one")
    return Path(named or DEFAULT_FOLDER)


def package_path(package: str) -> Path | None:
    """Return the folder of a package or the file of a module, without importing it."""
    folder = packages_folder()
    for path in (folder / package, folder / f"{package}.py"):
        if path.exists():
            return path.resolve()
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        return None
    return Path(found.origin).parent if found.submodule_search_locations else Path(found.origin)


def is_installed(network: Network) -> bool:
    """Return whether ncnn and the network's files are there."""
    return (
        package_path("ncnn") is not None
        and package_path(network.package) is not None
        and all(file.is_file() for file in model_files(network))
    )


def model_files(network: Network) -> tuple[Path, Path]:
    """Return the files of the network's layers and of its weights.

    Raises
    ------
    ConfigurationError
        If its package is not there.
    """
    home = package_path(network.package)
    if home is None:
        raise ConfigurationError(f"{network.package} is not installed; see `make peers`")
    return home / f"{network.path}.param", home / f"{network.path}.bin"


def run(
    network: Network, channels: npt.NDArray[np.float32], threads: int
) -> npt.NDArray[np.float32]:
    """Return what the network makes of its input, both (channels, H, W) float32.

    Parameters
    ----------
    threads : int
        Threads that share the work.

    Raises
    ------
    ConfigurationError
        If the network cannot be loaded or does not run.
    """
    ncnn = _ncnn()
    net = _loaded(network, threads)
    held = np.ascontiguousarray(channels, dtype=np.float32)  # ncnn.Mat does not own its numbers
    with net.create_extractor() as extractor:
        extractor.input(network.input, ncnn.Mat(held).clone())
        status, result = extractor.extract(network.output)
    if status != 0:
        raise ConfigurationError(f"{network.package}: {network.path} does not run ({status})")
    return np.array(result, dtype=np.float32)


def padded(channels: npt.NDArray[np.float32], border: int) -> npt.NDArray[np.float32]:
    """Return the channels with their edges repeated outwards."""
    return np.pad(channels, ((0, 0), (border, border), (border, border)), mode="edge")


def planes(values: Sequence[float], shape: tuple[int, int]) -> npt.NDArray[np.float32]:
    """Return constant channels, (N, H, W)."""
    return np.broadcast_to(
        np.asarray(values, np.float32)[:, None, None], (len(values), *shape)
    ).copy()


@cache
def _loaded(network: Network, threads: int) -> Any:
    net = _ncnn().Net()
    net.opt.use_vulkan_compute = False
    net.opt.num_threads = threads
    for load, file in zip((net.load_param, net.load_model), model_files(network), strict=True):
        if load(str(file)) != 0:
            raise ConfigurationError(f"{file} cannot be loaded by ncnn")
    return net


@cache
def _ncnn() -> Any:
    folder = str(packages_folder().resolve())
    if folder not in sys.path:
        sys.path.append(folder)
    import ncnn

    return ncnn
