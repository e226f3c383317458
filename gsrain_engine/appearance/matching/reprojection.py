"""Pixels of one camera in another one, by their depth. Cameras in the world; depth along the view axis."""

import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.datasets.geometry.lens_projection import intrinsics
from gsrain_engine.scene.camera import Camera


def reprojected(
    inverse_depth: Float[np.ndarray, "h w"], of: Camera, to: Camera
) -> tuple[Float64[np.ndarray, "h w 2"], Float64[np.ndarray, "h w"]]:
    """Return column and row in the other camera (first centre at 0.5), and depth there in metres, of each pixel.

    Equations (13)-(15) of the paper divided by depth: with w = 1/d, (x, y, z)/d = K' R' R^-1 K^-1 (u, v, 1) + w K' t.
    Inverse depth 0 is infinitely far away, where only the rotation counts; its depth comes out infinite. Depth is at
    most 0 behind the other camera.
    """
    turn = to.world_to_camera[:3, :3] @ of.world_to_camera[:3, :3].T
    shift = to.world_to_camera[:3, 3] - turn @ of.world_to_camera[:3, 3]
    k_to = intrinsics(to)
    columns = (np.arange(of.width) + 0.5 - of.cx) / of.fx
    rows = (np.arange(of.height) + 0.5 - of.cy) / of.fy
    along = k_to @ turn
    moved = k_to @ shift
    x, y, z = (
        along[i, 0] * columns[None] + (along[i, 1] * rows + along[i, 2])[:, None] + moved[i] * inverse_depth
        for i in range(3)
    )
    ahead = z > 1e-9
    divisor = np.where(ahead, z, 1.0)
    places = np.stack([x / divisor, y / divisor], axis=2)
    with np.errstate(divide="ignore"):
        depth = np.where(ahead, z / np.maximum(inverse_depth, 0), -1.0)
    return places, depth
