"""Recorded trajectories as camera paths: a few keys that fly the same way, and keys laid onto the nearest place."""

import numpy as np
from jaxtyping import Float64, Int64

from gsrain_engine.scene.rotations import quaternions_from_matrices

from .camera_path import CameraPath
from .edits import placed_key


def every(path: CameraPath, seconds: float) -> CameraPath:
    """Keep one key each so many seconds, and the first and last one."""
    if not seconds > 0:
        raise ValueError(f"a key every {seconds:g} s: must be above 0 s")
    if len(path.times_s) < 2:
        return path
    count = max(1, round((path.times_s[-1] - path.times_s[0]) / seconds))
    wanted = np.linspace(path.times_s[0], path.times_s[-1], count + 1)
    after = np.clip(np.searchsorted(path.times_s, wanted), 1, len(path.times_s) - 1)
    before = after - 1
    nearer = wanted - path.times_s[before] < path.times_s[after] - wanted
    return _of_keys(path, np.unique(np.where(nearer, before, after)))


def simplified(path: CameraPath, tolerance_m: float = 0.05, tolerance_deg: float = 0.5) -> CameraPath:
    """Keep few keys, between which the curves pass all others within a distance (units of the path) and an angle.

    Begins with the first and last key, and adds the one that is farthest off until none is too far. Few, not proven
    to be the fewest. Not for loops.
    """
    times, places, turns = path.times_s, path.positions, path.turns(path.times_s)
    kept = np.unique([0, len(times) - 1])
    while len(kept) < len(times):
        curve = _of_keys(path, kept)
        away = np.linalg.norm(curve.places(times) - places, axis=1) / tolerance_m
        turned = _angles_deg(curve.turns(times), turns) / tolerance_deg
        fov = np.abs(np.interp(times, times[kept], path.vertical_fov_deg[kept]) - path.vertical_fov_deg) / tolerance_deg
        error = np.max([away, turned, fov], axis=0)
        error[kept] = 0.0
        worst = int(np.argmax(error))
        if error[worst] <= 1.0:
            break
        kept = np.sort(np.append(kept, worst))
    return _of_keys(path, kept)


def nearest_moment(path: CameraPath, place: Float64[np.ndarray, "3"]) -> float:
    """When a trajectory comes nearest to a place, on the straight lines between its keys."""
    if len(path.times_s) < 2:
        return path.start_s
    starts, along = path.positions[:-1], np.diff(path.positions, axis=0)
    squares = np.maximum(np.einsum("ki,ki->k", along, along), 1e-30)
    shares = np.clip(np.einsum("ki,ki->k", place - starts, along) / squares, 0, 1)
    distances = np.linalg.norm(starts + shares[:, None] * along - place, axis=1)
    k = int(np.argmin(distances))
    return float(path.times_s[k] + shares[k] * (path.times_s[k + 1] - path.times_s[k]))


def snapped_key(path: CameraPath, key: int, trajectory: CameraPath, *, turn_too: bool = True) -> CameraPath:
    """Lay a key onto the nearest place of a trajectory in the same frame, looking as it looks there if asked."""
    at = trajectory.camera(nearest_moment(trajectory, path.positions[key]), 2, 2)
    quaternion = quaternions_from_matrices(at.camera_to_world[:3, :3]) if turn_too else None
    return placed_key(path, key, at.position, quaternion)


def _angles_deg(left: Float64[np.ndarray, "t 3 3"], right: Float64[np.ndarray, "t 3 3"]) -> Float64[np.ndarray, " t"]:
    traces = np.einsum("tij,tij->t", left, right)
    return np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))


def _of_keys(path: CameraPath, keys: Int64[np.ndarray, " n"]) -> CameraPath:
    return CameraPath(
        path.times_s[keys],
        path.positions[keys],
        path.quaternions_wxyz[keys],
        path.vertical_fov_deg[keys],
        path.exposure_s,
    )
