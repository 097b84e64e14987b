"""What stands on the stage of the sample scene, where, and how it moves.

A room with a wooden floor and a papered wall: x to the right, y *down*, z away
from the cameras, metres; the floor is y = 0. Knows nothing of cameras or pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from pipeline.synthetic import raycast

Vector = npt.NDArray[np.float64]
"""(3,) float64, metres."""

Rotation = npt.NDArray[np.float64]
"""(3, 3) float64; its columns are a body's axes in the world."""

Pose = tuple[Rotation, Vector]

LAMP_POSITION = np.array([-2.3, -4.2, 0.2])
LAMP_STRENGTH = 1.22
SHADOW_SOFTNESS = 0.035
"""Growth of a shadow's edge with the distance from what casts it, metres a metre."""
AMBIENT_COLOUR = (0.40, 0.43, 0.49)
LAMP_COLOUR = (1.04, 0.98, 0.88)

FLOOR_STRIPS = ((2.1, 2.75), (2.75, 3.9), (3.9, 5.5), (5.5, 8.8))
"""Near and far edge of the rows of boards, metres; each has a texture of its own density."""

WALL_CENTRE = np.array([0.0, -1.35, 6.9])
WALL_YAW = math.radians(9.0)


def turn(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Rotation:
    """Return the rotation of those angles about y, x and z, applied roll first, radians."""
    cy, sy = math.cos(yaw), math.sin(yaw)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cr, sr = math.cos(roll), math.sin(roll)
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return about_y @ about_x @ about_z


_CORNERS = np.array([[a, b, c] for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)])


def _spread_directions(count: int) -> npt.NDArray[np.float64]:
    """Return unit vectors spread evenly over the sphere, (count, 3)."""
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    around = np.arange(count) * math.pi * (3 - math.sqrt(5))
    ring = np.sqrt(1 - height**2)
    return np.stack((ring * np.cos(around), height, ring * np.sin(around)), axis=-1)


_DIRECTIONS = _spread_directions(160)


@dataclass(frozen=True, kw_only=True)
class Body:
    """One rigid surface."""

    texture: str
    kind: int
    size: tuple[float, float, float]
    """Half width, half height, corner radius; radius; or radius, half height. Metres."""
    pose: Callable[[float], Pose]
    """Axes and centre at a time in seconds."""
    group: int
    """Surfaces of one group cast no shadow on each other."""
    moves: bool = False
    shadow: bool = True
    glow: float = 0.0
    """Share of its light that does not depend on the lamp, 0..1."""

    @property
    def half_extents(self) -> Vector:
        """Half sides of the enclosing box in the body's frame, metres."""
        if self.kind == raycast.RECTANGLE:
            return np.array([self.size[0], self.size[1], 0.0])
        if self.kind == raycast.SPHERE:
            return np.full(3, self.size[0])
        return np.array([self.size[0], self.size[1], self.size[0]])

    @property
    def texture_extent(self) -> tuple[float, float]:
        """Width and height of the textured surface, metres."""
        if self.kind == raycast.RECTANGLE:
            return 2 * self.size[0], 2 * self.size[1]
        if self.kind == raycast.SPHERE:
            return 2 * math.pi * self.size[0], math.pi * self.size[0]
        return 2 * math.pi * self.size[0], 2 * self.size[1]

    def corners(self, time: float) -> npt.NDArray[np.float64]:
        """Return the corners of the enclosing box, (8, 3) metres."""
        rotation, centre = self.pose(time)
        return centre + (_CORNERS * self.half_extents) @ rotation.T

    def outline(self, time: float) -> npt.NDArray[np.float64]:
        """Return points whose convex hull holds the body with a little to spare, (P, 3) metres."""
        rotation, centre = self.pose(time)
        if self.kind == raycast.SPHERE:
            return centre + 1.03 * self.size[0] * _DIRECTIONS
        return centre + (_CORNERS * (self.half_extents + 0.008)) @ rotation.T


def fixed(rotation: Rotation, *centre: float) -> Callable[[float], Pose]:
    """Return the pose of a body that stands still."""
    pose = (rotation, np.array(centre, dtype=float))
    return lambda time: pose


def _globe(time: float) -> Pose:
    return turn(roll=math.radians(-16)) @ turn(yaw=-0.5 - 0.62 * time), np.array(
        [0.42, -0.60, 4.25]
    )


def _globe_stand(time: float) -> Pose:
    return np.eye(3), np.array([0.42, -0.06, 4.25])


def _cube_centre(time: float) -> Pose:
    return turn(yaw=0.55 + 0.75 * time), np.array(
        [0.28 + 0.10 * math.sin(1.6 * time), -0.179, 2.95]
    )


def _cube_face(axis: int) -> Callable[[float], Pose]:
    half = 0.17
    facing = (
        turn(), turn(yaw=math.pi / 2), turn(yaw=math.pi), turn(yaw=-math.pi / 2),
        turn(pitch=-math.pi / 2),
    )[axis]  # fmt: skip

    def pose(time: float) -> Pose:
        rotation, centre = _cube_centre(time)
        own = rotation @ facing
        return own, centre - half * own[:, 2]

    return pose


def _ball(time: float) -> Pose:
    """A ball that crosses the stage from left to right in bounces, over and over."""
    lap = (0.25 + time / 3.0) % 1.0
    x = -2.0 + 4.2 * lap
    bounce = (lap * 4.5) % 1.0
    y = -0.1 - 0.72 * 4 * bounce * (1 - bounce)
    return turn(roll=5.0 * time, pitch=3.0 * time), np.array([x, y, 3.55 - 0.25 * lap])


_HANGER = np.array([0.92, -2.9, 3.2])


def _swing(time: float) -> Rotation:
    return turn(roll=0.16 * math.sin(2.4 * time + 0.4)) @ turn(
        yaw=0.5 * math.sin(1.5 * time) - 0.35
    )


def _card(time: float) -> Pose:
    rotation = _swing(time)
    return rotation, _HANGER + rotation @ np.array([0.0, 1.36, 0.0])


def _string(time: float) -> Pose:
    rotation = _swing(time)
    return rotation, _HANGER + rotation @ np.array([0.0, 0.55, 0.0])


def bodies() -> tuple[Body, ...]:
    """Return everything on the stage."""
    rectangle, sphere, cylinder = raycast.RECTANGLE, raycast.SPHERE, raycast.CYLINDER
    lying = turn(pitch=-math.pi / 2)
    found = [
        Body(texture="wall", kind=rectangle, size=(4.6, 1.75, 0.0), group=0, shadow=False,
             pose=fixed(turn(yaw=WALL_YAW), *WALL_CENTRE)),
    ]  # fmt: skip
    for strip, (near, far) in enumerate(FLOOR_STRIPS):
        found.append(
            Body(texture=f"floor{strip}", kind=rectangle, group=1, shadow=False,
                 size=((2.2, 2.6, 3.4, 5.2)[strip], (far - near) / 2, 0.0),
                 pose=fixed(lying, 0.0, 0.0, (near + far) / 2))
        )  # fmt: skip
    found += [
        Body(texture="rug", kind=rectangle, size=(1.02, 0.66, 0.0), group=14, shadow=False,
             pose=fixed(turn(yaw=math.radians(9)) @ lying, 0.12, -0.006, 3.33)),
        Body(texture="column", kind=cylinder, size=(0.36, 2.2, 0.0), group=2,
             pose=fixed(turn(yaw=0.2), -1.95, -2.2, 5.35)),
        Body(texture="plinth", kind=cylinder, size=(0.47, 0.13, 0.0), group=2,
             pose=fixed(turn(), -1.95, -0.13, 5.35)),
        Body(texture="plinth_top", kind=rectangle, size=(0.47, 0.47, 0.47), group=2,
             pose=fixed(lying, -1.95, -0.26, 5.35)),
        Body(texture="shelf", kind=rectangle, size=(0.95, 0.62, 0.02), group=3,
             pose=fixed(turn(yaw=math.radians(-14)), 1.95, -0.72, 5.65)),
        Body(texture="painting", kind=rectangle, size=(0.62, 0.46, 0.0), group=4,
             pose=fixed(turn(yaw=WALL_YAW, roll=math.radians(1.2)), -0.55, -1.78, 6.86)),
        Body(texture="page", kind=rectangle, size=(0.40, 0.54, 0.015), group=5,
             pose=fixed(turn(yaw=math.radians(38), pitch=math.radians(9)), -0.72, -0.535, 4.6)),
        Body(texture="chart", kind=rectangle, size=(0.43, 0.53, 0.02), group=6, glow=0.22,
             pose=fixed(turn(yaw=math.radians(-24), pitch=math.radians(10)), 1.22, -0.525, 3.55)),
        Body(texture="can", kind=cylinder, size=(0.25, 0.34, 0.0), group=7,
             pose=fixed(turn(yaw=0.1), -0.98, -0.34, 3.25)),
        Body(texture="lid", kind=rectangle, size=(0.25, 0.25, 0.25), group=7,
             pose=fixed(lying, -0.98, -0.665, 3.25)),
        Body(texture="rod", kind=cylinder, size=(0.016, 1.05, 0.0), group=8,
             pose=fixed(turn(roll=math.radians(13), pitch=math.radians(-6)), -0.32, -0.95, 2.75)),
        Body(texture="globe", kind=sphere, size=(0.48, 0.0, 0.0), group=9, moves=True,
             pose=_globe),
        Body(texture="stand", kind=cylinder, size=(0.2, 0.06, 0.0), group=10, pose=_globe_stand),
        Body(texture="stand_top", kind=rectangle, size=(0.2, 0.2, 0.2), group=10,
             pose=fixed(lying, 0.42, -0.12, 4.25)),
        Body(texture="ball", kind=sphere, size=(0.1, 0.0, 0.0), group=12, moves=True, pose=_ball),
        Body(texture="card", kind=rectangle, size=(0.27, 0.30, 0.05), group=13, moves=True,
             pose=_card, glow=0.2),
        Body(texture="string", kind=cylinder, size=(0.008, 0.55, 0.0), group=13, moves=True,
             pose=_string, shadow=False),
    ]  # fmt: skip
    for face in range(5):
        found.append(
            Body(texture=f"cube{face}", kind=rectangle, size=(0.17, 0.17, 0.02), group=11,
                 moves=True, pose=_cube_face(face))
        )  # fmt: skip
    return tuple(found)


STAGE = bodies()
"""Everything on the stage of the sample scene."""


@lru_cache(maxsize=8)
def compiled(stage: tuple[Body, ...], time: float) -> npt.NDArray[np.float64]:
    """Return the stage at a time as the ray caster wants it, (M, NUM_COLUMNS) float64.

    The result is shared by all views of a frame: not to be written to.
    """
    table = np.zeros((len(stage), raycast.NUM_COLUMNS))
    for row, body in zip(table, stage, strict=True):
        rotation, centre = body.pose(time)
        row[raycast.KIND] = body.kind
        row[raycast.ROTATION : raycast.ROTATION + 9] = rotation.T.ravel()
        row[raycast.CENTRE : raycast.CENTRE + 3] = centre
        row[raycast.SIZE : raycast.SIZE + 3] = body.size
        row[raycast.REACH] = np.linalg.norm(body.half_extents)
        row[raycast.GLOW] = body.glow
    return table


def lamp() -> npt.NDArray[np.float64]:
    """Return the lamp as the ray caster wants it, (11,) float64."""
    return np.array([*LAMP_POSITION, LAMP_STRENGTH, SHADOW_SOFTNESS, *AMBIENT_COLOUR, *LAMP_COLOUR])


def local_frames(
    table: npt.NDArray[np.float64], centre: Vector, rays: npt.NDArray[np.float64] | None = None
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return a world point, and directions, in the frame of every body: (M, 3) and (M, 3, 3).

    The matrices take what ``rays`` (3, 3) takes to world directions.
    """
    axes = table[:, raycast.ROTATION : raycast.ROTATION + 9].reshape(-1, 3, 3)
    away = centre - table[:, raycast.CENTRE : raycast.CENTRE + 3]
    origins = np.einsum("mij,mj->mi", axes, away)
    return np.ascontiguousarray(origins), np.ascontiguousarray(
        axes if rays is None else axes @ rays
    )


@lru_cache(maxsize=8)
def all_corners(stage: tuple[Body, ...], time: float) -> npt.NDArray[np.float64]:
    """Return the corners of every body's enclosing box, (M, 8, 3) metres; not to be written to."""
    return np.stack([body.corners(time) for body in stage])


@lru_cache(maxsize=8)
def blockers(stage: tuple[Body, ...], time: float) -> npt.NDArray[np.uint8]:
    """Return in each body's row which bodies may stand before its lamp, then −1, (M, M) int16.

    Enclosing spheres are compared as seen from the lamp. Not to be written to.
    """
    away = np.array([body.pose(time)[1] for body in stage]) - LAMP_POSITION
    radius = np.array([float(np.linalg.norm(body.half_extents)) for body in stage])
    distance = np.linalg.norm(away, axis=1)
    group = np.array([body.group for body in stage])
    farthest = distance + radius
    cosine = np.clip((away @ away.T) / np.outer(distance, distance), -1, 1)
    soft = (
        radius[None, :]
        + 0.02
        + SHADOW_SOFTNESS * np.maximum(farthest[:, None] - distance[None, :], 0)
    )
    apart = np.arcsin(np.minimum(1, radius / distance))[:, None] + np.arcsin(
        np.minimum(1, soft / distance[None, :])
    )
    reached = (radius >= distance)[:, None] | (np.arccos(cosine) < apart)
    found = reached & (group[:, None] != group[None, :])
    found &= farthest[:, None] > distance[None, :] - radius[None, :]
    found &= np.array([body.shadow for body in stage])[None, :]
    out = np.full(found.shape, -1, np.int16)
    for row, which in zip(out, found, strict=True):
        numbers = np.flatnonzero(which)
        row[: numbers.size] = numbers
    return out


def may_shade(
    directions: npt.NDArray[np.float32],
    reach: npt.NDArray[np.float32],
    group: list[Body],
    time: float,
) -> npt.NDArray[np.bool_]:
    """Return which points a rigid group of bodies may keep the lamp's light from.

    ``directions`` (H, W, 3) and ``reach`` (H, W) are those of the points as seen
    from the lamp, unit vectors and metres; the group's enclosing sphere is tested.
    """
    corners = np.concatenate([body.corners(time) for body in group])
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    if group[0].kind == raycast.SPHERE:
        radius = group[0].size[0]
    else:
        radius = float(np.linalg.norm(corners - centre, axis=1).max())
    away = (centre - LAMP_POSITION).astype(np.float32)
    along = directions @ away
    margin = radius + 0.03 + SHADOW_SOFTNESS * np.maximum(reach - along + radius, 0)
    return (away @ away - along * along < margin * margin) & (along - radius < reach)
