"""What networks and programs of others made, kept on disk: of the same, they make the same.

They take most of the time of a report, and none of it depends on this project's method.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pipeline.evaluation import networks, rivals
from pipeline.evaluation.fusing import Asked, Fuser
from pipeline.evaluation.methods import Accounted
from pipeline.evaluation.rivals import Given, Grey, Peer
from pipeline.machine import described
from pipeline.media.files import write_atomic

Picture = npt.NDArray[np.uint8]


def made_once(
    peer: Peer,
    image: Grey,
    given: Given,
    folder: Path | None,
    make: Callable[[], Accounted[Picture]],
) -> Accounted[Picture]:
    """Return what a peer makes of an LR picture, from the folder if it is there.

    Parameters
    ----------
    folder : Path, optional
        None, or a peer without networks: it is made, and nothing is kept.
    make : callable
        Makes it.
    """
    if folder is None or not peer.networks:
        return make()
    files = [Path(str(module.__file__)) for module in (rivals, networks)]
    files += [file for network in peer.networks for file in networks.model_files(network)]
    pca = rivals.pca_file()
    if pca is not None:
        files.append(pca)
    return _kept(folder, _digest(f"{peer.name} {given}", [image], files), make)


def fused_once(
    fuser: Fuser,
    asked: Asked,
    folder: Path | None,
    make: Callable[[], Accounted[Picture]],
) -> Accounted[Picture]:
    """Return what a peer makes of a region with the help of all views, as :func:`made_once`."""
    if folder is None:
        return make()
    words = f"{fuser.name} {asked.number} {asked.sigma} {asked.region}"
    images = [view.luma for view in asked.frame.views]
    return _kept(folder, _digest(words, images, fuser.files()), make)


def _kept(folder: Path, digest: str, make: Callable[[], Accounted[Picture]]) -> Accounted[Picture]:
    path = folder / f"{digest}.npz"
    if path.is_file():
        with np.load(path, allow_pickle=False) as found:
            seconds, cpu_seconds, memory_mib = (float(value) for value in found["cost"])
            return Accounted(
                result=found["picture"], seconds=seconds, cpu_seconds=cpu_seconds,
                memory_mib=memory_mib,
            )  # fmt: skip
    made = make()
    stream = io.BytesIO()
    cost = np.array([made.seconds, made.cpu_seconds, made.memory_mib])
    np.savez_compressed(stream, picture=made.result, cost=cost)
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(path, stream.getvalue())
    return made


def _digest(asked: str, images: Iterable[Grey], files: Iterable[Path]) -> str:
    """Return a name for all that a picture and its cost depend on."""
    digest = hashlib.sha256(f"{asked} {described()}".encode())
    for image in images:
        digest.update(f" {image.shape}".encode())
        digest.update(np.ascontiguousarray(image, np.float32).tobytes())
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:32]
