"""Relief: nearness of what a picture shows, on a coarse grid, by which it can be warped to a later moment."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ..scene.camera import Camera
from ..scene.scene import Actor, Scene

MAX_MOVERS = 31
"""Number of road users that move on their own in a warped picture, those that cover most of it."""

_NODES = 8_000  # at most, about: a software rasterizer draws so many in a few milliseconds
_AROUND_M = 0.15  # by which a road user may be larger than its box
_ABOVE_ROAD_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """Inverse depth in 1/m at the corners of blocks of pixels, 0 where there is only sky.

    A corner has that of the nearest surface in the four blocks around it, so that silhouettes move as a whole and what
    is behind them is stretched.
    """

    camera: Camera
    """That of the picture, a pinhole."""
    step: int
    """Side of a block in pixels; the last column and row of blocks may reach beyond the picture."""
    inverse_m: Float32[np.ndarray, "rows columns"]
    owners: UInt8[np.ndarray, "rows columns"]
    """Number of the road user, from 1, that a corner belongs to; 0 for what stands still."""
    movers: tuple[Actor, ...]
    scene: Scene
    time_s: float

    @classmethod
    def of(cls, depth_m: Float32[np.ndarray, "h w"], camera: Camera, scene: Scene, time_s: float) -> "Relief":
        """Relief of a picture's depth along the view axis, which is 0 or infinite where it is empty."""
        height, width = depth_m.shape
        step = max(1, int(np.ceil(np.sqrt(height * width / _NODES))))
        rows, columns = -(-height // step), -(-width // step)
        inverse = np.zeros((rows * step, columns * step), np.float32)
        np.divide(np.float32(1), depth_m, out=inverse[:height, :width], where=depth_m > 0)
        if camera.is_orthographic:  # what is empty is not at infinity, but as far as the rest
            inverse[inverse == 0] = inverse.max(initial=0.0)
        blocks = np.pad(inverse.reshape(rows, step, columns, step).max(axis=(1, 3)), 1, mode="edge")
        pairs = np.maximum(blocks[1:], blocks[:-1])
        corners = np.maximum(pairs[:, 1:], pairs[:, :-1])
        owners, movers = _owners(corners, step, camera, scene, time_s)
        return cls(camera, step, corners, owners, movers, scene, time_s)

    def motions(self, time_s: float) -> Float64[np.ndarray, "m 4 4"]:
        """Motion in the world, since the picture, of what stands still and of each road user."""
        found = [np.eye(4)]
        for actor in self.movers:
            before, now = actor.pose_at(self.time_s), actor.pose_at(time_s)
            found.append(np.eye(4) if before is None or now is None else now @ np.linalg.inv(before))
        to_world = self.scene.scene_to_world
        return to_world @ np.stack(found) @ np.linalg.inv(to_world)


def _owners(
    inverse_m: Float32[np.ndarray, "rows columns"], step: int, camera: Camera, scene: Scene, time_s: float
) -> tuple[UInt8[np.ndarray, "rows columns"], tuple[Actor, ...]]:
    """Road user of each corner, and the road users."""
    owners = np.zeros(inverse_m.shape, np.uint8)
    at = np.flatnonzero(inverse_m)
    depth_m = 1 / inverse_m.ravel()[at].astype(np.float64)
    row, column = np.divmod(at, inverse_m.shape[1])
    seen = np.stack([(step * column - camera.cx) / camera.fx, (step * row - camera.cy) / camera.fy], axis=-1)
    points = np.column_stack([seen * depth_m[:, None], depth_m, np.ones_like(depth_m)])
    around_m = _AROUND_M + step * depth_m / camera.fx
    unit_m = scene.metres_per_unit
    found = list[tuple[Actor, np.ndarray]]()
    for actor in scene.actors:
        pose = actor.pose_at(time_s) if actor.visible else None
        if pose is None:
            continue
        to_actor = np.linalg.inv(camera.world_to_camera @ scene.scene_to_world @ pose)
        x, y, z = unit_m * (to_actor[:3] @ points.T)
        length, width, height = (unit_m * each for each in actor.size_lwh)
        beside_m = np.maximum(np.abs(x) - length / 2, np.abs(y) - width / 2)
        inside = at[(beside_m < around_m) & (z > _ABOVE_ROAD_M) & (z < height + around_m)]
        if len(inside):
            found.append((actor, inside))
    found.sort(key=lambda each: -len(each[1]))
    for number, (_, inside) in enumerate(found[:MAX_MOVERS], start=1):
        owners.flat[inside] = number
    return owners, tuple(actor for actor, _ in found[:MAX_MOVERS])
