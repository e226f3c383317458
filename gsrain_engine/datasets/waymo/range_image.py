"""Waymo's range images turned into points. Facts: RangeImage in dataset.proto and v2/perception/lidar.py there."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Float64
from numba import njit

from ..geometry.rigid_poses import inverse

LASERS = {1: "TOP", 2: "FRONT", 3: "SIDE_LEFT", 4: "SIDE_RIGHT", 5: "REAR"}
"""Names of lidars by their numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class WaymoLaser:
    """Where a lidar sits and how its rows look: row 0 of a range image is the highest beam."""

    to_vehicle: Float64[np.ndarray, "4 4"]
    inclinations_rad: Float64[np.ndarray, " k"]
    """Of each row from the lowest up, or the lowest and the highest edge (2) of evenly spaced rows."""
    is_even: bool

    def points(
        self,
        ranges: Float32[np.ndarray, "h w c"],
        pixel_poses: Float32[np.ndarray, "u v d"] | None,
        vehicle_to_world: Float64[np.ndarray, "4 4"],
    ) -> tuple[Float64[np.ndarray, "p 3"], Float32[np.ndarray, " p"]]:
        """Points (m) in the vehicle's frame at the frame's pose, and intensities; ValueError where shapes disagree.

        Column 0 looks backwards, and columns turn clockwise as seen from above, in the vehicle's directions.
        `pixel_poses` (height, width; roll pitch yaw x y z) is where the vehicle was at each pixel's own time, if known.
        """
        height, width = ranges.shape[:2]
        if pixel_poses is not None and pixel_poses.shape != (height, width, 6):
            raise ValueError(f"poses of the shape {pixel_poses.shape} belong to a range image of {height}x{width}")
        turned = np.arctan2(self.to_vehicle[1, 0], self.to_vehicle[0, 0])
        yaw = np.pi - 2 * np.pi * (np.arange(width) + 0.5) / width - turned
        pitch = self._row_pitches(height)
        poses = np.zeros((0, 0, 6), np.float32) if pixel_poses is None else np.ascontiguousarray(pixel_poses)
        back = inverse(vehicle_to_world)
        points = _points(np.ascontiguousarray(ranges), pitch, yaw, self.to_vehicle, poses, back)
        seen = ranges[..., 0] > 0
        light = ranges[..., 1][seen] if ranges.shape[2] > 1 else np.zeros(len(points), np.float32)
        return points, np.ascontiguousarray(light, np.float32)

    def _row_pitches(self, height: int) -> Float64[np.ndarray, " h"]:
        if self.is_even:
            low, high = self.inclinations_rad
            return (low + (high - low) * (np.arange(height) + 0.5) / height)[::-1]
        if len(self.inclinations_rad) != height:
            raise ValueError(f"a lidar of {len(self.inclinations_rad)} beams has a range image of {height} rows")
        return self.inclinations_rad[::-1]


@njit(cache=True)
@no_type_check
def _points(ranges, pitch, yaw, to_vehicle, poses, back):
    """Points of all pixels with a range, row by row; `poses` is empty where the vehicle stood still."""
    count = 0
    for row in range(ranges.shape[0]):
        for column in range(ranges.shape[1]):
            count += ranges[row, column, 0] > 0
    points = np.empty((count, 3))
    k = 0
    for row in range(ranges.shape[0]):
        flat, rise = np.cos(pitch[row]), np.sin(pitch[row])
        for column in range(ranges.shape[1]):
            distance = float(ranges[row, column, 0])
            if not distance > 0:
                continue
            x, y, z = distance * flat * np.cos(yaw[column]), distance * flat * np.sin(yaw[column]), distance * rise
            x, y, z = _moved(to_vehicle, x, y, z)
            if poses.shape[0] > 0:
                # To the world from where the vehicle was then: roll about x, pitch about y, yaw about z, in this order.
                roll, nod, heading = poses[row, column, 0], poses[row, column, 1], poses[row, column, 2]
                y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
                x, z = np.cos(nod) * x + np.sin(nod) * z, np.cos(nod) * z - np.sin(nod) * x
                x, y = np.cos(heading) * x - np.sin(heading) * y, np.sin(heading) * x + np.cos(heading) * y
                x, y, z = x + poses[row, column, 3], y + poses[row, column, 4], z + poses[row, column, 5]
                x, y, z = _moved(back, x, y, z)
            points[k, 0], points[k, 1], points[k, 2] = x, y, z
            k += 1
    return points


@njit(cache=True)
@no_type_check
def _moved(pose, x, y, z):
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )
