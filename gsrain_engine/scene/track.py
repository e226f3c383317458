"""Where a thing is over time: samples of its pose, and what lies between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from .rotations import matrices_from_quaternions, quaternions_from_matrices


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where an actor is over time: samples, linear and slerp between them. Outside its times it stays put."""

    times: Float64[np.ndarray, " t"]
    """Seconds, rising."""
    positions: Float64[np.ndarray, "t 3"]
    """Bottom centre of the object, in scene units and axes."""
    quaternions_wxyz: Float64[np.ndarray, "t 4"]
    """Object (x forward, y left, z up) to scene axes, unit."""
    valid: Bool[np.ndarray, " t"]
    """Whether the object is in the scene from this sample to the next."""

    @classmethod
    def standing(cls, pose: Float64[np.ndarray, "4 4"]) -> "Track":
        """Return the track of something that stays where it is; of a pose with scale, only place and turn."""
        turn = pose[:3, :3] / np.cbrt(np.linalg.det(pose[:3, :3]))
        quaternion = np.asarray(quaternions_from_matrices(turn[None]), np.float64)
        return cls(np.zeros(1), pose[None, :3, 3].copy(), quaternion, np.ones(1, bool))

    def pose(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        """Object to scene at a time, or None while the object is not there."""
        if not len(self.times):
            return None
        lower = max(int(np.searchsorted(self.times, time_s, side="right")) - 1, 0)
        upper = min(lower + 1, len(self.times) - 1)
        if not self.valid[lower]:
            return None
        span = self.times[upper] - self.times[lower]
        part = float(np.clip((time_s - self.times[lower]) / span, 0, 1)) if span > 0 else 0.0
        matrix = np.eye(4)
        matrix[:3, :3] = matrices_from_quaternions(
            _slerp(self.quaternions_wxyz[lower], self.quaternions_wxyz[upper], part)
        )
        matrix[:3, 3] = (1 - part) * self.positions[lower] + part * self.positions[upper]
        return matrix

    def moved(self, similarity: Float64[np.ndarray, "4 4"]) -> "Track":
        """Return the track moved, turned and scaled, all samples alike."""
        turn = similarity[:3, :3] / np.cbrt(np.linalg.det(similarity[:3, :3]))
        quaternions = quaternions_from_matrices(turn @ matrices_from_quaternions(self.quaternions_wxyz))
        return Track(self.times, self.positions @ similarity[:3, :3].T + similarity[:3, 3], quaternions, self.valid)


def _slerp(start: Float64[np.ndarray, "4"], end: Float64[np.ndarray, "4"], part: float) -> Float64[np.ndarray, "4"]:
    """Spherical linear interpolation of unit quaternions along the shorter way (Shoemake, 1985)."""
    cosine = float(start @ end)
    if cosine < 0:
        end, cosine = -end, -cosine
    if cosine > 0.9995:  # nearly equal: the sine below would divide by nothing
        mixed = (1 - part) * start + part * end
    else:
        angle = np.arccos(cosine)
        mixed = (np.sin((1 - part) * angle) * start + np.sin(part * angle) * end) / np.sin(angle)
    return mixed / np.linalg.norm(mixed)
