"""``--view-at``: a frame whose two neighbours are super-resolved gets the view between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pipeline.errors import ConfigurationError
from pipeline.frames import GreyImage, MultiViewFrame, Place, RegisteredView
from pipeline.freeview import Neighbour, between, hr_motion
from pipeline.grid import Grid
from pipeline.media.info import SceneInfo
from pipeline.results import FrameResult, SuperResolvedImage, WholeColour

UNSEEN = 0.02
"""Share of the picture that no neighbour sees from which the report says so."""


def place_of(view_at: float, info: SceneInfo, observed: tuple[str, ...] | None) -> Place:
    """Return the neighbours of a place, counted in views from 0, left to right.

    Raises
    ------
    ConfigurationError
        If the place is a camera's own, lies outside the row of cameras, or beside one that is
        not observed.
    """
    last = len(info.view_ids) - 1
    first = int(view_at)
    if not 0 < view_at < last or view_at == first:
        raise ConfigurationError(
            f"--view-at: must lie between two of the views 0 to {last}, as 0.5 does, "
            f"not {view_at:g}; --layout views writes the cameras' own"
        )
    place = Place(
        left=info.view_ids[first], right=info.view_ids[first + 1], at=view_at - first
    )  # fmt: skip
    for view in (place.left, place.right):
        if observed is not None and view not in observed:
            raise ConfigurationError(f"--view-at: {view_at:g} needs view {view!r} among --views")
    return place


def neighbour_of(
    frame: MultiViewFrame,
    view_id: str,
    luma: GreyImage,
    chroma: npt.NDArray[np.float32] | None,
    onto_other: RegisteredView,
    grid: Grid,
) -> Neighbour:
    """Return a view as a neighbour, by where registration found its pixels in the other one."""
    depth = frame.view(view_id).depth_map
    nearness = np.zeros(onto_other.flags.shape, np.float32)
    if depth is not None:
        nearness = np.nan_to_num(depth)
    motion, near = hr_motion(onto_other.position, onto_other.verification_map, nearness, grid)
    return Neighbour(luma=luma, chroma=chroma, motion=motion, nearness=near)


def with_view_between(
    result: FrameResult, frame: MultiViewFrame, place: Place, name: str, grid: Grid
) -> FrameResult:
    """Return the result with one more image, that of the place, under the name given.

    The result holds both neighbours, and how they were registered (its intermediates).
    """
    neighbours = [
        neighbour_of(
            frame, here, result.images[here].luma, result.images[here].chroma,
            next(v for v in result.debug[there].registered if v.view_id == here), grid,
        )
        for here, there in ((place.left, place.right), (place.right, place.left))
    ]  # fmt: skip
    made = between(neighbours[0], neighbours[1], place.at)
    image = SuperResolvedImage(
        view_id=name,
        luma=made.luma,
        colour=None if made.chroma is None else WholeColour(chroma=made.chroma),
    )
    report = result.report
    unseen = 1.0 - float(made.seen.mean())
    if unseen > UNSEEN:
        text = f"{100 * unseen:.1f} % of the view at {name} is seen by neither neighbour: a guess"
        report = replace(report, warnings=(*report.warnings, text))
    return replace(result, images={**result.images, name: image}, report=report)
