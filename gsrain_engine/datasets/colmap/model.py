"""What a COLMAP model holds, as plain values: its cameras, its registered images, its points."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from gsrain_engine.scene.camera import Camera

from ..capture import CaptureError, Lens

PARAMETERS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
    "SIMPLE_DIVISION": 4,
    "DIVISION": 5,
    "SIMPLE_FISHEYE": 3,
    "FISHEYE": 4,
    "EUCM": 6,
    "EQUIRECTANGULAR": 2,
}
"""How many parameters a camera model has, in the order of the numbers of binary files (COLMAP's sensor models)."""

_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_FISHEYE")
_STRAIGHT = ("SIMPLE_PINHOLE", "PINHOLE")
_BROWN = ("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
_EQUIDISTANT = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_FISHEYE", "FISHEYE")


@dataclass(frozen=True, slots=True)
class ColmapCamera:
    """Intrinsics that images share. Its pixels have their first centre at (0.5, 0.5), as ours."""

    id: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]

    def lens(self) -> Lens | None:
        """What bends its pictures, in OpenCV's terms. Raises `CaptureError` for a model that OpenCV doesn't have."""
        bends = self.parameters[3 if self.model in _ONE_FOCAL else 4 :]
        padded = (*bends, *[0.0] * (4 - len(bends)))
        if self.model in _STRAIGHT or (self.model in _BROWN and not any(bends)):
            return None
        if self.model in _BROWN:
            return Lens("opencv", padded)
        if self.model in _EQUIDISTANT:
            return Lens("fisheye", padded)
        usable = ", ".join((*_STRAIGHT, *_BROWN, *_EQUIDISTANT))
        raise CaptureError(
            f"camera {self.id} has the model {self.model}, which OpenCV doesn't have; usable are {usable}, "
            "and COLMAP's image_undistorter makes straight pictures of any"
        )

    def pinhole(self, world_to_camera: Float64[np.ndarray, "4 4"]) -> Camera:
        """The camera without what bends its pictures, at a pose."""
        p = self.parameters
        fx, fy, cx, cy = (p[0], p[0], p[1], p[2]) if self.model in _ONE_FOCAL else p[:4]
        return Camera(self.width, self.height, fx, fy, cx, cy, world_to_camera)


@dataclass(frozen=True, slots=True, eq=False)
class ColmapImage:
    """A registered image: which camera took it, and from where."""

    name: str
    """Path below the folder of the images."""
    camera_id: int
    quaternion_wxyz: tuple[float, float, float, float]
    """World to camera, with its translation; not always of length one."""
    translation: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class ColmapModel:
    """One reconstruction, in its own unit and axes."""

    cameras: dict[int, ColmapCamera]
    images: tuple[ColmapImage, ...]
    points: Float64[np.ndarray, "p 3"]
    colors: UInt8[np.ndarray, "p 3"]
