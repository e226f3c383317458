"""Camera paths: keyframes, interpolation of positions, rotations and fields of view, easing, and orbits."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np
import scipy  # loads its submodules on first use: most scenes are opened without a camera path
from jaxtyping import Float64

from ..safe_io.foreign_values import as_array
from .camera import DEFAULT_EXPOSURE_S, Camera
from .easing import Eased, Easing, KeyEasing, apply_easing, apply_key_easings
from .geometry import matrices_from_quaternions, quaternions_from_matrices

_KEYS_OF_A_CIRCLE = 12  # keyframes of a circle; the spline deviates from it by 0.02 % of its radius
_SHORTEST_S, _NARROWEST_DEG, _FARTHEST = 1e-9, 1e-4, 1e12
"""Closer times, narrower views and larger numbers come from damaged files."""

_NOT_UNIT = 1e-3

# Interpolation

Interpolation = Literal["spline", "linear"]
"""spline: smooth through all keyframes; linear: straight between keyframes, at constant speed between two of them."""


@dataclass(frozen=True, slots=True, eq=False)
class _SegmentTurns:
    """Rotations at single times, as a spline or slerp of SciPy gives them to 1e-14, in a tenth of its time."""

    times_s: Float64[np.ndarray, " k"]
    turns: Float64[np.ndarray, "k 3 3"]
    """Rotations of the keyframes, from which each segment goes on."""
    cubics: Float64[np.ndarray, "s 3 3"]
    """Rotation vectors over the part 0..1 of a segment: coefficients of its first, second and third power."""

    @classmethod
    def of(cls, times_s: Float64[np.ndarray, " k"], rotations: Callable[..., Any]) -> "_SegmentTurns | None":
        """Fit the cubics; None if one of them turns by more than half a turn, where rotation vectors jump."""
        lengths, back = np.diff(times_s), rotations(times_s[:-1]).inv()
        third, half, two_thirds, whole = (  # rounded, a start with its length can lie behind the end
            (back * rotations(np.minimum(times_s[:-1] + part * lengths, times_s[1:]))).as_rotvec()
            for part in (1 / 3, 1 / 2, 2 / 3, 1)
        )
        first = 9 * third - 4.5 * two_thirds + whole
        second = -22.5 * third + 18 * two_thirds - 4.5 * whole
        cubics = np.stack([first, second, whole - first - second], axis=1)
        is_cubic = np.allclose(cubics.swapaxes(1, 2) @ [1 / 2, 1 / 4, 1 / 8], half, atol=1e-9)
        return cls(times_s, rotations(times_s).as_matrix(), cubics) if is_cubic else None

    def at(self, time_s: float) -> Float64[np.ndarray, "3 3"]:
        k = min(max(int(self.times_s.searchsorted(time_s, side="right")) - 1, 0), len(self.cubics) - 1)
        part = (time_s - self.times_s[k]) / (self.times_s[k + 1] - self.times_s[k])
        first, second, third = self.cubics[k]
        return self.turns[k] @ cv2.Rodrigues(part * (first + part * (second + part * third)))[0]


@dataclass(frozen=True, slots=True, eq=False)
class PathCurves:
    """Curves through two or more keyframes, valid only from the first to the last one, or to the seam of a loop."""

    positions: Callable[..., Any]
    """Positions at path times; a second argument of 1 gives the derivative."""
    rotations: Callable[..., Any]
    """SciPy's Rotation at path times."""
    segment_turns: _SegmentTurns | None
    fields_of_view: Callable[..., Any]

    def turn(self, time_s: float) -> Float64[np.ndarray, "3 3"]:
        """Rotation at a path time."""
        segments = self.segment_turns
        return self.rotations(time_s).as_matrix() if segments is None else segments.at(time_s)

    @classmethod
    def through(
        cls,
        times_s: Float64[np.ndarray, " k"],
        positions: Float64[np.ndarray, "k 3"],
        quaternions_wxyz: Float64[np.ndarray, "k 4"],
        fields_of_view: Float64[np.ndarray, " k"],
        interpolation: Interpolation = "spline",
        period_s: float | None = None,
    ) -> "PathCurves":
        """Interpolate keyframes; with a period the last one leads back to the first, smoothly if a spline.

        Splines: natural cubic for positions, cubic in rotation vectors for rotations (SciPy's RotationSpline, or slerp
        where that finds none), monotone cubic for the field of view, which therefore stays between the values of its
        two keyframes.
        """
        if period_s is not None:
            n = len(times_s)
            rounds = np.arange(-_KEYS_AROUND_A_LOOP, n + 1 + _KEYS_AROUND_A_LOOP)
            keys = rounds % n
            times_s = times_s[keys] + period_s * (rounds // n)
            positions, quaternions_wxyz, fields_of_view = positions[keys], quaternions_wxyz[keys], fields_of_view[keys]
        splines, turning = scipy.interpolate, scipy.spatial.transform
        rotations = turning.Rotation.from_quat(quaternions_wxyz[:, [1, 2, 3, 0]])
        if interpolation == "linear":
            turns = turning.Slerp(times_s, rotations)
            return cls(
                splines.make_interp_spline(times_s, positions, k=1),
                turns,
                _SegmentTurns.of(times_s, turns),
                splines.make_interp_spline(times_s, fields_of_view, k=1),
            )
        turns = _turning_spline(times_s, rotations) or turning.Slerp(times_s, rotations)
        return cls(
            splines.CubicSpline(times_s, positions, bc_type="natural"),
            turns,
            _SegmentTurns.of(times_s, turns),
            splines.PchipInterpolator(times_s, fields_of_view),
        )


_LARGEST_TURN = 4 * math.pi  # of a key to a moment before the next one


def _turning_spline(times_s: Float64[np.ndarray, " k"], rotations: Any) -> Any:
    """SciPy's RotationSpline; None where its search diverges, as it does for some very uneven keyframes."""
    inside = times_s[:-1, None] + np.diff(times_s)[:, None] * [1 / 4, 1 / 2, 3 / 4]
    try:
        with np.errstate(over="raise", invalid="raise"):
            turns = scipy.spatial.transform.RotationSpline(times_s, rotations)
            largest = np.linalg.norm(turns.interpolator(inside), axis=-1).max()
    except (ArithmeticError, ValueError):
        return None
    return turns if largest < _LARGEST_TURN else None


@dataclass(frozen=True, eq=False)
class CameraPath:
    """Keyframes of a camera path. Camera axes are OpenCV's (x right, y down, z forward); any world frame."""

    times_s: Float64[np.ndarray, " k"]
    """Increasing times of the scene, so that a path always meets the same traffic and the same rain."""
    positions: Float64[np.ndarray, "k 3"]
    quaternions_wxyz: Float64[np.ndarray, "k 4"]
    """Camera to world, unit."""
    vertical_fov_deg: Float64[np.ndarray, " k"]
    exposure_s: float = DEFAULT_EXPOSURE_S
    interpolation: Interpolation = "spline"
    easing: Easing = "none"
    loop: bool = False
    """Return from the last keyframe to the first, in the mean interval of the others, and repeat endlessly."""
    is_timed: bool = True
    """True if the times are known. Keyframes of photos without times get a walking pace (`with_constant_speed`), and a
    still image from such a path is that of a camera at rest.
    """
    key_easings: tuple[KeyEasing | None, ...] = ()
    """Easing from each keyframe to the next one; None, and all of an empty tuple, follow `easing`."""
    plane_m: float = 0.0
    """That of orthographic cameras, see `Camera.plane_m`; 0 for others."""

    def __post_init__(self) -> None:
        for name in ("times_s", "positions", "quaternions_wxyz", "vertical_fov_deg"):
            object.__setattr__(self, name, as_array(getattr(self, name), np.float64, f"CameraPath.{name}"))
        keys = len(self.times_s)
        arrays = (self.times_s, self.positions, self.quaternions_wxyz, self.vertical_fov_deg)
        if [len(array) for array in arrays] != [keys] * 4:
            raise ValueError("a camera path needs a place, a rotation and a field of view for each of its times")
        if not all(np.isfinite(array).all() for array in arrays if array is not self.quaternions_wxyz):
            raise ValueError("a keyframe holds a number that is not finite")
        if not max((np.abs(array).max(initial=0) for array in arrays), default=0) < _FARTHEST:
            raise ValueError(f"a keyframe holds a number above {_FARTHEST:g}")
        if not (np.abs(np.linalg.norm(self.quaternions_wxyz, axis=1) - 1) < _NOT_UNIT).all():
            raise ValueError("a keyframe holds a rotation that is none: its quaternion must be finite and not 0")
        if keys and not (self.vertical_fov_deg.min() > _NARROWEST_DEG and self.vertical_fov_deg.max() < 180):
            raise ValueError("the vertical field of view must be above 0 and below 180 degrees")
        if len(self.key_easings) not in (0, keys):
            raise ValueError(f"a camera path of {keys} keyframes has {len(self.key_easings)} easings")
        if keys == 0 or np.any(np.diff(self.times_s) < _SHORTEST_S):
            raise ValueError("a camera path needs at least one keyframe, with rising times")

    def __repr__(self) -> str:
        times = f"{self.start_s:g} to {self.end_s:g} s"
        return f"<gsrain.CameraPath of {len(self.times_s)} keyframes, {times}>"

    @classmethod
    def through(cls, times_s: Sequence[float], cameras: Sequence[Camera]) -> "CameraPath":
        """Path through cameras at increasing times in seconds; takes the exposure of the first camera.

        Raises ValueError if there is no camera, or if the times differ in number or don't increase.
        """
        if len(times_s) != len(cameras):
            raise ValueError(f"a camera path needs a moment for each camera: {len(times_s)} for {len(cameras)}")
        if not cameras:
            raise ValueError("a camera path needs at least one camera")
        poses = np.stack([camera.camera_to_world for camera in cameras])
        fov = np.array([camera.vertical_fov_deg for camera in cameras])
        quaternions = quaternions_from_matrices(poses[:, :3, :3])
        return cls(np.asarray(times_s, np.float64), poses[:, :3, 3], quaternions, fov, cameras[0].exposure_s)

    @property
    def start_s(self) -> float:
        return float(self.times_s[0])

    @property
    def end_s(self) -> float:
        """Time of the last keyframe; of a loop, time of the return to the first."""
        return float(self._knots_s[-1])

    @property
    def duration_s(self) -> float:
        """Time from the first keyframe to the last, and of a loop back to the first."""
        return float(self._knots_s[-1] - self._knots_s[0])

    def camera(self, time_s: float, width: int, height: int) -> Camera:
        """Camera at a time; it rests before the first keyframe and after the last, unless the path loops."""
        t = float(self._at(np.array([time_s])).times_s[0])
        camera_to_world = np.eye(4)
        if len(self.times_s) < 2:
            camera_to_world[:3, :3] = matrices_from_quaternions(self.quaternions_wxyz[0])
            camera_to_world[:3, 3] = self.positions[0]
            fov = float(self.vertical_fov_deg[0])
        else:
            camera_to_world[:3, :3] = self._curves.turn(t)
            camera_to_world[:3, 3] = self._curves.positions(t)
            fov = float(self._curves.fields_of_view(t))
        camera = Camera.from_fov(width, height, fov, np.linalg.inv(camera_to_world))
        return replace(camera, exposure_s=self.exposure_s, plane_m=self.plane_m)

    def velocity(self, time_s: float) -> Float64[np.ndarray, "3"]:
        """Velocity of the camera in world units per second; zero outside the keyframes."""
        return self.velocities(np.array([float(time_s)]))[0]

    def velocities(self, times_s: Float64[np.ndarray, " t"]) -> Float64[np.ndarray, "t 3"]:
        """Velocities of the camera at many times; see `velocity`."""
        if len(self.times_s) < 2:
            return np.zeros((len(times_s), 3))
        at = self._at(times_s)
        flying = self.loop | ((self.start_s <= times_s) & (times_s <= self.end_s))
        return np.where(flying[:, None], at.rates[:, None] * self._curves.positions(at.times_s, 1), 0.0)

    def places(self, times_s: Float64[np.ndarray, " t"]) -> Float64[np.ndarray, "t 3"]:
        if len(self.times_s) < 2:
            return np.repeat(self.positions, len(times_s), axis=0)
        return self._curves.positions(self._at(times_s).times_s)

    def turns(self, times_s: Float64[np.ndarray, " t"]) -> Float64[np.ndarray, "t 3 3"]:
        """Rotations, camera to world, at many times."""
        if len(self.times_s) < 2:
            return np.repeat(matrices_from_quaternions(self.quaternions_wxyz), len(times_s), axis=0)
        return self._curves.rotations(self._at(times_s).times_s).as_matrix()

    def moved(self, similarity: Float64[np.ndarray, "4 4"]) -> "CameraPath":
        """Return the path in a transformed world (scene units to meters, for example)."""
        turn = similarity[:3, :3] / np.cbrt(np.linalg.det(similarity[:3, :3]))
        return replace(
            self,
            positions=self.positions @ similarity[:3, :3].T + similarity[:3, 3],
            quaternions_wxyz=quaternions_from_matrices(turn @ matrices_from_quaternions(self.quaternions_wxyz)),
            plane_m=self.plane_m * float(np.cbrt(np.linalg.det(similarity[:3, :3]))),
        )

    def _at(self, times_s: Float64[np.ndarray, " t"]) -> Eased:
        """Path times within the path's duration, with easing."""
        knots = self._knots_s
        if self.loop and len(knots) > 1:
            within = knots[0] + np.mod(times_s - knots[0], knots[-1] - knots[0])
        else:
            within = np.clip(times_s, knots[0], knots[-1])
        eased = apply_easing(self.easing, knots, within)
        return eased if not any(self.key_easings) else apply_key_easings(self.key_easings, knots, within, eased)

    @cached_property
    def _knots_s(self) -> Float64[np.ndarray, " k"]:
        """Times of the keyframes; of a loop, also the time of its closure."""
        times = self.times_s
        if not self.loop or len(times) < 2:
            return times
        return np.append(times, times[-1] + (times[-1] - times[0]) / (len(times) - 1))

    @cached_property
    def _curves(self) -> PathCurves:
        keys = self.times_s, self.positions, self.quaternions_wxyz, self.vertical_fov_deg
        return PathCurves.through(*keys, self.interpolation, self.duration_s if self.loop else None)


def orbit_path(
    center: Float64[np.ndarray, "3"], camera: Camera, duration_s: float, sweep_deg: float = 40.0
) -> CameraPath:
    """Swing around a point from one side of the camera's position to the other. World z is up."""
    angles = np.radians(np.linspace(-sweep_deg / 2, sweep_deg / 2, 9))
    return _around(center, camera, angles, np.linspace(0, duration_s, len(angles)))


def circle_path(center: Float64[np.ndarray, "3"], camera: Camera, duration_s: float) -> CameraPath:
    """Circle around a point endlessly, starting at the camera's pose. World z is up."""
    shares = np.arange(_KEYS_OF_A_CIRCLE) / _KEYS_OF_A_CIRCLE
    return replace(_around(center, camera, 2 * np.pi * shares, duration_s * shares), loop=True)


def _around(
    center: Float64[np.ndarray, "3"],
    camera: Camera,
    angles: Float64[np.ndarray, " k"],
    times: Float64[np.ndarray, " k"],
) -> CameraPath:
    """Keyframes of a camera rotated around a point by angles in radians."""
    turns = scipy.spatial.transform.Rotation.from_euler("z", angles[:, None]).as_matrix()
    pose = camera.camera_to_world
    rotations = turns @ pose[:3, :3]
    positions = (turns @ (pose[:3, 3] - center)) + center
    fov = np.full(len(angles), camera.vertical_fov_deg)
    return CameraPath(times, positions, quaternions_from_matrices(rotations), fov, camera.exposure_s)


_KEYS_AROUND_A_LOOP = 24
"""Extra keyframes before and after a loop: the influence of a spline's ends falls by a factor of 2 or more per
keyframe.
"""
