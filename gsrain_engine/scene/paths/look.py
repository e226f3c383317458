"""Rotation and field of view of a camera in the numbers that people set: heading, pitch, roll, focal length."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

_FILM_HEIGHT_MM = 24.0
"""Of the 35 mm film that focal lengths are compared on."""
_STRAIGHT_UP = 1 - 1e-12


class LookAngles(NamedTuple):
    """Where a camera looks, in a world with z up; degrees."""

    heading_deg: float
    """From +x to +y; -180..180."""
    pitch_deg: float
    """Upwards; -90..90."""
    roll_deg: float
    """How far the camera leans to its right: positive turns the picture's content to the left; -180..180."""


def look_angles(camera_to_world: Float64[np.ndarray, "3 3"]) -> LookAngles:
    """Angles of a rotation (OpenCV axes). One that looks straight up or down has no roll: it is all heading."""
    right, down, forward = camera_to_world.T
    pitch = np.arcsin(np.clip(forward[2], -1, 1))
    if abs(forward[2]) > _STRAIGHT_UP:
        return _in_degrees(np.arctan2(right[0], -right[1]), pitch, 0.0)
    heading = np.arctan2(forward[1], forward[0])
    level = np.array([np.sin(heading), -np.cos(heading), 0.0])
    roll = np.arctan2(-level @ down, level @ right)
    return _in_degrees(heading, pitch, roll)


def look_rotation(angles: LookAngles) -> Float64[np.ndarray, "3 3"]:
    """Rotation, camera to world (OpenCV axes), that has these angles."""
    heading, pitch, roll = np.radians(angles)
    forward = np.array([np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), np.sin(pitch)])
    level = np.array([np.sin(heading), -np.cos(heading), 0.0])
    below = np.cross(forward, level)
    right = np.cos(roll) * level + np.sin(roll) * below
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def focal_length_mm(vertical_fov_deg: float) -> float:
    """Focal length of the lens that sees as much from top to bottom on 35 mm film (a picture 24 mm high)."""
    return float(_FILM_HEIGHT_MM / 2 / np.tan(np.radians(vertical_fov_deg) / 2))


def fov_of_focal_length(focal_mm: float) -> float:
    """Vertical field of view in degrees of a lens on 35 mm film."""
    return float(np.degrees(2 * np.arctan(_FILM_HEIGHT_MM / 2 / focal_mm)))


def _in_degrees(heading: float, pitch: float, roll: float) -> LookAngles:
    """Without what is only rounding, which would be read as -0.0."""
    return LookAngles(*(np.degrees([heading, pitch, roll]).round(9) + 0.0).tolist())
