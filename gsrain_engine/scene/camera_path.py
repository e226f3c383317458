"""A camera that moves: keyframes with a spline through positions, one through rotations, and a field of view."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from .camera import DEFAULT_EXPOSURE_S, Camera
from .rotations import matrices_from_quaternions, quaternions_from_matrices


@dataclass(frozen=True, eq=False)
class CameraPath:
    """Keyframes of a flight. Camera axes are OpenCV's (x right, y down, z forward); the world is that of the caller."""

    times_s: Float64[np.ndarray, " k"]
    """Rising."""
    positions: Float64[np.ndarray, "k 3"]
    quaternions_wxyz: Float64[np.ndarray, "k 4"]
    """Camera to world, unit."""
    vertical_fov_deg: Float64[np.ndarray, " k"]
    exposure_s: float = DEFAULT_EXPOSURE_S

    def __post_init__(self) -> None:
        if len(self.times_s) == 0 or np.any(np.diff(self.times_s) <= 0):
            raise ValueError("a camera path needs at least one keyframe, with rising times")

    @property
    def duration_s(self) -> float:
        """Time from the first key to the last."""
        return float(self.times_s[-1] - self.times_s[0])

    def camera(self, time_s: float, width: int, height: int) -> Camera:
        """Camera at a time; before the first key and after the last it stands still."""
        t = self._clamped(time_s)
        camera_to_world = np.eye(4)
        camera_to_world[:3, :3] = self._rotation(t)
        camera_to_world[:3, 3] = self._position(t)
        camera = Camera.from_fov(width, height, self._fov(t), np.linalg.inv(camera_to_world))
        return Camera(*_intrinsics(camera), camera.world_to_camera, self.exposure_s)

    def velocity(self, time_s: float) -> Float64[np.ndarray, "3"]:
        """Velocity of the camera in world units a second; zero outside the keys."""
        if len(self.times_s) < 2 or not self.times_s[0] <= time_s <= self.times_s[-1]:
            return np.zeros(3)
        return self._position_spline(time_s, 1)

    def moved(self, similarity: Float64[np.ndarray, "4 4"]) -> "CameraPath":
        """Return the path in a world that was moved, turned and scaled (scene units to metres, say)."""
        turn = similarity[:3, :3] / np.cbrt(np.linalg.det(similarity[:3, :3]))
        return CameraPath(
            self.times_s,
            self.positions @ similarity[:3, :3].T + similarity[:3, 3],
            quaternions_from_matrices(turn @ matrices_from_quaternions(self.quaternions_wxyz)),
            self.vertical_fov_deg,
            self.exposure_s,
        )

    def _clamped(self, time_s: float) -> float:
        return float(np.clip(time_s, self.times_s[0], self.times_s[-1]))

    def _position(self, t: float) -> Float64[np.ndarray, "3"]:
        return self.positions[0] if len(self.times_s) < 2 else self._position_spline(t)

    def _rotation(self, t: float) -> Float64[np.ndarray, "3 3"]:
        if len(self.times_s) < 2:
            return matrices_from_quaternions(self.quaternions_wxyz[0])
        return self._rotation_spline(t).as_matrix()

    def _fov(self, t: float) -> float:
        return float(self.vertical_fov_deg[0] if len(self.times_s) < 2 else self._fov_spline(t))

    @cached_property
    def _position_spline(self) -> CubicSpline:
        return CubicSpline(self.times_s, self.positions, bc_type="natural")

    @cached_property
    def _rotation_spline(self) -> RotationSpline:
        return RotationSpline(self.times_s, Rotation.from_quat(self.quaternions_wxyz[:, [1, 2, 3, 0]]))

    @cached_property
    def _fov_spline(self) -> PchipInterpolator:
        return PchipInterpolator(self.times_s, self.vertical_fov_deg)


def orbit_path(
    center: Float64[np.ndarray, "3"], camera: Camera, duration_s: float, sweep_deg: float = 40.0
) -> CameraPath:
    """Swing around a point, from one side of a camera's place to the other, looking as it does. World z is up."""
    angles = np.radians(np.linspace(-sweep_deg / 2, sweep_deg / 2, 9))
    turns = Rotation.from_euler("z", angles[:, None]).as_matrix()
    pose = camera.camera_to_world
    rotations = turns @ pose[:3, :3]
    positions = (turns @ (pose[:3, 3] - center)) + center
    times = np.linspace(0, duration_s, len(angles))
    fov = np.full(len(angles), camera.vertical_fov_deg)
    return CameraPath(times, positions, quaternions_from_matrices(rotations), fov, camera.exposure_s)


def _intrinsics(camera: Camera) -> tuple[int, int, float, float, float, float]:
    return camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
