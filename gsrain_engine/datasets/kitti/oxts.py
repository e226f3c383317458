"""KITTI's records of position and attitude (oxts) as poses in metres, by a Mercator projection.

As devkit/matlab/convertOxtsToPose.m defines it: the scale of the first record's latitude, yaw 0 to the east. The world
is x east, y north, z up; the frame is that of the inertial unit: x forward, y left, z up.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from ..capture import CaptureError
from ..geometry.rigid_poses import rigid
from .calibration import read_text

OxtsRecord = Float64[np.ndarray, "6"]
"""Latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad)."""

_LARGEST = 1e6
"""Of angles and of metres above the sea: beyond, a record is damaged."""
_EARTH_RADIUS_M = 6378137.0


def read_oxts(file: Path) -> OxtsRecord:
    """Read one record. Raises `CaptureError`."""
    words = read_text(file).split()
    try:
        values = np.array([float(word) for word in words[:6]], np.float64)
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None
    if len(values) != 6 or not np.abs(values).max() < _LARGEST or abs(values[0]) >= 90:
        raise CaptureError(f"{file}: expected latitude, longitude, altitude, roll, pitch and yaw first")
    return values


def oxts_poses(records: Sequence[OxtsRecord]) -> list[Float64[np.ndarray, "4 4"]]:
    """Poses (inertial unit to world, the first at the origin) of records."""
    if not records:
        return []
    scale = np.cos(np.radians(records[0][0])) * _EARTH_RADIUS_M
    places = [_mercator(record, scale) for record in records]
    return [rigid(_turn(record[3:]), place - places[0]) for record, place in zip(records, places, strict=True)]


def _mercator(record: OxtsRecord, scale_m: float) -> Float64[np.ndarray, "3"]:
    latitude, longitude = np.radians(record[:2])
    return np.array([scale_m * longitude, scale_m * np.log(np.tan(np.pi / 4 + latitude / 2)), record[2]])


def _turn(roll_pitch_yaw: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    (cr, cp, cy), (sr, sp, sy) = np.cos(roll_pitch_yaw), np.sin(roll_pitch_yaw)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x
