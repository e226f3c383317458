"""Changes of a camera path, key by key: each returns a new path in the same frame as the given one."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.rotations import normalized, quaternions_from_matrices

from .camera_path import CameraPath

SAME_TIME_S = 0.005
"""Keys as near as this are one key: less than half a frame at 60 frames a second."""


class Keyed(NamedTuple):
    """A path, and the number of the key that was changed: keys that pass one another change their numbers."""

    path: CameraPath
    key: int


def key_at(path: CameraPath, time_s: float) -> int | None:
    """Number of the key at a moment; None where there is none."""
    key = int(np.argmin(np.abs(path.times_s - time_s)))
    return key if abs(path.times_s[key] - time_s) <= SAME_TIME_S else None


def key_camera(path: CameraPath, key: int, width: int, height: int) -> Camera:
    """Camera of a key: exactly the one that was put there."""
    return replace(path, easing="none", loop=False).camera(float(path.times_s[key]), width, height)


def with_key(path: CameraPath | None, time_s: float, camera: Camera) -> Keyed:
    """Put a camera at a moment, in the place of the key that is there already; without a path, begin one."""
    time = np.array([float(time_s)])
    pose = camera.camera_to_world
    fov = np.array([camera.vertical_fov_deg])
    quaternion = quaternions_from_matrices(pose[None, :3, :3])
    if path is None:
        return Keyed(CameraPath(time, pose[None, :3, 3], quaternion, fov, camera.exposure_s), 0)
    key = key_at(path, time_s)
    if key is not None:
        return Keyed(placed_key(path, key, pose[:3, 3], quaternion[0], float(fov[0])), key)
    longer = _with_rows(replace(path, is_timed=True), time, pose[None, :3, 3], quaternion, fov)
    return Keyed(longer, int(np.searchsorted(longer.times_s, time[0])))


def without_key(path: CameraPath, key: int) -> CameraPath | None:
    """Take a key away; None where it was the last one."""
    kept = np.delete(np.arange(len(path.times_s)), key)
    return _of_keys(path, kept, path.times_s[kept]) if len(kept) else None


def moved_key(path: CameraPath, key: int, time_s: float) -> Keyed:
    """Move a key to another moment, past others if need be; where another one is, to the nearest free moment."""
    free = _free_moment(np.delete(path.times_s, key), time_s)
    times = path.times_s.copy()
    times[key] = free
    order = np.argsort(times)
    return Keyed(_of_keys(replace(path, is_timed=True), order, times[order]), int(np.flatnonzero(order == key)[0]))


def copied_key(path: CameraPath, key: int, time_s: float) -> Keyed:
    """Put a copy of a key at another moment; where another key is, at the nearest free moment."""
    free = _free_moment(path.times_s, time_s)
    rows = (path.positions[key : key + 1], path.quaternions_wxyz[key : key + 1], path.vertical_fov_deg[key : key + 1])
    longer = _with_rows(replace(path, is_timed=True), np.array([free]), *rows)
    return Keyed(longer, int(np.searchsorted(longer.times_s, free)))


def placed_key(
    path: CameraPath,
    key: int,
    position: Float64[np.ndarray, "3"] | None = None,
    quaternion_wxyz: Float64[np.ndarray, "4"] | None = None,
    vertical_fov_deg: float | None = None,
) -> CameraPath:
    """Give a key another place, rotation or field of view (degrees); what is None stays."""
    changes: dict[str, Any] = {}
    if position is not None:
        changes["positions"] = _with_row(path.positions, key, position)
    if quaternion_wxyz is not None:
        changes["quaternions_wxyz"] = _with_row(path.quaternions_wxyz, key, normalized(quaternion_wxyz))
    if vertical_fov_deg is not None:
        if not 0 < vertical_fov_deg < 180:
            raise ValueError(f"a field of view of {vertical_fov_deg:g} degrees: must be above 0 and below 180")
        changes["vertical_fov_deg"] = _with_row(path.vertical_fov_deg, key, np.array(vertical_fov_deg))
    return replace(path, **changes)


def stretched(path: CameraPath, factor: float) -> CameraPath:
    """Let the flight take so many times longer; its first key stays at its moment.

    Raises `ValueError` where keys would come too close to one another.
    """
    times = path.times_s[0] + factor * (path.times_s - path.times_s[0])
    if not np.isfinite(factor) or np.any(np.diff(times) <= SAME_TIME_S):
        raise ValueError(f"a path can't take {factor:g} times as long: its keys would fall together")
    return replace(path, times_s=times, is_timed=True)


def shifted(path: CameraPath, seconds: float) -> CameraPath:
    """Let the flight begin so much later."""
    return replace(path, times_s=path.times_s + seconds)


def reversed_path(path: CameraPath) -> CameraPath:
    """Fly the same way backwards, in the same span of time."""
    backwards = np.arange(len(path.times_s))[::-1]
    return _of_keys(path, backwards, path.times_s[0] + path.times_s[-1] - path.times_s[backwards])


def _free_moment(taken: Float64[np.ndarray, " k"], time_s: float) -> float:
    """The moment nearest to the asked one at which no key is."""
    gap = 2 * SAME_TIME_S
    candidates = np.concatenate([[float(time_s)], taken - gap, taken + gap])
    fences = np.concatenate([[-np.inf], taken, [np.inf]])
    after = np.searchsorted(fences[:-1], candidates, side="right")
    free = candidates[np.minimum(candidates - fences[after - 1], fences[after] - candidates) > SAME_TIME_S]
    return float(free[np.argmin(np.abs(free - time_s))])


def _of_keys(path: CameraPath, keys: Int64[np.ndarray, " n"], times_s: Float64[np.ndarray, " n"]) -> CameraPath:
    """Keys by their numbers, in this order, at these moments."""
    return replace(
        path,
        times_s=times_s,
        positions=path.positions[keys],
        quaternions_wxyz=path.quaternions_wxyz[keys],
        vertical_fov_deg=path.vertical_fov_deg[keys],
    )


def _with_rows(
    path: CameraPath,
    times: Float64[np.ndarray, " n"],
    positions: Float64[np.ndarray, "n 3"],
    quaternions: Float64[np.ndarray, "n 4"],
    fov: Float64[np.ndarray, " n"],
) -> CameraPath:
    """Add keys to a path where their moments belong."""
    at = np.searchsorted(path.times_s, times)
    return replace(
        path,
        times_s=np.insert(path.times_s, at, times),
        positions=np.insert(path.positions, at, positions, axis=0),
        quaternions_wxyz=np.insert(path.quaternions_wxyz, at, quaternions, axis=0),
        vertical_fov_deg=np.insert(path.vertical_fov_deg, at, fov),
    )


def _with_row(rows: np.ndarray, row: int, value: np.ndarray) -> np.ndarray:
    changed = rows.copy()
    changed[row] = value
    return changed
