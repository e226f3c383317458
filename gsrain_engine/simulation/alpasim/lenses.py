"""Lenses of AlpaSim's cameras: rays of pixels by OpenCV's pinhole and fisheye models and NVIDIA's f-theta.

A picture through a lens is sampled from pinhole pictures: one that covers all rays of a lens of up to 124 degrees, else
those faces of a cube that rays hit. Coordinates of pixels are continuous: the center of the first one is (0.5, 0.5).
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from ...scene.camera import Camera

MAX_SIDE_PX = 4096
MAX_PIXELS = 2**23
_WIDEST_DEG = 62.0  # half angle up to which one pinhole picture covers a lens
_LARGEST_FACE_PX = 4096
_MARGIN_PX = 2
_NEWTON_STEPS = 12
_LARGEST_ERROR_PX = 0.01
_STEPS = 4096  # of the table by which a polynomial is inverted
_COEFFICIENTS = {"radial_coeffs": 6, "tangential_coeffs": 2, "thin_prism_coeffs": 4}


class LensError(ValueError):
    """A camera of which no picture can be made; `is_known` if the message says what is not supported."""


@dataclass(frozen=True, slots=True, eq=False)
class LensFace:
    """A pinhole picture from which pixels of a lens are sampled."""

    camera: Camera
    """At the origin, with the axes of the lens' camera but for `turn`."""
    turn: Float64[np.ndarray, "3 3"]
    """Axes of the face in those of the lens."""
    columns: Float32[np.ndarray, "h w"]
    rows: Float32[np.ndarray, "h w"]
    """Coordinates in the face's picture, as OpenCV counts them: 0 is the center of the first pixel."""
    covered: Bool[np.ndarray, "h w"]
    """Pixels of the lens that are sampled from this face."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorLens:
    """A camera of a size, and the pinhole pictures that it is made of; without faces it is a pinhole itself."""

    camera: Camera
    faces: tuple[LensFace, ...] = ()


def lens_of(spec: Any, width: int, height: int) -> SensorLens:
    """Lens of a message `CameraSpec`, in a size in pixels; its own is scaled.

    Raises `LensError` for values out of range, and for models that are not supported.
    """
    if not (1 <= width <= MAX_SIDE_PX and 1 <= height <= MAX_SIDE_PX and width * height <= MAX_PIXELS):
        told = f"each side must be 1 to {MAX_SIDE_PX} px, their product at most {MAX_PIXELS}"
        raise LensError(f"resolution {width} x {height}: {told}")
    if spec.WhichOneof("external_distortion") is not None:
        raise LensError("camera_intrinsics.external_distortion: windshield models are not supported")
    kind = spec.WhichOneof("camera_param")
    if kind is None:
        raise LensError("camera_intrinsics.camera_param: one of its models must be set")
    parameters = getattr(spec, kind)
    across = width / (spec.resolution_w or width)
    down = height / (spec.resolution_h or height)
    if not (2**-8 <= across <= 2**8 and 2**-8 <= down <= 2**8):
        raise LensError(f"resolution {width} x {height} is too far from the camera's own")
    if kind == "opencv_pinhole_param" and not any(np.any(getattr(parameters, name)) for name in _COEFFICIENTS):
        return SensorLens(_pinhole(parameters, width, height, across, down))
    pixels = np.stack(np.meshgrid((np.arange(width) + 0.5) / across, (np.arange(height) + 0.5) / down), axis=-1)
    rays = {"opencv_pinhole_param": _pinhole_rays, "opencv_fisheye_param": _fisheye_rays, "ftheta_param": _ftheta_rays}
    directions, is_seen = rays[kind](parameters, pixels)
    if not is_seen.any():
        raise LensError("camera_intrinsics: no pixel sees anything")
    camera = Camera(width, height, float(width), float(width), width / 2, height / 2)
    return SensorLens(camera, _faces(directions, is_seen))


def assemble(lens: SensorLens, pictures: list[UInt8[np.ndarray, "_ _ 3"]]) -> UInt8[np.ndarray, "h w 3"]:
    """Picture through a lens from those of its faces, in their order; pixels that see nothing are black."""
    if not lens.faces:
        return pictures[0]
    found = np.zeros((lens.camera.height, lens.camera.width, 3), np.uint8)
    for face, picture in zip(lens.faces, pictures, strict=True):
        sampled = cv2.remap(picture, face.columns, face.rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        found[face.covered] = np.asarray(sampled, np.uint8)[face.covered]
    return found


# Rays


_Pixels = Float64[np.ndarray, "h w 2"]
_Rays = tuple[Float64[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]
"""Unit directions (x right, y down, z forward), and which pixels see anything."""


def _finite(name: str, values: Any) -> list[float]:
    numbers = [float(value) for value in values]
    if not np.isfinite(numbers).all() or any(abs(value) > 1e6 for value in numbers):
        raise LensError(f"camera_intrinsics.{name}: must be finite numbers of at most 1e6")
    return numbers


def _focal(parameters: Any) -> tuple[float, float, float, float]:
    names = ("focal_length_x", "focal_length_y", "principal_point_x", "principal_point_y")
    fx, fy, cx, cy = _finite("focal_length and principal_point", [getattr(parameters, name) for name in names])
    if min(fx, fy) < 1:
        raise LensError(f"camera_intrinsics.focal_length: must be at least 1 px, not {min(fx, fy):g}")
    return fx, fy, cx, cy


def _pinhole(parameters: Any, width: int, height: int, across: float, down: float) -> Camera:
    fx, fy, cx, cy = _focal(parameters)
    return Camera(width, height, fx * across, fy * down, cx * across, cy * down)


def _pinhole_rays(parameters: Any, pixels: _Pixels) -> _Rays:
    fx, fy, cx, cy = _focal(parameters)
    groups: list[list[float]] = []
    for name, most in _COEFFICIENTS.items():
        values = _finite(name, getattr(parameters, name))
        if len(values) > most:
            raise LensError(f"camera_intrinsics.{name}: at most {most} numbers, not {len(values)}")
        groups.append(values + [0.0] * (most - len(values)))
    coefficients = tuple(np.array(group, np.float64) for group in groups)
    wanted = (pixels - [cx, cy]) / [fx, fy]
    points, area, step = wanted.copy(), np.ones(wanted.shape[:2]), 1e-6
    with np.errstate(all="ignore"):  # pixels that no ray comes to diverge
        for _ in range(_NEWTON_STEPS):
            error = _distorted(points, *coefficients) - wanted
            by_x = (_distorted(points + [step, 0], *coefficients) - wanted - error) / step
            by_y = (_distorted(points + [0, step], *coefficients) - wanted - error) / step
            area = by_x[..., 0] * by_y[..., 1] - by_x[..., 1] * by_y[..., 0]
            moved_x = by_y[..., 1] * error[..., 0] - by_y[..., 0] * error[..., 1]
            moved_y = by_x[..., 0] * error[..., 1] - by_x[..., 1] * error[..., 0]
            points = points - np.stack([moved_x, moved_y], axis=-1) / area[..., None]
        error = np.abs(_distorted(points, *coefficients) - wanted) * [fx, fy]
        # Beyond the lens's range the polynomial falls: a mirrored image, which no lens has.
        is_seen = (error.max(axis=-1) < _LARGEST_ERROR_PX) & (area > 0) & np.isfinite(points).all(axis=-1)
    points = np.where(is_seen[..., None], points, 0.0)
    directions = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=-1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True), is_seen


def _distorted(
    points: _Pixels, k: Float64[np.ndarray, "6"], p: Float64[np.ndarray, "2"], s: Float64[np.ndarray, "4"]
) -> _Pixels:
    """OpenCV's distortion (calib3d): rational radial, tangential, thin prism."""
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))) / (1 + r2 * (k[3] + r2 * (k[4] + r2 * k[5])))
    bent_x = x * radial + 2 * p[0] * x * y + p[1] * (r2 + 2 * x * x) + s[0] * r2 + s[1] * r2 * r2
    bent_y = y * radial + p[0] * (r2 + 2 * y * y) + 2 * p[1] * x * y + s[2] * r2 + s[3] * r2 * r2
    return np.stack([bent_x, bent_y], axis=-1)


def _fisheye_rays(parameters: Any, pixels: _Pixels) -> _Rays:
    fx, fy, cx, cy = _focal(parameters)
    k = _finite("radial_coeffs", parameters.radial_coeffs)
    if len(k) > 4:
        raise LensError(f"camera_intrinsics.radial_coeffs: at most 4 numbers, not {len(k)}")
    points = (pixels - [cx, cy]) / [fx, fy]
    forward = np.zeros(2 * len(k) + 2)
    forward[1] = 1.0
    forward[3::2] = k
    return _by_angle(points, *_inverted(forward, np.linalg.norm(points, axis=-1), _max_angle(parameters)))


def _ftheta_rays(parameters: Any, pixels: _Pixels) -> _Rays:
    cx, cy = _finite("principal_point", [parameters.principal_point_x, parameters.principal_point_y])
    linear = parameters.linear_cde
    c, d, e = _finite("linear_cde", [linear.linear_c, linear.linear_d, linear.linear_e])
    matrix = np.array([[c, d], [e, 1.0]]) if parameters.HasField("linear_cde") else np.eye(2)
    if abs(np.linalg.det(matrix)) < 1e-6:
        raise LensError("camera_intrinsics.linear_cde: its matrix must be invertible")
    points = (pixels - [cx, cy]) @ np.linalg.inv(matrix).T
    radii = np.linalg.norm(points, axis=-1)
    backward = _finite("pixeldist_to_angle_poly", parameters.pixeldist_to_angle_poly)
    forward = _finite("angle_to_pixeldist_poly", parameters.angle_to_pixeldist_poly)
    if max(len(backward), len(forward)) > 16 or not (backward or forward):
        raise LensError(
            "camera_intrinsics: one of pixeldist_to_angle_poly and angle_to_pixeldist_poly must have 1 to 16 numbers"
        )
    angle = _max_angle(parameters)
    if backward and (parameters.reference_poly != 2 or not forward):
        angles = np.polynomial.polynomial.polyval(radii, backward)
        is_seen = np.isfinite(angles) & (angles >= 0) & (angles <= angle)
        return _by_angle(points, np.where(is_seen, angles, 0.0), is_seen)
    return _by_angle(points, *_inverted(np.array(forward), radii, angle))


def _max_angle(parameters: Any) -> float:
    angle = parameters.max_angle
    return float(angle) if 0 < angle < math.pi else 0.99 * math.pi


def _inverted(
    polynomial: Float64[np.ndarray, " c"], radii: Float64[np.ndarray, "h w"], largest: float
) -> tuple[Float64[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Angles at which a polynomial of the angle has the value of the radii, up to where it stops to rise."""
    angles = np.linspace(0.0, largest, _STEPS)
    values = np.polynomial.polynomial.polyval(angles, polynomial)
    falls = np.flatnonzero(~(np.diff(values) > 0))
    end = falls[0] + 1 if len(falls) else _STEPS
    if end < 2:
        raise LensError("camera_intrinsics: the polynomial of the angle must rise from 0 on")
    found = np.interp(radii, values[:end], angles[:end])
    slope = np.polynomial.polynomial.polyder(polynomial)
    for _ in range(3):  # Newton's method, from a table that is already exact to 1e-6
        value, rise = (np.polynomial.polynomial.polyval(found, each) for each in (polynomial, slope))
        found = np.clip(found - (value - radii) / np.where(rise > 1e-12, rise, np.inf), 0.0, angles[end - 1])
    return found, radii <= values[end - 1]


def _by_angle(
    points: Float64[np.ndarray, "h w 2"], angles: Float64[np.ndarray, "h w"], is_seen: Bool[np.ndarray, "h w"]
) -> _Rays:
    """Rays at an angle from the axis, in the direction of points around it."""
    lengths = np.linalg.norm(points, axis=-1, keepdims=True)
    around = np.divide(points, lengths, out=np.zeros_like(points), where=lengths > 0)
    return np.concatenate([around * np.sin(angles)[..., None], np.cos(angles)[..., None]], axis=-1), is_seen


# Faces

_CUBE = {
    "front": np.eye(3),
    "right": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float64),
    "left": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], np.float64),
    "down": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float64),
    "up": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float64),
    "back": np.array([[-1, 0, 0], [0, 1, 0], [0, 0, -1]], np.float64),
}
"""Axes of each face (columns: right, down, forward) in those of the lens."""


def _faces(directions: Float64[np.ndarray, "h w 3"], is_seen: Bool[np.ndarray, "h w"]) -> tuple[LensFace, ...]:
    focal = _pixels_per_radian(directions, is_seen)
    if directions[is_seen][:, 2].min() > math.cos(math.radians(_WIDEST_DEG)):
        return (_face(directions, is_seen, np.eye(3), focal),)
    forwards = np.stack([turn[:, 2] for turn in _CUBE.values()])
    nearest = (directions @ forwards.T).argmax(axis=-1)
    found: list[LensFace] = []
    for index, turn in enumerate(_CUBE.values()):
        covered = is_seen & (nearest == index)
        if covered.any():
            found.append(_face(directions, covered, turn, focal))
    return tuple(found)


def _pixels_per_radian(directions: Float64[np.ndarray, "h w 3"], is_seen: Bool[np.ndarray, "h w"]) -> float:
    """Largest density of pixels across and down, in the middle half of all that see anything."""
    densities: list[float] = [1.0]
    for axis in (0, 1):
        if directions.shape[axis] > 1:
            steps = np.linalg.norm(np.diff(directions, axis=axis), axis=-1)
            both = np.logical_and(*(np.take(is_seen, range(k, is_seen.shape[axis] - 1 + k), axis) for k in (0, 1)))
            if both.any():
                densities.append(1 / max(float(np.quantile(steps[both], 0.25)), 1e-6))
    return max(densities)


def _face(
    directions: Float64[np.ndarray, "h w 3"],
    covered: Bool[np.ndarray, "h w"],
    turn: Float64[np.ndarray, "3 3"],
    focal: float,
) -> LensFace:
    """Pinhole picture of the rays of some pixels, cut to them."""
    local = directions @ turn
    points = local[..., :2] / np.where(covered, local[..., 2], 1.0)[..., None]
    low, high = points[covered].min(axis=0), points[covered].max(axis=0)
    focal = min(focal, (_LARGEST_FACE_PX - 2 * _MARGIN_PX) / max(float((high - low).max()), 1e-6))
    start = np.floor(low * focal) - _MARGIN_PX
    width, height = (np.ceil(high * focal) + _MARGIN_PX - start).astype(int).tolist()
    camera = Camera(width, height, focal, focal, -float(start[0]), -float(start[1]))
    columns, rows = np.moveaxis((points * focal - start - 0.5).astype(np.float32), -1, 0)
    return LensFace(camera, turn, np.ascontiguousarray(columns), np.ascontiguousarray(rows), covered)
