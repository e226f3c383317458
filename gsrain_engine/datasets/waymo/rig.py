"""Waymo's cameras and boxes, which both releases of the data set describe alike."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from gsrain_engine.scene.camera import DEFAULT_EXPOSURE_S, Camera

from ..capture import Lens, View
from ..files.picture_file import opened_picture
from ..geometry.rigid_poses import OPENCV_FROM_VEHICLE_AXES, inverse, rigid

CAMERAS = {
    1: "FRONT",
    2: "FRONT_LEFT",
    3: "FRONT_RIGHT",
    4: "SIDE_LEFT",
    5: "SIDE_RIGHT",
    6: "REAR_LEFT",
    7: "REAR",
    8: "REAR_RIGHT",
}
"""Names of cameras by their numbers."""

CLASSES = {1: "vehicle", 2: "pedestrian", 3: "sign", 4: "cyclist"}
"""Names of classes by their numbers."""

_LONGEST_EXPOSURE_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class WaymoCamera:
    """Calibration of one camera. Its own axes are x forward, y left, z up; ours here are OpenCV's."""

    name: str
    intrinsics: tuple[float, ...]
    """f_u f_v c_u c_v k1 k2 p1 p2 k3; pixels as here, with the first one's centre at (0.5, 0.5)."""
    to_vehicle: Float64[np.ndarray, "4 4"]
    width: int
    height: int

    def __post_init__(self) -> None:
        if len(self.intrinsics) != 9 or not np.isfinite(self.intrinsics).all() or min(self.intrinsics[:2]) <= 0:
            raise ValueError(f"camera {self.name} has the intrinsics {self.intrinsics}, expected 9 numbers")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"camera {self.name} has pictures of {self.width}x{self.height} px")

    def view(
        self,
        name: str,
        vehicle_to_world: Float64[np.ndarray, "4 4"],
        time_s: float,
        shutter_s: float,
        jpeg: Callable[[], bytes],
    ) -> View:
        """One picture: taken from where the vehicle was then. A shutter time that can't be is the default one."""
        to_world = vehicle_to_world @ self.to_vehicle @ inverse(OPENCV_FROM_VEHICLE_AXES)
        fx, fy, cx, cy = self.intrinsics[:4]
        exposure = shutter_s if 0 < shutter_s <= _LONGEST_EXPOSURE_S else DEFAULT_EXPOSURE_S
        camera = Camera(self.width, self.height, fx, fy, cx, cy, inverse(to_world), exposure)
        lens = Lens("opencv", self.intrinsics[4:]) if any(self.intrinsics[4:]) else None
        return View(name, camera, lambda: decoded(jpeg(), name), time_s, self.name, lens)


def check_jpeg(content: bytes, size: tuple[int, int]) -> None:
    """Raise ValueError unless bytes look like a whole JPEG of a width and height."""
    with opened_picture(content, "its picture") as picture:
        found = picture.size
    if found != size:
        raise ValueError(f"a picture of {found[0]}x{found[1]} px, its calibration says {size[0]}x{size[1]}")
    if b"\xff\xd9" not in content[-1024:]:
        raise ValueError("the picture is cut off; its end is missing")


def decoded(content: bytes, name: str) -> UInt8[np.ndarray, "h w 3"]:
    """Decode a JPEG. Raises `CaptureError` where it is damaged."""
    with opened_picture(content, name) as picture:
        return np.array(picture.convert("RGB"), np.uint8)


def heading_pose(center_m: Sequence[float], heading_rad: float) -> Float64[np.ndarray, "4 4"]:
    """Pose of an upright box in the vehicle's frame."""
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return rigid(turn, np.asarray(center_m, np.float64))
