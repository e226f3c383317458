"""Rolling shutter of a camera: each row, or column, of a picture is exposed at a time and from a pose of its own."""

from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

ReadoutDirection = Literal["down", "up", "right", "left"]


@runtime_checkable
class CameraIntrinsics(Protocol):
    """Size, focal lengths and principal point of a camera in px."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...


class Readout(NamedTuple):
    """Rolling shutter: a place in the picture is exposed around t + time_s (right x + down y + offset).

    x and y are over the focal length from the principal point: slopes x/z and y/z without a lens.
    """

    time_s: float = 0.0
    """From the first row to the last; 0 is a global shutter."""
    right: float = 0.0
    down: float = 0.0
    offset: float = 0.0


GLOBAL_SHUTTER = Readout()


def readout_of(camera: CameraIntrinsics, time_s: float, direction: ReadoutDirection) -> Readout:
    """Rolling shutter in coordinates of a camera; the middle of the picture is exposed at the frame's time."""
    sign = -1.0 if direction in ("up", "left") else 1.0
    if direction in ("down", "up"):
        return Readout(time_s, 0.0, sign * camera.fy / camera.height, sign * (camera.cy / camera.height - 0.5))
    return Readout(time_s, sign * camera.fx / camera.width, 0.0, sign * (camera.cx / camera.width - 0.5))


@dataclass(frozen=True, slots=True)
class RollingShutter:
    """Readout of a picture, and the motion of its camera meanwhile, in the camera's own frame in the middle of it.

    At a part s of the readout, -1/2 at its first row and 1/2 at its last, the camera is `shift_m` * s from its place in
    the middle, and turned by `turn_rad` * s.
    """

    readout_s: float
    """Time from the first row to the last."""
    direction: ReadoutDirection = "down"
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector."""

    def __post_init__(self) -> None:
        if self.direction not in ("down", "up", "right", "left"):
            raise ValueError(f"direction of a readout must be down, up, right or left, not {self.direction!r}")
        if not 0 <= self.readout_s <= 10:
            raise ValueError(f"readout_s must be 0 to 10 s, not {self.readout_s:g}")
        if not all(abs(value) < 1e6 for value in self.shift_m) or not np.linalg.norm(self.turn_rad) < np.pi:
            raise ValueError("shift_m and turn_rad of a readout must be three finite numbers, turns less than pi")

    @classmethod
    def between(
        cls,
        start: Float64[np.ndarray, "4 4"],
        end: Float64[np.ndarray, "4 4"],
        readout_s: float,
        direction: ReadoutDirection = "down",
    ) -> "tuple[Float64[np.ndarray, '4 4'], RollingShutter]":
        """Pose in the middle, camera to world, and the shutter, of the poses at the first and at the last row."""
        turn = _rotation_vector(start[:3, :3].T @ end[:3, :3])
        middle = np.eye(4)
        middle[:3, :3] = start[:3, :3] @ rotation_of(0.5 * turn)
        middle[:3, 3] = 0.5 * (start[:3, 3] + end[:3, 3])
        shift = middle[:3, :3].T @ (end[:3, 3] - start[:3, 3])
        x, y, z = shift.tolist()
        return middle, cls(readout_s, direction, (x, y, z), tuple(turn.tolist()))

    @property
    def velocity_m_s(self) -> Float64[np.ndarray, "3"]:
        """Velocity in the camera's frame."""
        return np.array(self.shift_m) / self.readout_s if self.readout_s > 0 else np.zeros(3)

    def from_middle(self, part: float) -> Float64[np.ndarray, "4 4"]:
        """Transform from the camera's frame in the middle of the readout to that at a part of it, -1/2 to 1/2."""
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_of(-part * np.array(self.turn_rad))
        matrix[:3, 3] = -matrix[:3, :3] @ (part * np.array(self.shift_m))
        return matrix

    def turned_rays(self, rays: Float64[np.ndarray, "h w 3"]) -> Float64[np.ndarray, "h w 3"]:
        """Directions of all pixels in the camera's frame in the middle of the readout."""
        is_vertical = self.direction in ("down", "up")
        count = rays.shape[0 if is_vertical else 1]
        parts = (np.arange(count) + 0.5) / count - 0.5
        parts = -parts if self.direction in ("up", "left") else parts
        turns = np.stack([rotation_of(part * np.array(self.turn_rad)) for part in parts])
        return np.einsum("hij,hwj->hwi" if is_vertical else "wij,hwj->hwi", turns, rays)


def rotation_of(vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Rotation of a rotation vector (Rodrigues)."""
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = float(np.linalg.norm(vector))
    if angle < 1e-8:
        return np.eye(3) + cross
    return np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross


def _rotation_vector(turn: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3"]:
    """Rotation vector of a rotation of less than half a turn."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    sine, cosine = float(np.linalg.norm(axis)), (float(np.trace(turn)) - 1) / 2
    return axis if sine < 1e-9 else axis * (np.arctan2(sine, cosine) / sine)
