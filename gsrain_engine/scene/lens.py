"""Lenses: from directions to pixels and back, by OpenCV's distortion and fisheye models and NVIDIA's f-theta.

A lens maps a point in the camera's frame (x right, y down, z forward) to a place in the picture over the focal length;
a pixel is focal length times place plus principal point, with the center of the first one at 0.5.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, Literal, NamedTuple, no_type_check

import msgspec
import numba
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from ..kernels import NOGIL
from .rolling_shutter import RollingShutter

if TYPE_CHECKING:
    from .camera import Camera

LensModel = Literal["opencv", "fisheye", "ftheta"]

LENS_NUMBERS = 20
_COUNTS = {"opencv": (4, 5, 8, 12, 14), "fisheye": (4,), "ftheta": tuple(range(1, 16))}
_MAX_COEFFICIENT = 1e9
_WIDEST_TANGENT = 100.0
_STEPS = 4096  # of the tables by which polynomials are inverted and their limits found
_NEWTON_STEPS = 12
_LARGEST_ERROR_PX = 0.01
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
    """What the place across gains of that down, and the place down of that across."""

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
def lens_numbers(lens: Lens | None) -> Float64[np.ndarray, "20"]:
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
def bent_place(x, y, z, lens):
    """Place in the picture, over the focal length, of a point in the camera's frame, and whether the lens images it."""
    if lens[0] == 0:
        return x / z, y / z, z > 0
    if lens[0] == 1:
        a, b = x / z, y / z
        r2 = a * a + b * b
        is_imaged = z > 0 and r2 <= lens[1] * lens[1]
        above = 1 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        radial = above / (1 + r2 * (lens[9] + r2 * (lens[10] + r2 * lens[11])))
        p = a * radial + 2 * lens[6] * a * b + lens[7] * (r2 + 2 * a * a) + r2 * (lens[12] + r2 * lens[13])
        q = b * radial + lens[6] * (r2 + 2 * b * b) + 2 * lens[7] * a * b + r2 * (lens[14] + r2 * lens[15])
    else:
        r = np.sqrt(x * x + y * y)
        angle = np.arctan2(r, z)
        is_imaged = angle <= lens[1]
        length = lens[18]
        for k in range(17, 3, -1):
            length = lens[k] + angle * length
        length = length * angle / r if r > 1e-9 * abs(z) else lens[4] / abs(z)
        p, q = x * length, y * length
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


def pixel_rays(camera: "Camera") -> PixelRays:
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
    numbers = lens_numbers(lens)
    across, down = lens.shear
    straight = places @ (np.array([[1.0, -down], [-across, 1.0]]) / (1 - across * down))
    if lens.model == "opencv":
        return _rays_by_tangent(straight, lens, numbers, focal_px)
    lengths = np.linalg.norm(straight, axis=-1)
    angles, is_imaged = _angles(np.array([0.0, *_polynomial(lens)]), lengths, float(numbers[1]))
    around = np.divide(straight, lengths[..., None], out=np.zeros_like(straight), where=lengths[..., None] > 0)
    angles = np.where(is_imaged, angles, 0.0)
    return np.concatenate([around * np.sin(angles)[..., None], np.cos(angles)[..., None]], axis=-1), is_imaged


def _angles(
    polynomial: Float64[np.ndarray, " c"], lengths: Float64[np.ndarray, "*n"], largest: float
) -> tuple[Float64[np.ndarray, "*n"], Bool[np.ndarray, "*n"]]:
    """Angles at which a rising polynomial has some values, up to the largest angle."""
    table = np.linspace(0.0, largest, _STEPS)
    values = np.polynomial.polynomial.polyval(table, polynomial)
    found = np.interp(lengths, values, table)
    slope = np.polynomial.polynomial.polyder(polynomial)
    for _ in range(3):  # Newton's method, from a table that is already exact to 1e-6
        value, rise = (np.polynomial.polynomial.polyval(found, each) for each in (polynomial, slope))
        found = np.clip(found - (value - lengths) / np.where(rise > 1e-12, rise, np.inf), 0.0, largest)
    return found, lengths <= values[-1]


def _rays_by_tangent(
    places: Float64[np.ndarray, "*n 2"], lens: Lens, numbers: Float64[np.ndarray, "20"], focal_px: tuple[float, float]
) -> tuple[Float64[np.ndarray, "*n 3"], Bool[np.ndarray, "*n"]]:
    """Rays of OpenCV's distortion by Newton's method."""
    upright = msgspec.structs.replace(lens, shear=(0.0, 0.0))

    def distorted(tangents: Float64[np.ndarray, "m 2"]) -> Float64[np.ndarray, "m 2"]:
        points = np.concatenate([tangents, np.ones((len(tangents), 1))], axis=1)
        return bent_places(points, upright)[0]

    target = places.reshape(-1, 2)
    tangents, area, step = target.copy(), np.ones(len(target)), 1e-6
    with np.errstate(all="ignore"):  # places that no ray comes to diverge
        for _ in range(_NEWTON_STEPS):
            error = distorted(tangents) - target
            by_x = (distorted(tangents + [step, 0]) - target - error) / step
            by_y = (distorted(tangents + [0, step]) - target - error) / step
            area = by_x[:, 0] * by_y[:, 1] - by_x[:, 1] * by_y[:, 0]
            moved_x = by_y[:, 1] * error[:, 0] - by_y[:, 0] * error[:, 1]
            moved_y = by_x[:, 0] * error[:, 1] - by_x[:, 1] * error[:, 0]
            tangents = tangents - np.stack([moved_x, moved_y], axis=-1) / area[:, None]
        error = np.abs(distorted(tangents) - target) * focal_px
        # Beyond the lens's range the polynomial falls: a mirrored image, which no lens has.
        is_imaged = (error.max(axis=1) < _LARGEST_ERROR_PX) & (area > 0) & np.isfinite(tangents).all(axis=1)
        is_imaged &= (tangents**2).sum(axis=1) <= numbers[1] ** 2
    tangents = np.where(is_imaged[:, None], tangents, 0.0)
    ahead = np.concatenate([tangents, np.ones((len(tangents), 1))], axis=1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return ahead.reshape(*places.shape[:-1], 3), is_imaged.reshape(places.shape[:-1])


# Field of view

_WIDEST_COSINE = float(np.cos(np.radians(80.0)))


class ViewBounds(NamedTuple):
    """What the rays of a camera cover."""

    slopes: Float64[np.ndarray, "4"] | None
    """Lowest and highest x/z, lowest and highest y/z; None where a ray is over 80 degrees from the axis."""
    angle_rad: float
    """Largest angle of a ray from the axis."""


def view_bounds(camera: "Camera") -> ViewBounds:
    """Bounds of the view of a camera with a lens or a rolling shutter, a pixel wider on all sides."""
    c = camera
    return _view_bounds((c.width, c.height, c.fx, c.fy, c.cx, c.cy), c.lens, c.rolling)


@lru_cache(maxsize=_CACHED)
def _view_bounds(size: _Intrinsics, lens: Lens | None, rolling: RollingShutter | None) -> ViewBounds:
    rays, is_imaged = _pixel_rays(size, lens, rolling)
    imaged = rays[is_imaged].astype(np.float64)
    if not len(imaged):
        return ViewBounds(np.zeros(4), 0.0)
    pixel = 2 / min(size[2:4])
    angle = float(np.arccos(np.clip(imaged[:, 2].min(), -1, 1))) + pixel
    if np.cos(angle) < _WIDEST_COSINE:
        return ViewBounds(None, min(angle, np.pi))
    slopes = imaged[:, :2] / imaged[:, 2:]
    margin = pixel / np.cos(angle) ** 2
    (left, top), (right, bottom) = slopes.min(axis=0) - margin, slopes.max(axis=0) + margin
    return ViewBounds(np.array([left, right, top, bottom]), angle)
