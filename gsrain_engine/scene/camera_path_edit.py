"""Edits of camera paths: keyframes, timing, view angles, speed, and simplification of recorded trajectories.

Edits return a new path in the same frame as the given one.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from .camera import Camera
from .camera_path import CameraPath
from .easing import MIRRORED, KeyEasing
from .geometry import normalized, quaternions_from_matrices

SAME_TIME_S = 0.005
"""Keyframes as near as this are one: less than half a frame at 60 frames per second."""


class EditedKeyframe(NamedTuple):
    """A path and the index of its changed keyframe, which changes when keyframes pass one another."""

    path: CameraPath
    key: int


def keyframe_at(path: CameraPath, time_s: float) -> int | None:
    """Index of the keyframe at a time; None if there is none."""
    key = int(np.argmin(np.abs(path.times_s - time_s)))
    return key if abs(path.times_s[key] - time_s) <= SAME_TIME_S else None


def keyframe_camera(path: CameraPath, key: int, width: int, height: int) -> Camera:
    """Camera of a keyframe, exactly as it was set."""
    return replace(path, easing="none", loop=False, key_easings=()).camera(float(path.times_s[key]), width, height)


def with_keyframe(path: CameraPath | None, time_s: float, camera: Camera) -> EditedKeyframe:
    """Set a keyframe at a time, replacing one that is there; creates a path if there is none."""
    time = np.array([float(time_s)])
    pose = camera.camera_to_world
    fov = np.array([camera.vertical_fov_deg])
    quaternion = quaternions_from_matrices(pose[None, :3, :3])
    if path is None:
        return EditedKeyframe(CameraPath(time, pose[None, :3, 3], quaternion, fov, camera.exposure_s), 0)
    key = keyframe_at(path, time_s)
    if key is not None:
        return EditedKeyframe(place_keyframe_at(path, key, pose[:3, 3], quaternion[0], float(fov[0])), key)
    return _with_row_at(path, float(time_s), pose[None, :3, 3], quaternion, fov)


def without_keyframe(path: CameraPath, key: int) -> CameraPath | None:
    """Remove a keyframe; None if it was the last one."""
    others = np.delete(np.arange(len(path.times_s)), key)
    return _of_keys(path, others, path.times_s[others]) if len(others) else None


def move_keyframe(path: CameraPath, key: int, time_s: float) -> EditedKeyframe:
    """Move a keyframe to another time, past others if necessary; uses the nearest free time if that is occupied."""
    free = _free_moment(np.delete(path.times_s, key), time_s)
    times = path.times_s.copy()
    times[key] = free
    order = np.argsort(times)
    moved = _of_keys(replace(path, is_timed=True), order, times[order])
    return EditedKeyframe(moved, int(np.flatnonzero(order == key)[0]))


def copy_keyframe_to(path: CameraPath, key: int, time_s: float) -> EditedKeyframe:
    """Copy a keyframe to another time, or to the nearest free one if that is occupied."""
    free = _free_moment(path.times_s, time_s)
    row = (getattr(path, name)[key : key + 1] for name in _COLUMNS)
    return _with_row_at(path, free, *row, easing=path.key_easings[key] if path.key_easings else None)


def set_key_easing(path: CameraPath, key: int, easing: KeyEasing | None) -> CameraPath:
    """Set the easing from a keyframe to the next one; None follows the path's."""
    easings = list(path.key_easings or [None] * len(path.times_s))
    easings[key] = easing
    return replace(path, key_easings=tuple(easings) if any(easings) else ())


def place_keyframe_at(
    path: CameraPath,
    key: int,
    position: Float64[np.ndarray, "3"] | None = None,
    quaternion_wxyz: Float64[np.ndarray, "4"] | None = None,
    vertical_fov_deg: float | None = None,
) -> CameraPath:
    """Change a keyframe's position, rotation or field of view (degrees); None keeps a value."""
    if vertical_fov_deg is not None and not 0 < vertical_fov_deg < 180:
        raise ValueError(f"a field of view of {vertical_fov_deg:g} degrees: must be above 0 and below 180")
    quaternion = None if quaternion_wxyz is None else normalized(quaternion_wxyz)
    changes: dict[str, Any] = {}
    for name, value in zip(_COLUMNS, (position, quaternion, vertical_fov_deg), strict=True):
        if value is not None:
            changes[name] = getattr(path, name).copy()
            changes[name][key] = value
    return replace(path, **changes)


def stretch_path_time(path: CameraPath, factor: float) -> CameraPath:
    """Multiply the duration by a factor; the first keyframe keeps its time.

    Raises `ValueError` if keyframes would come too close to one another.
    """
    times = path.times_s[0] + factor * (path.times_s - path.times_s[0])
    if not np.isfinite(factor) or np.any(np.diff(times) <= SAME_TIME_S):
        raise ValueError(f"a path can't take {factor:g} times as long: its keys would fall together")
    return replace(path, times_s=times, is_timed=True)


def shift_path_time(path: CameraPath, seconds: float) -> CameraPath:
    return replace(path, times_s=path.times_s + seconds)


def reverse_path_time(path: CameraPath) -> CameraPath:
    """Reverse the direction of the camera path."""
    backwards = np.arange(len(path.times_s))[::-1]
    reversed_path = _of_keys(path, backwards, path.times_s[0] + path.times_s[-1] - path.times_s[backwards])
    if not path.key_easings:
        return reversed_path
    *stretches, closing = path.key_easings  # each belongs to the stretch after its keyframe
    mirrored = tuple(MIRRORED[each] for each in (*stretches[::-1], closing))
    return replace(reversed_path, key_easings=mirrored)


def _free_moment(taken: Float64[np.ndarray, " k"], time_s: float) -> float:
    """Free time nearest to the requested one; none before 0 s unless it is requested."""
    gap = 2 * SAME_TIME_S
    candidates = np.concatenate([[float(time_s)], taken - gap, taken + gap])
    fences = np.concatenate([[-np.inf], taken, [np.inf]])
    after = np.searchsorted(fences[:-1], candidates, side="right")
    is_free = np.minimum(candidates - fences[after - 1], fences[after] - candidates) > SAME_TIME_S
    free = candidates[is_free & (candidates >= min(time_s, 0.0))]
    return float(free[np.argmin(np.abs(free - time_s))])


def _of_keys(path: CameraPath, keys: Int64[np.ndarray, " n"], times_s: Float64[np.ndarray, " n"]) -> CameraPath:
    """Path of the keyframes with these indices, in this order, at these times."""
    easings = tuple(path.key_easings[key] for key in keys) if path.key_easings else ()
    columns = {name: getattr(path, name)[keys] for name in _COLUMNS}
    return replace(path, times_s=times_s, key_easings=easings, **columns)


def _with_row_at(
    path: CameraPath, time_s: float, *row: Float64[np.ndarray, "1 ..."], easing: KeyEasing | None = None
) -> EditedKeyframe:
    """Insert a keyframe with these values of `_COLUMNS` at a free time."""
    at = int(np.searchsorted(path.times_s, time_s))
    columns = zip(_COLUMNS, row, strict=True)
    inserted = {name: np.insert(getattr(path, name), at, values, axis=0) for name, values in columns}
    easings = list(path.key_easings or [None] * len(path.times_s))
    easings.insert(at, easing)
    times = np.insert(path.times_s, at, time_s)
    own = tuple(easings) if any(easings) else ()
    return EditedKeyframe(replace(path, times_s=times, is_timed=True, key_easings=own, **inserted), at)


_COLUMNS = ("positions", "quaternions_wxyz", "vertical_fov_deg")


# View angles

_VIDEO_HEIGHT_MM = 24.0  # image height of 35 mm film, the reference of focal lengths
_STRAIGHT_UP = 1 - 1e-12


class ViewAngles(NamedTuple):
    """Direction of view in a world with z up; degrees."""

    heading_deg: float
    """From +x to +y; -180..180."""
    pitch_deg: float
    """Upwards; -90..90."""
    roll_deg: float
    """Lean to the camera's right: positive rotates the image content to the left; -180..180."""


def view_angles(camera_to_world: Float64[np.ndarray, "3 3"]) -> ViewAngles:
    """Angles of a rotation (OpenCV axes). A camera that looks straight up or down has heading only, no roll."""
    right, down, forward = camera_to_world.T
    pitch = np.arcsin(np.clip(forward[2], -1, 1))
    if abs(forward[2]) > _STRAIGHT_UP:
        return _in_degrees(np.arctan2(right[0], -right[1]), pitch, 0.0)
    heading = np.arctan2(forward[1], forward[0])
    level = np.array([np.sin(heading), -np.cos(heading), 0.0])
    roll = np.arctan2(-level @ down, level @ right)
    return _in_degrees(heading, pitch, roll)


def view_rotation(angles: ViewAngles) -> Float64[np.ndarray, "3 3"]:
    """Rotation, camera to world (OpenCV axes), of these angles."""
    heading, pitch, roll = np.radians(angles)
    forward = np.array([np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), np.sin(pitch)])
    level = np.array([np.sin(heading), -np.cos(heading), 0.0])
    below = np.cross(forward, level)
    right = np.cos(roll) * level + np.sin(roll) * below
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def focal_length_mm(vertical_fov_deg: float) -> float:
    """Focal length with this vertical field of view on 35 mm film (image height 24 mm)."""
    return float(_VIDEO_HEIGHT_MM / 2 / np.tan(np.radians(vertical_fov_deg) / 2))


def fov_of_focal_length(focal_mm: float) -> float:
    """Vertical field of view in degrees of a lens on 35 mm film."""
    return float(np.degrees(2 * np.arctan(_VIDEO_HEIGHT_MM / 2 / focal_mm)))


def _in_degrees(heading: float, pitch: float, roll: float) -> ViewAngles:
    """Angles in degrees, without rounding errors, which would be displayed as -0.0."""
    return ViewAngles(*(np.degrees([heading, pitch, roll]).round(9) + 0.0).tolist())


# Speed
# World frame, meters.

FASTEST_KM_H = 250.0
"""Above any road's speed limit."""

FASTEST_TURN_DEG_S = 180.0
"""Half a turn per second: motion blur hides everything."""

_SAMPLES_A_SECOND, _FEWEST, _SAMPLE_LIMITS = 30, 64, 4000


@dataclass(frozen=True, slots=True, eq=False)
class PathSpeed:
    """A path's speed over time."""

    times_s: Float64[np.ndarray, " t"]
    speeds_m_s: Float64[np.ndarray, " t"]
    turns_deg_s: Float64[np.ndarray, " t"]
    """Angular speed of the camera."""
    length_m: float

    @classmethod
    def of(cls, path: CameraPath) -> "PathSpeed":
        """Sample a path, in the world, about thirty times per second."""
        count = int(np.clip(_SAMPLES_A_SECOND * path.duration_s, _FEWEST, _SAMPLE_LIMITS))
        times = np.linspace(path.start_s, path.end_s, count) if path.duration_s > 0 else np.array([path.start_s])
        inside = np.minimum(times, np.nextafter(path.end_s, -np.inf)) if path.loop else times
        speeds = np.linalg.norm(path.velocities(inside), axis=1)
        length = float(np.linalg.norm(np.diff(path.places(inside), axis=0), axis=1).sum())
        return cls(times, speeds, _turn_rates(path, inside), length)

    @property
    def fastest_km_h(self) -> float:
        return float(3.6 * self.speeds_m_s.max())

    @property
    def mean_km_h(self) -> float:
        """Length over time; 0 for a path without duration."""
        span = float(self.times_s[-1] - self.times_s[0])
        return 3.6 * self.length_m / span if span > 0 else 0.0

    @property
    def implausible(self) -> Bool[np.ndarray, " t"]:
        """Samples at which the camera is faster than any road vehicle, or turns too fast for a usable image."""
        return (3.6 * self.speeds_m_s > FASTEST_KM_H) | (self.turns_deg_s > FASTEST_TURN_DEG_S)

    @property
    def implausible_spans(self) -> list[tuple[float, float]]:
        edges = np.diff(np.concatenate([[False], self.implausible, [False]]).astype(np.int8))
        starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
        return [(float(self.times_s[a]), float(self.times_s[b])) for a, b in zip(starts, ends, strict=True)]

    @property
    def warning(self) -> str | None:
        """Description of implausible speeds in one sentence; None if there are none."""
        if self.fastest_km_h > FASTEST_KM_H:
            return f"The camera reaches {self.fastest_km_h:,.0f} km/h: no road vehicle does."
        if self.turns_deg_s.max() > FASTEST_TURN_DEG_S:
            return f"The camera turns by up to {self.turns_deg_s.max():.0f} degrees a second: the image only smears."
        return None


def _turn_rates(path: CameraPath, times: Float64[np.ndarray, " t"]) -> Float64[np.ndarray, " t"]:
    if len(times) < 2:
        return np.zeros(len(times))
    turns = path.turns(times)
    angles = _angles_deg(turns[:-1], turns[1:])
    # arccos is imprecise near 1: smaller angles are rounding errors.
    angles[angles < 1e-5] = 0.0
    rates = angles / np.diff(times)
    return np.append(rates, rates[-1])


# Recorded trajectories


def resample(path: CameraPath, seconds: float) -> CameraPath:
    """Keep one keyframe every `seconds`, and the first and last one."""
    if not seconds > 0:
        raise ValueError(f"a key every {seconds:g} s: must be above 0 s")
    if len(path.times_s) < 2:
        return path
    count = max(1, round((path.times_s[-1] - path.times_s[0]) / seconds))
    times = np.linspace(path.times_s[0], path.times_s[-1], count + 1)
    after = np.clip(np.searchsorted(path.times_s, times), 1, len(path.times_s) - 1)
    before = after - 1
    nearer = times - path.times_s[before] < path.times_s[after] - times
    return _trajectory_of_keys(path, np.unique(np.where(nearer, before, after)))


def simplify(path: CameraPath, tolerance_m: float = 0.05, tolerance_deg: float = 0.5) -> CameraPath:
    """Keep few keyframes, so that all others are within a distance (units of the path) and an angle of the curves.

    Starts with the first and last keyframe, and adds the farthest one until all are within tolerance. The number is
    small, not provably minimal. Not for loops.
    """
    times, places, turns = path.times_s, path.positions, path.turns(path.times_s)
    kept = np.unique([0, len(times) - 1])
    while len(kept) < len(times):
        curve = _trajectory_of_keys(path, kept)
        away = np.linalg.norm(curve.places(times) - places, axis=1) / tolerance_m
        turned = _angles_deg(curve.turns(times), turns) / tolerance_deg
        fov = np.abs(np.interp(times, times[kept], path.vertical_fov_deg[kept]) - path.vertical_fov_deg) / tolerance_deg
        error = np.max([away, turned, fov], axis=0)
        error[kept] = 0.0
        worst = int(np.argmax(error))
        if error[worst] <= 1.0:
            break
        kept = np.sort(np.append(kept, worst))
    return _trajectory_of_keys(path, kept)


def nearest_time(path: CameraPath, place: Float64[np.ndarray, "3"]) -> float:
    """Time at which a trajectory is nearest to a position, along straight lines between its keyframes."""
    if len(path.times_s) < 2:
        return path.start_s
    starts, along = path.positions[:-1], np.diff(path.positions, axis=0)
    squares = np.maximum(np.einsum("ki,ki->k", along, along), 1e-30)
    shares = np.clip(np.einsum("ki,ki->k", place - starts, along) / squares, 0, 1)
    distances = np.linalg.norm(starts + shares[:, None] * along - place, axis=1)
    k = int(np.argmin(distances))
    return float(path.times_s[k] + shares[k] * (path.times_s[k + 1] - path.times_s[k]))


def snap_key_to(path: CameraPath, key: int, trajectory: CameraPath, *, turn_too: bool = True) -> CameraPath:
    """Move a keyframe to the nearest position on a trajectory in the same frame, with its rotation if `turn_too`."""
    at = trajectory.camera(nearest_time(trajectory, path.positions[key]), 2, 2)
    quaternion = quaternions_from_matrices(at.camera_to_world[:3, :3]) if turn_too else None
    return place_keyframe_at(path, key, at.position, quaternion)


def _angles_deg(left: Float64[np.ndarray, "t 3 3"], right: Float64[np.ndarray, "t 3 3"]) -> Float64[np.ndarray, " t"]:
    traces = np.einsum("tij,tij->t", left, right)
    return np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))


def _trajectory_of_keys(path: CameraPath, keys: Int64[np.ndarray, " n"]) -> CameraPath:
    return CameraPath(path.times_s[keys], *(getattr(path, name)[keys] for name in _COLUMNS), exposure_s=path.exposure_s)


# Paths without times

WALKING_M_S = 1.4
"""Default speed in m/s: a person's comfortable walk (Bohannon 1997, Age and Ageing 26: 1.3 to 1.5 m/s)."""

_SHORTEST_S = 0.02
_TURN_DEG_S = 90.0  # rotation speed between photos from one position


def with_constant_speed(path: CameraPath, speed: float, *, is_timed: bool = False) -> CameraPath:
    """Retime the keyframes to a constant speed, in the path's own unit per second.

    The first keyframe keeps its time. `is_timed` is true if the user chose the speed. Raises ValueError for a speed
    that is not above 0.
    """
    if not 0 < speed < np.inf:
        raise ValueError(f"a speed of {speed:g}: must be above 0")
    if len(path.times_s) < 2:
        return replace(path, is_timed=is_timed)
    steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1) / speed
    alike = np.abs(np.einsum("ki,ki->k", path.quaternions_wxyz[:-1], path.quaternions_wxyz[1:]))
    turning = np.degrees(2 * np.arccos(np.clip(alike, 0, 1))) / _TURN_DEG_S
    steps = np.where(steps < _SHORTEST_S, np.maximum(turning, _SHORTEST_S), steps)
    times = path.times_s[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return replace(path, times_s=times, is_timed=is_timed)
