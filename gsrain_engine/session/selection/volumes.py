"""Gaussians within a ball or a box of the world, wherever the camera looks."""

from dataclasses import dataclass, replace
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Part
from gsrain_engine.scene.scene import Scene

from ..edits.cropping import CropBox
from .candidates import candidates

_LEAST_RADIUS_M = 0.01


@dataclass(frozen=True)
class Ball:
    """A ball in the world."""

    center_m: tuple[float, float, float]
    radius_m: float

    def reaching(self, eye_m: Float64[np.ndarray, "3"], sight: Float64[np.ndarray, "3"]) -> "Ball":
        """Return the ball around the same centre that a line of sight touches; `sight` is a unit vector."""
        to_center = self.middle - eye_m
        beside = to_center - (to_center @ sight) * sight
        return replace(self, radius_m=max(float(np.linalg.norm(beside)), _LEAST_RADIUS_M))

    @property
    def middle(self) -> Float64[np.ndarray, "3"]:
        return np.array(self.center_m)

    def circles_m(self, points: int) -> Float64[np.ndarray, "3 points 3"]:
        """Points on its three great circles that lie along two axes of the world each."""
        angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
        flat = np.stack([np.cos(angle), np.sin(angle), np.zeros(points)], axis=1)
        return self.middle + self.radius_m * np.stack([np.roll(flat, axis, axis=1) for axis in range(3)])

    @property
    def to_unit(self) -> Float64[np.ndarray, "4 4"]:
        """Matrix that takes the world to where the ball is the unit ball."""
        matrix = np.eye(4)
        matrix[:3, :3] /= self.radius_m
        matrix[:3, 3] = -self.middle / self.radius_m
        return matrix


Volume = Ball | CropBox


def standing_on(box: CropBox, point_m: Float64[np.ndarray, "3"]) -> CropBox:
    """Return the box with the middle of its bottom moved to a point."""
    x, y, z = point_m.tolist()
    return replace(box, center_m=(x, y, z + box.size_m[2] / 2))


def in_volume(scene: Scene, time_s: float, volume: Volume) -> dict[str, Mask]:
    """Find the Gaussians whose centres lie in a volume at a time, also those outside the picture."""
    return {each.key: Mask.of(_inside(each.part, volume)) for each in candidates(scene, time_s)}


def _inside(part: Part, volume: Volume) -> Bool[np.ndarray, " n"]:
    flags = np.empty(len(part.gaussians), np.bool_)
    to_unit = volume.to_unit if isinstance(volume, Ball) else np.linalg.inv(volume.to_world)
    to_unit = np.ascontiguousarray((to_unit @ part.to_world)[:3])
    _find_inside(part.gaussians.means, to_unit, isinstance(volume, Ball), flags)
    return flags


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def _find_inside(means, m, is_round, flags):
    """Flag what a matrix takes into the unit ball, or into the cube from -1 to 1."""
    for i in range(len(means)):
        x, y, z = means[i, 0], means[i, 1], means[i, 2]
        a = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        b = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        c = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if is_round:
            flags[i] = a * a + b * b + c * c <= 1
        else:
            flags[i] = abs(a) <= 1 and abs(b) <= 1 and abs(c) <= 1
