"""Pane of glass in front of a camera: a windshield that leans back, or the flat front of a lens."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Float64

from ..scene.camera import Camera

GlassKind = Literal["windshield", "lens"]
DISTANCES_M: dict[GlassKind, float] = {"windshield": 0.12, "lens": 0.02}
"""Distance from the center of projection to the glass along its axis."""

WINDSHIELD_SLOPE_DEG = 35.0
"""Angle between windshield and horizontal: passenger cars have 25 to 40 degrees."""

_WINDSHIELD_M = ((-0.7, -0.75), (0.7, 0.15))
"""Corners of the windshield in pane coordinates: the camera is high and in the middle, as behind the mirror."""

_LENS_SPANS = 4.0  # half the largest side of a lens's front, in distances
_SNAP_M, _MARGIN_M = 0.005, 0.005
_FORWARD_DEG = 60.0
_EDGE_RAYS = 17


@dataclass(frozen=True, eq=False)
class Pane:
    """Rectangle of glass in camera coordinates (x right, y down, z forward), in meters."""

    kind: GlassKind
    origin_m: Float64[np.ndarray, "3"]
    """Point with the pane coordinates (0, 0)."""
    right: Float64[np.ndarray, "3"]
    """First axis of the pane's coordinates."""
    up: Float64[np.ndarray, "3"]
    """Second axis."""
    normal: Float64[np.ndarray, "3"]
    """Outward, away from the camera."""
    low_m: tuple[float, float]
    high_m: tuple[float, float]
    """Corners, in pane coordinates."""

    @property
    def size_m(self) -> tuple[float, float]:
        return self.high_m[0] - self.low_m[0], self.high_m[1] - self.low_m[1]

    @property
    def center_m(self) -> Float64[np.ndarray, "3"]:
        """Middle of the rectangle."""
        u, v = ((low + high) / 2 for low, high in zip(self.low_m, self.high_m, strict=True))
        return self.origin_m + u * self.right + v * self.up

    @property
    def area_m2(self) -> float:
        return self.size_m[0] * self.size_m[1]

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Value that is the same for equal panes."""
        axes = np.stack([self.origin_m, self.right, self.up, self.normal])
        return self.kind, axes.tobytes(), self.low_m, self.high_m


def is_behind_glass(kind: GlassKind, camera_to_vehicle: Float64[np.ndarray, "3 3"]) -> bool:
    """Return whether a camera of a vehicle has this glass in front of it.

    Windshields are in front of cameras within 60 degrees of the vehicle's heading (x), lenses have glass everywhere.
    """
    forward = camera_to_vehicle[:, 2]
    return kind == "lens" or float(forward[0]) > math.cos(math.radians(_FORWARD_DEG))


def pane_of(
    kind: GlassKind,
    camera: Camera,
    distance_m: float | None = None,
    camera_to_vehicle: Float64[np.ndarray, "3 3"] | None = None,
) -> Pane | None:
    """Part of a pane that is in a camera's view; None if the camera has none in front of it.

    `camera_to_vehicle` turns camera axes to the vehicle's (x forward, y left, z up); None is a camera along its
    heading. The view's footprint on the glass is extended to multiples of 5 mm, so that it is the same for all frames.
    Equal cameras have the same object.
    """
    turn = None if camera_to_vehicle is None else camera_to_vehicle.astype(np.float64).tobytes()
    return _pane_of(kind, camera.rounded_intrinsics, (camera.width, camera.height), distance_m, turn)


@lru_cache(maxsize=64)
def _pane_of(
    kind: GlassKind,
    intrinsics: tuple[float, float, float, float],
    size_px: tuple[int, int],
    distance_m: float | None,
    camera_to_vehicle: bytes | None,
) -> Pane | None:
    distance = DISTANCES_M[kind] if distance_m is None else distance_m
    turn = _LOOKS_AHEAD if camera_to_vehicle is None else np.frombuffer(camera_to_vehicle).reshape(3, 3)
    if not is_behind_glass(kind, turn):
        return None
    if kind == "lens":
        right, up, normal = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
        origin, reach = distance * normal, _LENS_SPANS * distance
        low, high = np.array([-reach, -reach]), np.array([reach, reach])
    else:
        slope = np.radians(WINDSHIELD_SLOPE_DEG)
        ahead, left, above = turn
        right = -left
        normal = np.sin(slope) * ahead + np.cos(slope) * above
        up = -np.cos(slope) * ahead + np.sin(slope) * above
        origin = distance * ahead
        low, high = (np.array(each) for each in _WINDSHIELD_M)
    share = np.linspace(0, 1, _EDGE_RAYS)
    edges = [(share, 0 * share), (share, 0 * share + 1), (0 * share, share), (0 * share + 1, share)]
    (fx, fy, cx, cy), (width, height) = intrinsics, size_px
    x = (np.concatenate([each[0] for each in edges]) * width - cx) / fx
    y = (np.concatenate([each[1] for each in edges]) * height - cy) / fy
    rays = np.stack([x, y, np.ones_like(x)], axis=1)
    along = rays @ normal
    reaches = float(origin @ normal) / np.maximum(along, 1e-6)
    points = rays * reaches[:, None] - origin
    places = np.clip(np.stack([points @ right, points @ up], axis=1), low, high)
    first = np.maximum(np.floor((places.min(axis=0) - _MARGIN_M) / _SNAP_M + 1e-6) * _SNAP_M, low)
    last = np.minimum(np.ceil((places.max(axis=0) + _MARGIN_M) / _SNAP_M - 1e-6) * _SNAP_M, high)
    if np.any(last - first < _SNAP_M):
        return None
    corners = (float(first[0]), float(first[1])), (float(last[0]), float(last[1]))
    return Pane(kind, origin, right, up, normal, *corners)


_LOOKS_AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera axes to vehicle axes for a camera that looks straight ahead."""
