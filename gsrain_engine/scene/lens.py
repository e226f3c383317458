"""Lenses: from directions to pixels and back, by OpenCV's distortion and fisheye models and NVIDIA's f-theta.

A lens maps a point in the camera's frame (x right, y down, z forward) to a place in the picture over the focal length;
a pixel is focal length times place plus principal point, with the center of the first one at 0.5.
"""

from functools import lru_cache
from typing import Literal, NamedTuple, Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from .rolling_shutter import CameraIntrinsics, RollingShutter

LensModel = Literal["opencv", "fisheye", "ftheta"]

LENS_NUMBERS = 19
_COUNTS = {"opencv": (4, 5, 8, 12, 14), "fisheye": (4,), "ftheta": tuple(range(1, 16))}
_MAX_COEFFICIENT = 1e9
_WIDEST_TANGENT = 100.0
_STEPS = 4096  # of the tables by which limits are found
_CACHED = 16  # cameras whose rays are held, enough for a rig


class Lens(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Lens of a camera, whose focal length is that on the axis.

    * opencv: k1 k2 p1 p2 k3 k4 k5 k6, then s1 s2 s3 s4 and two tilts (the first 4, 5, 8, 12 or 14): radial, tangential
      and thin-prism distortion (Brown 1966; OpenCV, calib3d);
    * fisheye: k1 k2 k3 k4, polynomial of the angle from the axis, a + k1 a^3 + k2 a^5 + ... (Kannala and Brandt 2006);
    * ftheta: k1 k2 ..., polynomial k1 a + k2 a^2 + ... (NVIDIA's f-theta), up to 15.
    """

    model: LensModel
    coefficients: tuple[float, ...]
    max_angle_rad: float | None = None
    """Largest angle from the axis; None is where the polynomial stops to rise."""
    shear: tuple[float, float] = (0.0, 0.0)
    """Shares of the place down that are added to that across, and of the place across to that down."""

    def __post_init__(self) -> None:
        if self.model not in _COUNTS:
            raise ValueError(f"a lens has the model opencv, fisheye or ftheta, not {self.model!r}")
        allowed, count = _COUNTS[self.model], len(self.coefficients)
        if count not in allowed:
            words = "1 to 15" if self.model == "ftheta" else str(allowed)
            raise ValueError(f"a lens of model {self.model!r} has {words} coefficients, not {count}")
        if not all(abs(value) < _MAX_COEFFICIENT for value in (*self.coefficients, *self.shear)):
            raise ValueError(f"coefficients of a lens must be finite numbers below {_MAX_COEFFICIENT:g}")
        if self.max_angle_rad is not None and not 0 < self.max_angle_rad <= np.pi:
            raise ValueError(f"max_angle_rad of a lens must be above 0 and at most pi, not {self.max_angle_rad:g}")

    def check_drawable(self) -> None:
        """Raise ValueError for a lens by which nothing is drawn: a tilted sensor, or a polynomial that falls."""
        if any(self.coefficients[12:]):
            raise ValueError("a lens with a tilted sensor (coefficients 13 and 14) is not drawn, only the first 12")
        if not lens_numbers(self)[1] > 0:
            raise ValueError(f"the polynomial of the lens {self.model!r} must rise from the axis on")


@lru_cache(maxsize=64)
def lens_numbers(lens: Lens | None) -> Float64[np.ndarray, "19"]:
    """Numbers of a lens for kernels and shaders.

    Model (0 pinhole, 1 by the tangent, 2 by the angle); largest tangent or angle; shear; then the coefficients: 12 of
    `opencv`, or 15 of the polynomial of the angle, its first power first.
    """
    numbers = np.zeros(LENS_NUMBERS)
    if lens is None:
        return numbers
    numbers[2:4] = lens.shear
    if lens.model == "opencv":
        numbers[0], numbers[1] = 1, largest_tangent(lens)
        numbers[4:16] = (*lens.coefficients, *[0.0] * 12)[:12]
        return numbers
    numbers[0], numbers[1] = 2, _largest_angle(lens)
    polynomial = _polynomial(lens)
    numbers[4 : 4 + len(polynomial)] = polynomial
    return numbers


def _polynomial(lens: Lens) -> list[float]:
    """Coefficients of the angle's first, second, ... power."""
    if lens.model == "ftheta":
        return list(lens.coefficients)
    k1, k2, k3, k4 = lens.coefficients
    return [1.0, 0.0, k1, 0.0, k2, 0.0, k3, 0.0, k4]


def _largest_angle(lens: Lens) -> float:
    """Angle from the axis at which the polynomial stops to rise, or that of the lens if it is less."""
    angles = np.linspace(0, lens.max_angle_rad or np.pi, _STEPS)
    values = np.polynomial.polynomial.polyval(angles, [0.0, *_polynomial(lens)])
    return float(angles[_rising(values)])


def largest_tangent(lens: Lens | None) -> float:
    """Tangent of the largest angle from the axis for which the lens polynomial is valid.

    Beyond, the polynomial folds back, and points far outside would be projected into the image again.
    """
    if lens is None:
        return np.inf
    if lens.model != "opencv":
        angle = _largest_angle(lens)
        return float(np.tan(angle)) if angle < np.arctan(_WIDEST_TANGENT) else _WIDEST_TANGENT
    k1, k2, _, _, k3, k4, k5, k6 = (*lens.coefficients, *[0.0] * 8)[:8]
    radii = np.geomspace(1e-3, _WIDEST_TANGENT, _STEPS)
    r2 = radii**2
    above, below = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    limit = float(radii[_rising(np.where(below > 0, radii * above / np.where(below > 0, below, 1), -1.0))])
    if lens.max_angle_rad is not None and lens.max_angle_rad < np.pi / 2:
        limit = min(limit, float(np.tan(lens.max_angle_rad)))
    return limit


def _rising(values: Float64[np.ndarray, " n"]) -> int:
    """Index of the last value before the first decrease."""
    falls = np.flatnonzero(~(np.diff(values) > 0))
    return int(falls[0]) if len(falls) else len(values) - 1


# Points to pixels


def bent_places(
    points: Float[np.ndarray, "n 3"], lens: Lens | None
) -> tuple[Float64[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Places over the focal length of points in the camera's frame, and which of them the lens images."""
    from .lens_kernels import bend_points

    places, is_imaged = np.empty((len(points), 2)), np.empty(len(points), np.bool_)
    bend_points(np.ascontiguousarray(points, np.float64), lens_numbers(lens), places, is_imaged)
    return places, is_imaged


# Pixels to rays


class PixelRays(NamedTuple):
    """Rays of all pixels of a camera, in its frame."""

    directions: Float32[np.ndarray, "h w 3"]
    """Unit directions (x right, y down, z forward); along the axis for pixels without a ray."""
    is_imaged: Bool[np.ndarray, "h w"]
    """Pixels that a ray comes to."""


_Intrinsics = tuple[int, int, float, float, float, float]


@runtime_checkable
class LensCamera(CameraIntrinsics, Protocol):
    """Intrinsics, lens and rolling shutter of a camera."""

    @property
    def lens(self) -> Lens | None: ...
    @property
    def rolling(self) -> RollingShutter | None: ...


def pixel_rays(camera: LensCamera) -> PixelRays:
    """Rays of a camera through the centers of its pixels; held for the last cameras.

    With a rolling shutter in the frame of the camera in the middle of the readout, each turned as its row.
    """
    c = camera
    return _pixel_rays((c.width, c.height, c.fx, c.fy, c.cx, c.cy), c.lens, c.rolling)


@lru_cache(maxsize=_CACHED)
def _pixel_rays(size: _Intrinsics, lens: Lens | None, rolling: RollingShutter | None) -> PixelRays:
    width, height, fx, fy, cx, cy = size
    u, v = np.meshgrid((np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy)
    places = np.stack([u, v], axis=-1)
    rays, is_imaged = rays_of_places(places, lens, (fx, fy))
    if rolling is not None and any(rolling.turn_rad):
        rays = rolling.turned_rays(rays)
    return PixelRays(rays.astype(np.float32), is_imaged)


def rays_of_places(
    places: Float64[np.ndarray, "*n 2"], lens: Lens | None, focal_px: tuple[float, float] = (1e3, 1e3)
) -> tuple[Float64[np.ndarray, "*n 3"], Bool[np.ndarray, "*n"]]:
    """Unit directions of places over the focal length, and which of them a ray comes to, to 0.01 px."""
    if lens is None:
        ahead = np.concatenate([places, np.ones((*places.shape[:-1], 1))], axis=-1)
        return ahead / np.linalg.norm(ahead, axis=-1, keepdims=True), np.ones(places.shape[:-1], np.bool_)
    from .lens_kernels import unbend_places

    rays, is_imaged = np.empty((places[..., 0].size, 3)), np.empty(places[..., 0].size, np.bool_)
    flat = np.ascontiguousarray(places, np.float64).reshape(-1, 2)
    unbend_places(flat, lens_numbers(lens), float(focal_px[0]), float(focal_px[1]), rays, is_imaged)
    return rays.reshape(*places.shape[:-1], 3), is_imaged.reshape(places.shape[:-1])


# Field of view

_WIDEST_COSINE = float(np.cos(np.radians(80.0)))
_GRID = 64  # cells of a view across and down, at whose corners its bounds are taken


class ViewBounds(NamedTuple):
    """Bounds of the rays of a camera."""

    slopes: Float64[np.ndarray, "4"] | None
    """Lowest and highest x/z, lowest and highest y/z; None where a ray is over 80 degrees from the axis."""
    angle_rad: float
    """Largest angle of a ray from the axis."""


def view_bounds(camera: LensCamera) -> ViewBounds:
    """Bounds of the view of a camera with a lens or a rolling shutter, a pixel wider on all sides."""
    c = camera
    return _view_bounds((c.width, c.height, c.fx, c.fy, c.cx, c.cy), c.lens, c.rolling)


@lru_cache(maxsize=_CACHED)
def _view_bounds(size: _Intrinsics, lens: Lens | None, rolling: RollingShutter | None) -> ViewBounds:
    width, height, fx, fy, cx, cy = size
    columns, rows = (np.linspace(0, side, min(side, _GRID) + 1) for side in (width, height))
    u, v = np.meshgrid((columns - cx) / fx, (rows - cy) / fy)
    rays, is_imaged = rays_of_places(np.stack([u, v], axis=-1), lens, (fx, fy))
    if rolling is not None and any(rolling.turn_rad):
        rays = rolling.turned_rays(rays)
    imaged = rays[is_imaged]
    if not len(imaged):
        return ViewBounds(np.zeros(4), 0.0)
    pixel = 2 / min(fx, fy)
    if not is_imaged.all():  # the view ends between the grid's points
        pixel += 1.5 * max(width / fx, height / fy) / min(width, height, _GRID)
    angle = float(np.arccos(np.clip(imaged[:, 2].min(), -1, 1))) + pixel
    if np.cos(angle) < _WIDEST_COSINE:
        return ViewBounds(None, min(angle, np.pi))
    slopes = imaged[:, :2] / imaged[:, 2:]
    margin = pixel / np.cos(angle) ** 2
    (left, top), (right, bottom) = slopes.min(axis=0) - margin, slopes.max(axis=0) + margin
    return ViewBounds(np.array([left, right, top, bottom]), angle)
