"""The plane of the ground and the camera mirrored in it. World frame (metres, z up)."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.scene.camera import Camera

_STEEPEST_UP = 0.9
"""Least upward component of a ground's normal: 26 degrees of slope."""
_TRIPLES, _VOTERS = 400, 4000
_NEAR_PLANE_M = 0.08
"""Points so close to a plane vote for it."""
_BELOW_COUNTS = 2.0
"""How much more a point below a plane counts against it than one upon it does for it: nothing is under the ground."""
_ROUNDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class GroundPlane:
    """All points with normal . point = offset_m."""

    normal: Float64[np.ndarray, "3"]
    """Unit, upwards, in the world."""
    offset_m: float

    def heights(self, points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        """Signed distance of points over the plane, in metres."""
        return np.asarray(points, np.float64) @ self.normal - self.offset_m

    @property
    def reflection(self) -> Float64[np.ndarray, "4 4"]:
        """What takes points of the world to their mirror images (Householder); its determinant is -1."""
        matrix = np.eye(4)
        matrix[:3, :3] -= 2 * np.outer(self.normal, self.normal)
        matrix[:3, 3] = 2 * self.offset_m * self.normal
        return matrix

    def mirrored(self, camera: Camera) -> Camera:
        """Return the camera that stands where the eye's mirror image is, and sees what the plane mirrors.

        A reflection makes a right-handed camera left-handed, so the picture's rows are turned over: what the mirror
        shows at (u, v) of the eye's picture, the mirrored camera sees at (u, height - v). Mirrored twice it is itself.
        """
        rows_turned = np.diag([1.0, -1.0, 1.0, 1.0])
        pose = rows_turned @ camera.world_to_camera @ self.reflection
        return replace(camera, cy=camera.height - camera.cy, world_to_camera=pose)


def fitted_plane(points: Float64[np.ndarray, "n 3"], tolerance_m: float) -> GroundPlane | None:
    """Fit the plane that lies under a cloud of points most of which may be on other things; None where there is none.

    Planes through three points of the cloud, upright enough, are voted on (RANSAC, Fischler and Bolles 1981; points far
    below count against one), and the best is fitted to the points around it by reweighted least squares (Cauchy's
    weights of scale `tolerance_m`). The draws are seeded.
    """
    if len(points) < 3:
        return None
    rng = np.random.default_rng(0)
    voters = points[rng.integers(len(points), size=_VOTERS)]
    triples = points[rng.integers(len(points), size=(_TRIPLES, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(lengths, 1e-12)[:, None]
    normals = normals * np.where(normals[:, 2] < 0, -1.0, 1.0)[:, None]
    upright = (normals[:, 2] > _STEEPEST_UP) & (lengths > 1e-9)
    if not upright.any():
        return None
    normals, offsets = normals[upright], np.einsum("ij,ij->i", normals[upright], triples[upright, 0])
    heights = voters @ normals.T - offsets
    votes = np.sum(np.abs(heights) < _NEAR_PLANE_M, axis=0) - _BELOW_COUNTS * np.sum(heights < -0.3, axis=0)
    best = int(np.argmax(votes))
    return settled(GroundPlane(normals[best], float(offsets[best])), points, tolerance_m)


def settled(plane: GroundPlane, points: Float64[np.ndarray, "n 3"], tolerance_m: float) -> GroundPlane:
    """Fit a plane to those of the points that are near it, by reweighted least squares (Cauchy's weights)."""
    for _ in range(_ROUNDS):
        weights = 1 / (1 + (plane.heights(points) / tolerance_m) ** 2) ** 2
        total = weights.sum()
        if total < 3:
            return plane
        middle = weights @ points / total
        about = points - middle
        _, vectors = np.linalg.eigh((about * weights[:, None]).T @ about)
        normal = vectors[:, 0] * (1.0 if vectors[2, 0] >= 0 else -1.0)
        if normal[2] < _STEEPEST_UP:
            return plane
        plane = GroundPlane(normal, float(normal @ middle))
    return plane
