"""One set of Gaussians made of a whole scene, for files that know neither actors nor units."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from .gaussians import Gaussians
from .grading import graded
from .members import Part
from .rotations import quaternion_product, quaternions_from_matrices
from .scene import Scene, rotation_to_z_up
from .spherical_harmonics import rotate_sh
from .wet_colors import blended_sh

FILE_UP = (0.0, -1.0, 0.0)
"""Upward in files that can't say it: y points down, as in COLMAP and thus in 3DGS captures."""


def moved(gaussians: Gaussians, similarity: Float64[np.ndarray, "4 4"]) -> Gaussians:
    """Move, turn and scale Gaussians; their spherical harmonics turn with them.

    `similarity` is a rotation times one scale above 0, and a translation. The identity returns the very same value.
    """
    if np.array_equal(similarity, np.eye(4)):
        return gaussians
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    rotation = similarity[:3, :3] / scale
    turn = quaternions_from_matrices(rotation)
    means = gaussians.means.astype(np.float64) @ similarity[:3, :3].T + similarity[:3, 3]
    quaternions = quaternion_product(np.broadcast_to(turn, gaussians.quaternions.shape), gaussians.quaternions)
    return Gaussians(
        means.astype(np.float32),
        gaussians.scales * np.float32(scale),
        quaternions.astype(np.float32),
        gaussians.opacities,
        rotate_sh(gaussians.sh, rotation),
    )


def flattened(scene: Scene, time_s: float = 0.0) -> Gaussians:
    """All that can be seen at a time, in metres with `FILE_UP` upwards: what single-file scenes are read as.

    A scene that was read from a single file comes out unchanged, and every scene looks the same from the same world
    camera before and after it went through a single file.
    """
    world_to_file = np.eye(4)
    world_to_file[:3, :3] = rotation_to_z_up(FILE_UP).T
    return Gaussians.concatenate([moved(baked(part), world_to_file @ part.to_world) for part in scene.parts(time_s)])


def baked(part: Part) -> Gaussians:
    """Return what remains of a part, with its opacity, wetness and grading in the Gaussians themselves."""
    gaussians = part.remaining
    if part.is_wet and part.wet_sh is not None:
        wet_sh = part.wet_sh if not part.left_out else part.wet_sh[(~part.left_out).indices]
        gaussians = gaussians.with_sh(blended_sh(gaussians.sh, wet_sh, part.wetness))
    if part.opacity != 1:
        gaussians = replace(gaussians, opacities=gaussians.opacities * np.float32(part.opacity))
    return gaussians if part.colors is None else gaussians.with_sh(graded(gaussians.sh, part.colors))
