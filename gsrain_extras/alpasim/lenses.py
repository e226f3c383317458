"""Cameras of AlpaSim's messages: OpenCV's pinhole and fisheye models and NVIDIA's f-theta, and back.

Coordinates of pixels are continuous: the center of the first one is (0.5, 0.5).
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.lens import Lens
from gsrain_engine.scene.scene import RigCamera

MAX_SIDE_PX = 4096
MAX_PIXELS = 2**23
_COEFFICIENTS = {"radial_coeffs": 6, "tangential_coeffs": 2, "thin_prism_coeffs": 4}
_LARGEST_SCALE = 256
_SAMPLES = 400
_LARGEST_ERROR_PX = 0.02


class LensError(ValueError):
    """A camera of which no picture can be made."""


def camera_of(spec: Any, width: int, height: int) -> Camera:
    """Camera of a message `CameraSpec` at the origin, in a size in pixels; its own is scaled.

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
    across, down = _scale("w", width, spec.resolution_w), _scale("h", height, spec.resolution_h)
    read = {"opencv_pinhole_param": _pinhole, "opencv_fisheye_param": _fisheye, "ftheta_param": _ftheta}
    lens, fx, fy, cx, cy = read[kind](getattr(spec, kind))
    for axis, center, side in (("x", cx, spec.resolution_w), ("y", cy, spec.resolution_h)):
        if not -side <= center <= 2 * side:
            told = f"must be at most one picture outside of it, not {center:g} of {side} px"
            raise LensError(f"camera_intrinsics.principal_point_{axis}: {told}")
    camera = Camera(width, height, fx * across, fy * down, cx * across, cy * down, lens=lens)
    if lens is None:
        return camera
    try:
        lens.check_drawable()
    except ValueError as error:
        raise LensError(f"camera_intrinsics: {error}") from None
    if not camera.rays.is_imaged.any():
        raise LensError("camera_intrinsics: no pixel sees anything")
    return camera


def _scale(side: str, asked: int, own: int) -> float:
    """Size of a picture over that of the camera, whose intrinsics hold for its own."""
    if own < 1:
        raise LensError(f"camera_intrinsics.resolution_{side}: must be the size of the camera in pixels, not 0")
    if not 1 / _LARGEST_SCALE <= asked / own <= _LARGEST_SCALE:
        told = f"must be within a factor of {_LARGEST_SCALE} of the camera's own {own} px, not {asked}"
        raise LensError(f"resolution_{side}: {told}")
    return asked / own


_Intrinsics = tuple[Lens | None, float, float, float, float]


def _finite(name: str, values: Any) -> list[float]:
    numbers = [float(value) for value in values]
    if not np.isfinite(numbers).all() or any(abs(value) > 1e6 for value in numbers):
        raise LensError(f"camera_intrinsics.{name}: must be finite numbers of at most 1e6")
    return numbers


def _coefficients(name: str, given: Any, count: int) -> list[float]:
    """Coefficients of a distortion: all, or none, as a part of them could be those of another model."""
    values = _finite(name, given)
    if len(values) not in (0, count):
        raise LensError(f"camera_intrinsics.{name}: must be {count} numbers, or none, not {len(values)}")
    return values or [0.0] * count


def _focal(parameters: Any) -> tuple[float, float, float, float]:
    names = ("focal_length_x", "focal_length_y", "principal_point_x", "principal_point_y")
    fx, fy, cx, cy = _finite("focal_length and principal_point", [getattr(parameters, name) for name in names])
    if min(fx, fy) < 1:
        raise LensError(f"camera_intrinsics.focal_length: must be at least 1 px, not {min(fx, fy):g}")
    return fx, fy, cx, cy


def _pinhole(parameters: Any) -> _Intrinsics:
    focal = _focal(parameters)
    groups: list[list[float]] = []
    for name, count in _COEFFICIENTS.items():
        groups.append(_coefficients(name, getattr(parameters, name), count))
    radial, tangential, prism = groups
    if not any((*radial, *tangential, *prism)):
        return None, *focal
    return Lens("opencv", (*radial[:2], *tangential, *radial[2:], *prism)), *focal


def _fisheye(parameters: Any) -> _Intrinsics:
    focal, k = _focal(parameters), _coefficients("radial_coeffs", parameters.radial_coeffs, 4)
    return Lens("fisheye", tuple(k), _max_angle(parameters)), *focal


def _ftheta(parameters: Any) -> _Intrinsics:
    """Lens of f-theta: its first coefficient is 1, since the focal length is that on the axis."""
    cx, cy = _finite("principal_point", [parameters.principal_point_x, parameters.principal_point_y])
    linear = parameters.linear_cde
    c, d, e = _finite("linear_cde", [linear.linear_c, linear.linear_d, linear.linear_e])
    c, d, e = (c, d, e) if parameters.HasField("linear_cde") else (1.0, 0.0, 0.0)
    if abs(c - d * e) < 1e-6 or c <= 0:
        raise LensError("camera_intrinsics.linear_cde: its matrix must be invertible, and linear_c above 0")
    backward = _finite("pixeldist_to_angle_poly", parameters.pixeldist_to_angle_poly)
    forward = _finite("angle_to_pixeldist_poly", parameters.angle_to_pixeldist_poly)
    if max(len(backward), len(forward)) > 16 or not (backward or forward):
        raise LensError(
            "camera_intrinsics: one of pixeldist_to_angle_poly and angle_to_pixeldist_poly must have 1 to 16 numbers"
        )
    angle = _max_angle(parameters)
    if backward and (parameters.reference_poly != 2 or not forward):
        forward, angle = _inverted(backward, angle)
    if any(abs(value) > 1e-3 for value in forward[:1]):
        raise LensError("camera_intrinsics.angle_to_pixeldist_poly: must be 0 at the angle 0")
    slope = forward[1] if len(forward) > 1 else 0.0
    if not slope > 0:
        raise LensError("camera_intrinsics: the polynomial of the angle must rise from 0 on")
    lens = Lens("ftheta", tuple(value / slope for value in forward[1:]), angle, (d / c, e))
    return lens, c * slope, slope, cx, cy


def _max_angle(parameters: Any) -> float:
    angle = float(parameters.max_angle)
    return angle if 0 < angle < math.pi else 0.99 * math.pi


def _inverted(backward: list[float], largest: float) -> tuple[list[float], float]:
    """Polynomial of the angle that inverts one of the distance in pixels, to 0.02 px, and its largest angle."""
    evaluate = np.polynomial.polynomial.polyval
    reach = np.geomspace(1e-2, 2.0 * MAX_SIDE_PX, 2000)
    angles = evaluate(reach, backward)
    ends = np.flatnonzero(~((np.diff(angles) > 0) & (angles[1:] <= largest) & np.isfinite(angles[1:])))
    end = int(ends[0]) if len(ends) else len(reach) - 1
    if end < 1 or not 0 <= angles[0] < 0.1:
        raise LensError("camera_intrinsics: no pixel sees anything")
    distances = np.linspace(0.0, reach[end], _SAMPLES)
    angles = evaluate(distances, backward)
    scale = float(angles[-1])
    for degree in range(3, 16):
        powers: Float64[np.ndarray, "n d"] = (angles[:, None] / scale) ** np.arange(1, degree + 1)
        found, *_ = np.linalg.lstsq(powers, distances, rcond=None)
        if np.abs(powers @ found - distances).max() < _LARGEST_ERROR_PX:
            return [0.0, *(found / scale ** np.arange(1, degree + 1)).tolist()], min(scale, largest)
    raise LensError("camera_intrinsics.pixeldist_to_angle_poly: no polynomial of up to 15 powers inverts it")


def write_lens(spec: Any, camera: RigCamera) -> None:
    """Write the lens of a camera into a message `CameraSpec`."""
    lens = camera.lens
    if lens is not None and lens.model == "ftheta":
        row = spec.ftheta_param
        row.angle_to_pixeldist_poly.extend([0.0, *(camera.fy * value for value in lens.coefficients)])
        row.reference_poly = 2
        row.linear_cde.linear_c = camera.fx / camera.fy
        row.linear_cde.linear_d = lens.shear[0] * camera.fx / camera.fy
        row.linear_cde.linear_e = lens.shear[1]
    else:
        row = spec.opencv_fisheye_param if lens is not None and lens.model == "fisheye" else spec.opencv_pinhole_param
        row.focal_length_x, row.focal_length_y = camera.fx, camera.fy
    row.principal_point_x, row.principal_point_y = camera.cx, camera.cy
    if lens is None or lens.model == "opencv":
        k = (*(() if lens is None else lens.coefficients), *[0.0] * 12)[:12]
        row.radial_coeffs.extend((*k[:2], *k[4:8]))
        row.tangential_coeffs.extend(k[2:4])
        row.thin_prism_coeffs.extend(k[8:12])
        return
    if lens.model == "fisheye":
        row.radial_coeffs.extend(lens.coefficients)
    if lens.max_angle_rad is not None:
        row.max_angle = lens.max_angle_rad
