"""Camera with OpenCV axes (x right, y down, z forward), and its JSON file."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float, Float64

from ..safe_io.errors import SceneFormatError
from ..safe_io.files import read_json
from .lens import Lens, PixelRays, bent_places, pixel_rays, rays_of_places
from .rolling_shutter import RollingShutter

DEFAULT_EXPOSURE_S = 0.004
"""Daylight shutter of driving cameras: 2.6-3.9 ms in a Waymo sample frame, rounded up."""

_FARTHEST = 1e12  # larger numbers come from damaged files; their squares would soon overflow
_ROUNDING = 1e-3  # of the numbers of a rotation


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Intrinsics in pixels, pose as world to camera. Pixel (0, 0) has its center at (0.5, 0.5)."""

    width: int
    """Of the image in pixels."""
    height: int
    """Of the image in pixels."""
    fx: float
    """Focal length in pixels along x, to the right."""
    fy: float
    """Focal length in pixels along y, downward."""
    cx: float
    """Principal point in pixels from the left edge."""
    cy: float
    """Principal point in pixels from the upper edge."""
    world_to_camera: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Pose: a rotation and a shift from the world (meters, z up) to the camera (x right, y down, z ahead)."""
    exposure_s: float = DEFAULT_EXPOSURE_S
    """Shutter time in seconds, in which drops make streaks."""
    lens: Lens | None = None
    """None is a pinhole."""
    rolling: RollingShutter | None = None
    """Motion during the readout, in the middle of which the camera has its pose; None is a global shutter."""
    rows_outside: tuple[int, int] = (0, 0)
    """Rows above and below that the whole picture has, of which this is a `band`."""
    plane_m: float = 0.0
    """Depth of the picture plane of an orthographic camera, before which nothing is drawn; 0 for others."""

    @classmethod
    def from_fov(
        cls, width: int, height: int, vertical_fov_deg: float, world_to_camera: Float64[np.ndarray, "4 4"]
    ) -> "Camera":
        """Build a camera with square pixels and a centered principal point."""
        f = 0.5 * height / np.tan(np.radians(vertical_fov_deg) / 2)
        return cls(width, height, float(f), float(f), width / 2, height / 2, world_to_camera)

    def shifted(self, right: float = 0.0, down: float = 0.0, ahead: float = 0.0) -> "Camera":
        """Return the camera at another place, moved in meters along its own axes; it looks in the same direction."""
        pose = self.world_to_camera.copy()
        pose[:3, 3] -= (right, down, ahead)
        return replace(self, world_to_camera=pose)

    @property
    def camera_to_world(self) -> Float64[np.ndarray, "4 4"]:
        rotation = self.world_to_camera[:3, :3].T
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = -rotation @ self.world_to_camera[:3, 3]
        return matrix

    @property
    def position(self) -> Float64[np.ndarray, "3"]:
        """Center of projection in the world."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    @property
    def rounded_intrinsics(self) -> tuple[float, float, float, float]:
        """Focal lengths and principal point to a millionth of a pixel: equal numbers for frames of one camera."""
        return round(float(self.fx), 6), round(float(self.fy), 6), round(float(self.cx), 6), round(float(self.cy), 6)

    @property
    def is_pinhole(self) -> bool:
        """True without a lens and without a rolling shutter."""
        return self.lens is None and self.rolling is None

    @property
    def is_orthographic(self) -> bool:
        """True if its rays are parallel but for a part of a pixel: its eye is far behind its picture plane."""
        return self.plane_m > 0

    @property
    def pixels_per_m(self) -> float:
        """Scale of an orthographic camera's picture."""
        return self.fy / self.plane_m

    @property
    def pinhole(self) -> "Camera":
        """The camera without its lens and its rolling shutter."""
        return self if self.is_pinhole else replace(self, lens=None, rolling=None)

    def at_readout(self, part: float) -> "Camera":
        """Camera with a global shutter at a part of the readout, -1/2 (first row) to 1/2 (last row)."""
        if self.rolling is None:
            return self
        pose = self.rolling.from_middle(part) @ self.world_to_camera
        return replace(self, world_to_camera=pose, rolling=None)

    def pixels(self, points_m: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Pixels of points in the camera's frame; NaN for those that the lens does not image."""
        places, is_imaged = bent_places(points_m, self.lens)
        return np.where(is_imaged[:, None], places * [self.fx, self.fy] + [self.cx, self.cy], np.nan)

    def directions(self, pixels: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3"]:
        """Unit directions of pixels in the camera's frame; NaN where no ray comes to them."""
        places = (np.asarray(pixels, np.float64) - [self.cx, self.cy]) / [self.fx, self.fy]
        rays, is_imaged = rays_of_places(places, self.lens, (self.fx, self.fy))
        return np.where(is_imaged[:, None], rays, np.nan)

    @property
    def rays(self) -> PixelRays:
        """Rays of all pixels, see `pixel_rays`."""
        return pixel_rays(self)

    @property
    def vertical_fov_deg(self) -> float:
        """Angle from the top edge to the bottom edge."""
        if self.lens is not None:
            ends = self.directions(np.array([[self.cx, 0.0], [self.cx, self.height]]))
            return float(np.degrees(np.arccos(np.nan_to_num(ends[:, 2])).sum()))
        return float(np.degrees(np.arctan(self.cy / self.fy) + np.arctan((self.height - self.cy) / self.fy)))

    def resized(self, width: int, height: int) -> "Camera":
        """Keep the vertical field of view in another image size; the sides gain or lose, nothing is stretched."""
        s = height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * s,
            fy=self.fy * s,
            cx=width / 2 + (self.cx - self.width / 2) * s,
            cy=self.cy * s,
        )

    def band(self, top: int, rows: int) -> "Camera":
        """Camera of some rows of the picture. Projection holds back Gaussians beside the whole picture, not the band.

        Only for a pinhole with a global shutter.
        """
        assert self.is_pinhole, "rows of a lens or a rolling shutter have rays and times of their own"
        above, below = self.rows_outside[0] + top, self.rows_outside[1] + self.height - top - rows
        return replace(self, height=rows, cy=self.cy - top, rows_outside=(above, below))

    @property
    def whole(self) -> "Camera":
        """Camera of the whole picture of a band."""
        above, below = self.rows_outside
        if not (above or below):
            return self
        return replace(self, height=self.height + above + below, cy=self.cy + above, rows_outside=(0, 0))

    def moved(self, similarity: Float64[np.ndarray, "4 4"]) -> "Camera":
        """Return the camera with the same view of a transformed world (scene units to meters, for example)."""
        scale = np.cbrt(np.linalg.det(similarity[:3, :3]))
        turn = similarity[:3, :3] / scale
        matrix = np.eye(4)
        matrix[:3, :3] = self.world_to_camera[:3, :3] @ turn.T
        matrix[:3, 3] = scale * self.world_to_camera[:3, 3] - matrix[:3, :3] @ similarity[:3, 3]
        rolling = self.rolling
        if rolling is not None:
            x, y, z = (float(scale) * np.array(rolling.shift_m)).tolist()
            rolling = replace(rolling, shift_m=(x, y, z))
        return replace(self, world_to_camera=matrix, rolling=rolling, plane_m=float(scale) * self.plane_m)

    def to_json(self) -> dict[str, Any]:
        values = {name: getattr(self, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
        values["world_to_camera"] = self.world_to_camera.tolist()
        others = {"lens": self.lens, "rolling_shutter": self.rolling}
        values |= {name: msgspec.to_builtins(each) for name, each in others.items() if each is not None}
        return values | ({"plane_m": self.plane_m} if self.is_orthographic else {})

    @classmethod
    def from_json(cls, values: dict[str, Any], source: Path | str = "camera") -> "Camera":
        """Build a camera from the values of a camera file; `source` names it in errors."""
        try:
            matrix = np.array(values["world_to_camera"], dtype=np.float64)
            _check_shape(matrix, source)
            fx, fy, cx, cy = (float(values[key]) for key in ("fx", "fy", "cx", "cy"))
            exposure_s = float(values.get("exposure_s", DEFAULT_EXPOSURE_S))
            lens = _convert(values, "lens", Lens, source)
            rolling = _convert(values, "rolling_shutter", RollingShutter, source)
            plane_m = float(values.get("plane_m", 0.0))
            camera = cls(
                int(values["width"]), int(values["height"]), fx, fy, cx, cy, matrix, exposure_s, lens, rolling,
                plane_m=plane_m,
            )  # fmt: skip
        except KeyError as error:
            raise SceneFormatError(source, f"camera has no field {error.args[0]!r}") from None
        except SceneFormatError:
            raise
        except (TypeError, ValueError, OverflowError) as error:
            raise SceneFormatError(source, f"camera field can't be read as a number: {error}") from None
        camera.check(source)
        return camera

    def check(self, source: Path | str = "camera") -> None:
        """Raise `SceneFormatError`, which names `source` and the field, for numbers that no camera has."""
        matrix = self.world_to_camera
        _check_shape(matrix, source)
        if not np.abs(matrix).max() < _FARTHEST:
            raise SceneFormatError(
                source, f"world_to_camera must be a finite 4x4 matrix of numbers below {_FARTHEST:g}"
            )
        if np.abs(matrix[3] - [0, 0, 0, 1]).max() > _ROUNDING:
            raise SceneFormatError(source, "the last row of world_to_camera must be 0, 0, 0, 1: it may be transposed")
        rotation = matrix[:3, :3]
        product, determinant = rotation @ rotation.T, np.linalg.det(rotation)
        scale = float(np.cbrt(abs(determinant)))
        if np.abs(product - scale**2 * np.eye(3)).max() > _ROUNDING * max(scale**2, 1):
            raise SceneFormatError(source, "world_to_camera must hold a rotation, and its axes are not at right angles")
        if determinant < 0:
            raise SceneFormatError(
                source,
                "world_to_camera must hold a rotation without mirroring: of OpenGL's camera_to_world (y up, z "
                "backward) it is np.linalg.inv(camera_to_world @ np.diag([1, -1, -1, 1])), with two axes turned over",
            )
        if abs(scale - 1) > _ROUNDING:
            raise SceneFormatError(source, f"world_to_camera must hold a rotation without scale, not of {scale:.4g}")
        if not (1 <= self.width <= 16384 and 1 <= self.height <= 16384):
            raise SceneFormatError(source, f"size {self.width}x{self.height} must be within 1..16384 px")
        pixels = (self.fx, self.fy, self.cx, self.cy)
        if not all(abs(v) < _FARTHEST for v in pixels) or min(self.fx, self.fy) < 1 / _FARTHEST:
            raise SceneFormatError(source, "fx, fy must be above 0 and fx, fy, cx, cy finite")
        if not 0 < self.exposure_s <= 10:
            raise SceneFormatError(source, f"exposure_s {self.exposure_s} must be above 0 and at most 10 s")
        if not 0 <= self.plane_m < _FARTHEST or (self.is_orthographic and not self.is_pinhole):
            raise SceneFormatError(source, f"plane_m {self.plane_m} must be 0 or more, and 0 with a lens")
        if self.lens is not None:
            try:
                self.lens.check_drawable()
            except ValueError as error:
                raise SceneFormatError(source, str(error)) from None


def _check_shape(matrix: np.ndarray, source: Path | str) -> None:
    if matrix.shape != (4, 4):
        hint = "; append the row 0, 0, 0, 1" if matrix.shape == (3, 4) else ""
        raise SceneFormatError(source, f"world_to_camera has shape {matrix.shape}, expected 4x4{hint}")


def _convert(values: dict[str, Any], name: str, kind: type[Any], source: Path | str) -> Any:
    """Value of an optional field of a camera file."""
    if values.get(name) is None:
        return None
    try:
        return msgspec.convert(values[name], kind)
    except (msgspec.ValidationError, ValueError) as error:
        raise SceneFormatError(source, f"{name} can't be read: {error}") from None


def look_at(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Float64[np.ndarray, "4 4"]:
    """World-to-camera matrix of a camera at `eye` that looks at `target`, with `up` upwards in the image."""
    forward = np.asarray(target, np.float64) - eye
    forward /= np.linalg.norm(forward)
    right = _cross(forward, up)
    if np.linalg.norm(right) < 1e-9:  # looking along `up`: any right vector will do
        right = _cross(forward, np.roll(up, 1))
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, _cross(forward, right), forward
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return matrix


def _cross(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    """Cross product, ten times as fast as `np.cross` for two vectors: the window needs it often in each frame."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a.tolist(), b.tolist()
    return np.array((a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x))


def read_camera(path: Path | str) -> Camera:
    """Read a camera file (JSON: width, height, fx, fy, cx, cy, world_to_camera; lens, rolling_shutter)."""
    values = read_json(path)
    if not isinstance(values, dict):
        raise SceneFormatError(path, "a camera file holds one JSON object")
    return Camera.from_json(values, path)
