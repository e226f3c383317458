"""Lenses: from directions to pixels and back, by OpenCV's distortion and fisheye models and NVIDIA's f-theta.

A lens maps a point in the camera's frame (x right, y down, z forward) to a place in the picture over the focal length;
a pixel is focal length times place plus principal point, with the center of the first one at 0.5.
"""

from functools import lru_cache
from typing import Literal, NamedTuple, Protocol, no_type_check, runtime_checkable

import msgspec
import numba
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from ..kernels import NOGIL
from .rolling_shutter import CameraIntrinsics, RollingShutter

LensModel = Literal["opencv", "fisheye", "ftheta"]

LENS_NUMBERS = 19
_COUNTS = {"opencv": (4, 5, 8, 12, 14), "fisheye": (4,), "ftheta": tuple(range(1, 16))}
_MAX_COEFFICIENT = 1e9
_WIDEST_TANGENT = 100.0
_STEPS = 4096  # of the tables by which limits are found
_NEWTON_STEPS, _BRACKET_STEPS = 12, 60
_LARGEST_ERROR_PX, _CLOSE_PX = 0.01, 1e-7
_STEP = 1e-6  # of a derivative
_CHUNK = 1024
_CACHED = 16  # cameras whose rays are held, enough for a rig


class Lens(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
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


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def polynomial_of(angle, lens):
    """Length of the place of an angle from the axis."""
    length = lens[18]
    for k in range(17, 3, -1):
        length = lens[k] + angle * length
    return length * angle


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def straight_place(x, y, z, lens):
    """Place without shear, see `bent_place`."""
    if lens[0] == 0:
        return x / z, y / z, z > 0
    if lens[0] == 1:
        a, b = x / z, y / z
        r2 = a * a + b * b
        above = 1 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        radial = above / (1 + r2 * (lens[9] + r2 * (lens[10] + r2 * lens[11])))
        p = a * radial + 2 * lens[6] * a * b + lens[7] * (r2 + 2 * a * a) + r2 * (lens[12] + r2 * lens[13])
        q = b * radial + lens[6] * (r2 + 2 * b * b) + 2 * lens[7] * a * b + r2 * (lens[14] + r2 * lens[15])
        return p, q, z > 0 and r2 <= lens[1] * lens[1]
    r = np.sqrt(x * x + y * y)
    angle = np.arctan2(r, z)
    scale = polynomial_of(angle, lens) / r if r > 1e-9 * abs(z) else lens[4] / abs(z)
    return x * scale, y * scale, angle <= lens[1]


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def bent_place(x, y, z, lens):
    """Place in the picture, over the focal length, of a point in the camera's frame, and whether the lens images it."""
    p, q, is_imaged = straight_place(x, y, z, lens)
    return p + lens[2] * q, q + lens[3] * p, is_imaged


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _bend_points(points, lens, places, is_imaged):
    for i in range(len(points)):
        places[i, 0], places[i, 1], is_imaged[i] = bent_place(points[i, 0], points[i, 1], points[i, 2], lens)


def bent_places(
    points: Float[np.ndarray, "n 3"], lens: Lens | None
) -> tuple[Float64[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Places over the focal length of points in the camera's frame, and which of them the lens images."""
    places, is_imaged = np.empty((len(points), 2)), np.empty(len(points), np.bool_)
    _bend_points(np.ascontiguousarray(points, np.float64), lens_numbers(lens), places, is_imaged)
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
    rays, is_imaged = np.empty((places[..., 0].size, 3)), np.empty(places[..., 0].size, np.bool_)
    flat = np.ascontiguousarray(places, np.float64).reshape(-1, 2)
    _unbend_places(flat, lens_numbers(lens), float(focal_px[0]), float(focal_px[1]), rays, is_imaged)
    return rays.reshape(*places.shape[:-1], 3), is_imaged.reshape(places.shape[:-1])


@numba.njit(parallel=True, cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _unbend_places(places, lens, fx, fy, rays, is_imaged):
    for chunk in numba.prange((len(places) + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min(len(places), (chunk + 1) * _CHUNK)):
            shear = 1 / (1 - lens[2] * lens[3])
            p = shear * (places[i, 0] - lens[2] * places[i, 1])
            q = shear * (places[i, 1] - lens[3] * places[i, 0])
            if lens[0] == 1:
                x, y, z, found = _by_tangent(p, q, lens, fx, fy)
            else:
                x, y, z, found = _by_angle(p, q, lens, max(fx, fy))
            is_imaged[i] = found
            rays[i, 0], rays[i, 1], rays[i, 2] = (x, y, z) if found else (0.0, 0.0, 1.0)


@numba.njit(error_model="numpy")
@no_type_check
def _by_tangent(p, q, lens, fx, fy):
    """Ray of a place by OpenCV's distortion, by Newton's method, and whether there is one."""
    a, b, area = p, q, 1.0
    error_a = error_b = np.inf
    for _ in range(_NEWTON_STEPS + 1):
        at_a, at_b, _ = straight_place(a, b, 1.0, lens)
        error_a, error_b = at_a - p, at_b - q
        to_a, to_b, _ = straight_place(a + _STEP, b, 1.0, lens)
        by_aa, by_ab = (to_a - at_a) / _STEP, (to_b - at_b) / _STEP
        to_a, to_b, _ = straight_place(a, b + _STEP, 1.0, lens)
        by_ba, by_bb = (to_a - at_a) / _STEP, (to_b - at_b) / _STEP
        area = by_aa * by_bb - by_ab * by_ba
        if max(abs(error_a) * fx, abs(error_b) * fy) < _CLOSE_PX or area == 0:
            break
        a, b = a - (by_bb * error_a - by_ba * error_b) / area, b - (by_aa * error_b - by_ab * error_a) / area
    # Beyond the lens's range the polynomial falls: a mirrored image, which no lens has.
    found = max(abs(error_a) * fx, abs(error_b) * fy) < _LARGEST_ERROR_PX and area > 0
    length = np.sqrt(a * a + b * b + 1)
    return a / length, b / length, 1 / length, found and a * a + b * b <= lens[1] * lens[1]


@numba.njit(error_model="numpy")
@no_type_check
def _by_angle(p, q, lens, focal):
    """Ray of a place by a polynomial of the angle, which rises up to its limit, and whether there is one."""
    length = np.sqrt(p * p + q * q)
    low, high, angle = 0.0, lens[1], min(length / lens[4], lens[1])
    if polynomial_of(high, lens) < length:
        return 0.0, 0.0, 1.0, False
    for _ in range(_BRACKET_STEPS):  # Newton's method, or the middle of the bracket where that leaves it
        error = polynomial_of(angle, lens) - length
        if abs(error) * focal < _CLOSE_PX:
            break
        low, high = (low, angle) if error > 0 else (angle, high)
        slope = (polynomial_of(angle + _STEP, lens) - polynomial_of(angle, lens)) / _STEP
        angle = angle - error / slope
        if not low <= angle <= high:
            angle = 0.5 * (low + high)
    scale = np.sin(angle) / length if length > 0 else 0.0
    return scale * p, scale * q, np.cos(angle), True


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
