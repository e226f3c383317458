"""Where points of the world (z up or not, any unit) fall in a picture, through OpenCV's lenses too."""

import cv2
import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.scene.camera import Camera

from ..capture import Lens

_STEPS = 4096
_WIDEST_TANGENT = 100.0


def project_points(
    points: Float[np.ndarray, "p 3"], camera: Camera, lens: Lens | None = None
) -> tuple[Float64[np.ndarray, "p 2"], Float64[np.ndarray, " p"]]:
    """Pixel and depth along the view axis of each point; pixels are NaN behind the camera and where the lens can't see.

    A pixel's centre lies at a half: column and row are the whole parts.
    """
    local = np.asarray(points, np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    depths = np.ascontiguousarray(local[:, 2])
    pixels = np.full((len(local), 2), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        tangents = np.hypot(local[:, 0], local[:, 1]) / depths
        seen = (depths > 0) & (tangents <= largest_tangent(lens))
    if seen.any():
        pixels[seen] = _bent(local[seen], camera, lens)
    return pixels, depths


def _bent(local: Float64[np.ndarray, "p 3"], camera: Camera, lens: Lens | None) -> Float64[np.ndarray, "p 2"]:
    if lens is None:
        return local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    coefficients, still = np.array(lens.coefficients), np.zeros(3)
    rows = np.ascontiguousarray(local).reshape(-1, 1, 3)
    if lens.model == "fisheye":
        bent, _ = cv2.fisheye.projectPoints(rows, still, still, intrinsics(camera), coefficients)
    else:
        bent, _ = cv2.projectPoints(rows, still, still, intrinsics(camera), coefficients)
    return np.asarray(bent, np.float64).reshape(-1, 2)


def intrinsics(camera: Camera, first_center: float = 0.5) -> Float64[np.ndarray, "3 3"]:
    """Return K for pixels whose first centre lies at `first_center`: 0.5 is ours, 0 is that of OpenCV's pictures."""
    shift = first_center - 0.5
    return np.array([[camera.fx, 0, camera.cx + shift], [0, camera.fy, camera.cy + shift], [0, 0, 1.0]])


def largest_tangent(lens: Lens | None) -> float:
    """Tangent of the angle from the axis up to which the lens's polynomial makes sense.

    Beyond, it folds back: points that lie far outside would show up in the picture a second time.
    """
    if lens is None:
        return np.inf
    if lens.model == "fisheye":
        angles = np.linspace(0, np.arctan(_WIDEST_TANGENT), _STEPS)
        k1, k2, k3, k4 = lens.coefficients
        a2 = angles**2
        bent = angles * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
        return float(np.tan(angles[_rising(bent)]))
    k1, k2, _, _, k3, k4, k5, k6 = (*lens.coefficients, *[0.0] * 8)[:8]
    radii = np.geomspace(1e-3, _WIDEST_TANGENT, _STEPS)
    r2 = radii**2
    above, below = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    return float(radii[_rising(np.where(below > 0, radii * above / np.where(below > 0, below, 1), -1.0))])


def _rising(values: Float64[np.ndarray, " n"]) -> int:
    """Index of the last value before the first fall."""
    falls = np.flatnonzero(np.diff(values) <= 0)
    return int(falls[0]) if len(falls) else len(values) - 1
