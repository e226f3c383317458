"""Surface normals of a view: from depth, between axis conventions, and as a gray guide channel.

World axes are z up, camera axes OpenCV.
"""

from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..safe_io.errors import MissingInputsError, not_found
from ..scene.camera import Camera
from .base import Image, Plane
from .dsine_checkout import find_dsine_checkout, find_dsine_weights

_SMOOTHING_PX = 2.0  # scale at which slopes are averaged, because the expected depth of splats is bumpy
_EDGE_RATIO, _NOISE_SHARE = 3.0, 0.01
"""A step that exceeds the one on the other side by this ratio, and the noise, is an object edge."""


def view_rays(camera: Camera) -> Float[np.ndarray, "h w 3"]:
    """World directions through the pixel centers, one meter of view depth long: point = eye + depth * ray."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    return rays @ camera.world_to_camera[:3, :3]


def view_directions(camera: Camera) -> Float[np.ndarray, "h w 3"]:
    """Unit world directions through the pixel centers."""
    rays = view_rays(camera)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def world_points(depth: Plane, camera: Camera) -> Float[np.ndarray, "h w 3"]:
    """World position of each pixel's surface, in meters; `depth` along the view axis in meters."""
    return camera.position + depth[..., None].astype(np.float64) * view_rays(camera)


def normals_from_depth(depth: Plane, camera: Camera) -> Image:
    """Unit world normals towards the eye; zero where depth is 0.

    For a plane n . point = 1 (camera axes), inverse depth is linear in the image with gradient (n_x / fx, n_y / fy),
    so slopes of inverse depth are averaged.
    """
    known = depth > 0
    inverse = np.where(known, 1 / np.where(known, depth, 1), 0).astype(np.float64)
    along_u, along_v = (_averaged(_slope(inverse, known, axis), known) for axis in (1, 0))
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    away_x, away_y = along_u * camera.fx, along_v * camera.fy
    away = np.stack([away_x, away_y, inverse - away_x * x - away_y * y], axis=-1)
    away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
    return (-away @ camera.world_to_camera[:3, :3] * known[..., None]).astype(np.float32)


def _slope(inverse: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "h w"]:
    """Mean of the differences to both neighbors, or to one of them if the other lies beyond an edge."""
    steps = np.diff(inverse, axis=axis)
    edge = np.zeros_like(np.take(inverse, [0], axis=axis))
    is_step = np.diff(known.astype(np.int8), axis=axis) == 0
    no_step = np.zeros(edge.shape, bool)
    ahead, behind = np.concatenate([steps, edge], axis=axis), np.concatenate([edge, steps], axis=axis)
    may_ahead = np.concatenate([is_step, no_step], axis=axis)
    may_behind = np.concatenate([no_step, is_step], axis=axis)
    noise = _NOISE_SHARE * inverse
    use_ahead = may_ahead & (~may_behind | (np.abs(ahead) <= _EDGE_RATIO * np.abs(behind) + noise))
    use_behind = may_behind & (~may_ahead | (np.abs(behind) <= _EDGE_RATIO * np.abs(ahead) + noise))
    return (ahead * use_ahead + behind * use_behind) / np.maximum(use_ahead.astype(int) + use_behind, 1)


def _averaged(values: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Gaussian mean over the known pixels."""
    weight = scipy.ndimage.gaussian_filter(known.astype(np.float64), _SMOOTHING_PX, mode="nearest")
    return scipy.ndimage.gaussian_filter(values * known, _SMOOTHING_PX, mode="nearest") / np.maximum(weight, 1e-6)


def right_down_outward(normals: Float[np.ndarray, "h w 3"], camera: Camera) -> Image:
    """Turn world normals towards the eye into camera axes (x right, y down, z forward) away from the eye.

    DSINE's convention (Bae and Davison 2024): a wall that faces the camera has (0, 0, 1), the ground (0, 1, 0).
    """
    return (-(normals @ camera.world_to_camera[:3, :3].T)).astype(np.float32)


# Gray guide channel of normals, -1 to 1

GuideKind = Literal["up", "luma"]
_LUMA = np.array([0.299, 0.587, 0.114])  # Rec. 601, as in Pillow's mode L.


def normals_to_gray(normals: Float[np.ndarray, "h w 3"], camera: Camera, kind: GuideKind = "up") -> Plane:
    """Return the guide of unit world normals (z up) towards the eye; 0 where normals are 0 (unknown or sky).

    `up` is their upward part: 1 on level ground, 0 on walls, for any camera orientation. `luma` is the luma of a normal
    map, (n + 1) / 2 with n in camera axes away from the eye, scaled to -1..1: 0.587 on level ground for a level
    camera, 0.114 on a wall that faces it. The paper doesn't specify how it turns normals to gray; both are readings.
    """
    if kind == "up":
        return np.clip(normals[..., 2], -1, 1).astype(np.float32)
    return np.clip(right_down_outward(normals, camera) @ _LUMA, -1, 1).astype(np.float32)


# Estimators for images without depth


@runtime_checkable
class NormalEstimator(Protocol):
    """Model that estimates surface normals from an image."""

    def normals(self, image: Image, camera: Camera) -> Image:
        """Return unit world normals (z up) towards the eye, from a display image (0..1); results are deterministic.

        `camera` has no lens distortion and the image's size.
        """
        ...


ESTIMATORS = ("dsine", "marigold")
_MARIGOLD = "a folder with the model (hf download prs-eth/marigold-normals-v1-1 --local-dir FOLDER)"


def missing_estimator_files(name: str, weights: Path | str | None, checkout: Path | str | None = None) -> list[str]:
    """Name the missing files of an estimator of `ESTIMATORS`, each with how to get it and the option that names it."""
    weights, checkout = (None if each is None else Path(each) for each in (weights, checkout))
    if name == "marigold":
        if weights is None:
            return [f"marigold needs weights, --normals-weights DIR (normals_weights): {_MARIGOLD}"]
        return [] if weights.exists() else [f"{weights}: no such file or folder; marigold needs {_MARIGOLD}"]
    return [*not_found(find_dsine_weights, weights), *not_found(find_dsine_checkout, checkout)]


def open_estimator(
    name: str, weights: Path | str | None, checkout: Path | str | None = None, device: str = "cpu"
) -> NormalEstimator:
    """Open an estimator by its name in `ESTIMATORS`, with weights from disk.

    Without paths, DSINE's files are those of `find_dsine_weights` and `find_dsine_checkout`. Raises ValueError for an
    unknown name and a file that the estimator can't read, `MissingInputsError` for missing files.
    """
    if name not in ESTIMATORS:
        raise ValueError(f"no normal estimator {name!r}; there are {', '.join(ESTIMATORS)}")
    if missing := missing_estimator_files(name, weights, checkout):
        raise MissingInputsError(missing)
    from .normal_models import open_dsine, open_marigold  # loads torch

    weights, checkout = (None if each is None else Path(each) for each in (weights, checkout))
    if name == "marigold":
        assert weights is not None
        return open_marigold(weights, device)
    return open_dsine(find_dsine_checkout(checkout), find_dsine_weights(weights), device)
