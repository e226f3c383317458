"""The streak physics in plain NumPy, float64: `streak_gaussians` must make the same."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.streaks import (
    AXIS_RATIO_OFFSET,
    AXIS_RATIO_SLOPE,
    MAX_STRETCH,
    ShutterModel,
    visible_distance_m,
)


class StreakGaussians(NamedTuple):
    """Streak Gaussians in the world, without color."""

    means: Float32[np.ndarray, "n 3"]
    scales: Float32[np.ndarray, "n 3"]
    quaternions: Float32[np.ndarray, "n 4"]
    opacities: Float32[np.ndarray, " n"]


def axis_ratio(diameter_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Height over width of a falling drop; drops up to 1 mm are spheres (paper, eq. 4)."""
    return np.where(diameter_mm > 1, AXIS_RATIO_SLOPE * diameter_mm + AXIS_RATIO_OFFSET, 1.0)


def make_streaks(
    positions_m: Float64[np.ndarray, "m 3"],
    diameters_mm: Float64[np.ndarray, " m"],
    velocities_m_s: Float64[np.ndarray, "m 3"],
    shutter: ShutterModel,
    rain: RainSettings,
) -> StreakGaussians:
    """Turn drops into one to n_max Gaussians each, as the docstring of `streak_gaussians` describes."""
    diameters_m = diameters_mm * 1e-3
    seen = velocities_m_s if rain.is_paper else velocities_m_s - shutter.velocity_m_s
    later, stretch = _exposed_later(positions_m, seen, shutter)
    positions_m = positions_m + later[:, None] * seen
    to_drop = positions_m - shutter.camera.position
    depth = to_drop @ shutter.camera.world_to_camera[2, :3]
    sight = to_drop / np.maximum(np.linalg.norm(to_drop, axis=1, keepdims=True), 1e-9)
    across = np.linalg.norm(seen - np.sum(seen * sight, axis=1, keepdims=True) * sight, axis=1)

    speed = np.linalg.norm(seen, axis=1)
    smearing = speed if rain.is_paper else across
    alpha = np.minimum(1, diameters_m / np.maximum(smearing * shutter.exposure_s, 1e-12))
    limit = visible_distance_m(diameters_mm, shutter.focal_px)
    alpha = alpha * np.minimum(1, limit / np.maximum(depth, 1e-9))
    alpha = np.where(depth > rain.critical_haze_coefficient * limit, rain.haze_opacity, alpha)
    alpha = np.minimum(1, rain.streak_gain * alpha)

    length = speed * shutter.exposure_s * stretch
    copies = np.clip(np.rint(length / (axis_ratio(diameters_mm) * diameters_m)), 1, rain.max_copies).astype(np.int64)
    # Copies overlap: their opacities would add up to sqrt(2 pi) alpha. This is exact on the streak's axis; beside it,
    # where alpha is large, they add up to more than they should: a smaller width keeps the integral.
    opacity = 1 - (1 - alpha) ** (1 / np.sqrt(2 * np.pi))
    narrowing = alpha / np.maximum(np.sqrt(2 * np.pi) * opacity, 1e-30)
    across_sigma = np.sqrt(np.pi / 32) * np.maximum(diameters_m, depth / shutter.focal_px) * narrowing
    along_sigma = np.maximum(length / copies, across_sigma)

    blur = shutter.lens.circle_of_confusion_m(depth) / 4
    sine = across / np.maximum(speed, 1e-9)
    seen_sigma = np.hypot(along_sigma * sine, across_sigma * np.sqrt(np.maximum(1 - sine**2, 0)))  # foreshortened
    opacity = opacity * across_sigma / np.hypot(across_sigma, blur) * seen_sigma / np.hypot(seen_sigma, blur)
    across_sigma, along_sigma = np.hypot(across_sigma, blur), np.hypot(along_sigma, blur)

    owner = np.repeat(np.arange(len(copies)), copies)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(copies) - copies, copies)
    place = number - (copies[owner] - 1) / 2  # in spacings from the middle
    direction = seen / np.maximum(speed, 1e-9)[:, None]
    offset = place * (length / copies)[owner]
    return StreakGaussians(
        means=(positions_m[owner] + offset[:, None] * direction[owner]).astype(np.float32),
        scales=np.stack([across_sigma, across_sigma, along_sigma], axis=1)[owner].astype(np.float32),
        quaternions=_turn_z_to(direction)[owner].astype(np.float32),
        opacities=opacity[owner].astype(np.float32),
    )


def _exposed_later(
    positions_m: Float64[np.ndarray, "m 3"], seen: Float64[np.ndarray, "m 3"], shutter: ShutterModel
) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Times by which a rolling shutter exposes drops later, in s, and factors of their streaks' lengths."""
    camera, scan = shutter.camera, shutter.readout
    x, y, z = ((positions_m - camera.position) @ camera.world_to_camera[:3, :3].T).T
    vx, vy, vz = (seen @ camera.world_to_camera[:3, :3].T).T
    phase = scan.right * x / z + scan.down * y / z + scan.offset
    per_s = scan.right * (vx * z - x * vz) / z**2 + scan.down * (vy * z - y * vz) / z**2
    stretch = 1 / np.maximum(1 - scan.time_s * per_s, 1 / MAX_STRETCH)
    later = np.clip(scan.time_s * phase * stretch, -scan.time_s, scan.time_s)
    is_ahead = z > 0
    return np.where(is_ahead, later, 0.0), np.where(is_ahead, stretch, 1.0)


def _turn_z_to(direction: Float64[np.ndarray, "m 3"]) -> Float64[np.ndarray, "m 4"]:
    """Unit quaternions of the shortest turns that take +z to unit vectors."""
    # Half-way quaternion (1 + cos, z x direction); the sign of a streak's axis is free, so never turn by over 90 deg.
    d = np.where(direction[:, 2:] < 0, -direction, direction)
    quaternion = np.stack([1 + d[:, 2], -d[:, 1], d[:, 0], np.zeros(len(d))], axis=1)
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
