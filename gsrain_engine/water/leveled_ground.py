"""Leveled ground: the uneven ground of a capture as the level one that a mirror needs, with everything that is on it.

A camera is turned about the point of the ground under it, so that the plane of the ground before it becomes level. What
the mirror image shows is lowered by the height of the ground below it, so that objects and their reflections meet.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ..scene.camera import Camera
from ..scene.gaussians import Gaussians, IdentityKey, scene_cache
from ..scene.ground_water import GroundWater
from ..scene.lamps import LitLamps
from ..scene.scene import DrawItem, rotation_to_z_up

_AHEAD_M = 8.0
"""Distance of the middle of the ground that a camera on a vehicle mainly shows."""
_AROUND_M, _PER_HEIGHT = 6.0, 2.0
"""Standard deviation of the weights around that point, and its increase per meter of the camera's height."""
_REACH = 2.5  # of the weights, in standard deviations
_STEP_M = 0.5
_RIDGE = 1e-3  # towards level ground, of the plane's slopes
_DRY = 0.1  # weight of dry ground relative to wet ground


class LeveledView(NamedTuple):
    """A camera over level ground. World frame, meters; for uneven ground the world is turned."""

    camera: Camera
    ground_m: float
    to_level: Float64[np.ndarray, "4 4"] | None = None
    """Rotation of the world; None if the ground is level."""


def leveled_view(camera: Camera, water: GroundWater | None, ground_m: float) -> LeveledView:
    """View of a camera over ground at a height, or at the heights of the map, as if it were level.

    The plane is a weighted least-squares fit to the ground before the camera, which changes smoothly with its pose.
    """
    if water is None or water.heights_m is None:
        return LeveledView(camera, ground_m)
    eye = camera.position
    below = float(water.height_at(eye[None, :2])[0])
    around = _AROUND_M + _PER_HEIGHT * max(float(eye[2]) - below, 0.0)
    middle = eye[:2] + _AHEAD_M * camera.world_to_camera[2, :2]
    stride = max(int(_STEP_M / water.cell_m), 1)
    rows, columns = water.heights_m.shape
    axes: list[np.ndarray] = []
    for k, count in enumerate((columns, rows)):
        first, last = ((middle[k] + side * _REACH * around - water.corner_m[k]) / water.cell_m for side in (-1, 1))
        axes.append(np.arange(max(int(first), 0), min(int(last) + 1, count), stride))
    if not (len(axes[0]) and len(axes[1])):
        return LeveledView(camera, below)
    own = np.ix_(axes[1], axes[0])
    heights = water.heights_m[own].ravel() - below
    wet = water.cover[own].max(axis=2).ravel() / 255
    x, y = (water.corner_m[k] + (axes[k] + 0.5) * water.cell_m for k in (0, 1))
    x, y = (each.ravel() for each in np.meshgrid(x, y))
    weights = (_DRY + wet) * np.exp(-0.5 * ((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / around**2)
    rows_of = np.stack([np.ones(len(x)), (x - eye[0]) / around, (y - eye[1]) / around], axis=1)
    normal_matrix = (rows_of * weights[:, None]).T @ rows_of + _RIDGE * weights.sum() * np.diag([0.0, 1.0, 1.0])
    height, *slopes = np.linalg.solve(normal_matrix, rows_of.T @ (weights * heights))
    across, along = (float(each) / around for each in slopes)
    foot = np.array([eye[0], eye[1], below + height])
    length = float(np.sqrt(across**2 + along**2 + 1))
    to_level = np.eye(4)
    to_level[:3, :3] = rotation_to_z_up((-across / length, -along / length, 1 / length))
    to_level[:3, 3] = foot - to_level[:3, :3] @ foot
    return LeveledView(camera.moved(to_level), float(foot[2]), to_level)


def leveled_item(item: DrawItem, view: LeveledView, water: GroundWater, *, is_fixed: bool) -> DrawItem:
    """Item of the world over level ground: each fixed Gaussian by the ground below itself, an actor as a whole."""
    if view.to_level is None or water.heights_m is None:
        return item
    pose = item.to_world.copy()
    pose[2, 3] += view.ground_m
    if is_fixed:
        flat = _flattened(item.gaussians, item.to_world.tobytes(), IdentityKey(water))
        return item._replace(gaussians=flat, to_world=pose)
    pose[2, 3] -= float(water.height_at(pose[None, :2, 3])[0])
    return item._replace(to_world=pose)


@scene_cache(maxsize=16)
def _flattened(gaussians: Gaussians, to_world: bytes, key: IdentityKey) -> Gaussians:
    """Gaussians lowered by the height of the ground at their place in the world."""
    water: GroundWater = key.of  # pyright: ignore[reportAssignmentType]
    pose = np.frombuffer(to_world, np.float64).reshape(4, 4)
    places = gaussians.means @ pose[:2, :3].astype(np.float32).T + pose[:2, 3].astype(np.float32)
    upward = np.linalg.inv(pose[:3, :3])[:, 2].astype(np.float32)
    means = gaussians.means - water.height_at(places)[:, None] * upward
    return Gaussians(means, gaussians.scales, gaussians.quaternions, gaussians.opacities, gaussians.sh)


def leveled_lamps(lamps: LitLamps | None, view: LeveledView) -> LitLamps | None:
    """Lamps of the world over level ground."""
    if lamps is None or view.to_level is None:
        return lamps
    turn = view.to_level[:3, :3]
    positions = lamps.positions_m @ turn.T + view.to_level[:3, 3]
    return lamps._replace(positions_m=positions, directions=lamps.directions @ turn.T)
