"""Quads to Gaussians: one flat Gaussian a quad, with its light baked into spherical harmonics."""

import numpy as np
from jaxtyping import Float, Float32

from ..gaussians import SH_C0, Gaussians
from ..rotations import quaternions_from_matrices
from .daylight import Daylight
from .quads import Quads, geometric_normals

SH_C1 = 0.4886025119029199
"""Spherical harmonics of degree 1, sqrt(3/(4 pi)), in the sign of 3DGS: -y, z, -x."""
_THICKNESS = 0.02
"""Standard deviation across a surface, as a share of the smaller one within it."""


def gaussians_of(quads: Quads, light: Daylight) -> Gaussians:
    """Turn quads into Gaussians, in order. Glossy sets get spherical harmonics of degree 1, matte ones degree 0."""
    scales, quaternions = _ellipses(quads)
    colors = light.display_colors(quads, quads.centers)
    return Gaussians(quads.centers, scales, quaternions, quads.opacity, _harmonics(quads, colors, light))


def shown_colors(
    quads: Quads, light: Daylight, matte: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n 3"]:
    """Display colour of quads seen along unit directions (eye to quad), as their Gaussians show it."""
    constant, linear = light.gloss_of(quads.normals)
    mirrored = constant + np.einsum("nd,ndc->nc", directions, linear)
    return np.clip(matte + quads.gloss[:, None] * mirrored, 0, 1).astype(np.float32)


def _ellipses(quads: Quads) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n 4"]]:
    """Axes of each cell: those of the covariance of a parallelogram, scaled by the cell's spread."""
    c = quads.corners.astype(np.float64)
    u = 0.5 * (c[:, 1] + c[:, 2] - c[:, 0] - c[:, 3]) * quads.spread[:, :1]
    v = 0.5 * (c[:, 2] + c[:, 3] - c[:, 0] - c[:, 1]) * quads.spread[:, 1:]
    normal = geometric_normals(c)
    longer = np.where((np.sum(u * u, axis=1) >= np.sum(v * v, axis=1))[:, None], u, v)
    first = longer - np.sum(longer * normal, axis=1, keepdims=True) * normal
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    second = np.cross(normal, first)
    u1, u2, v1, v2 = (np.sum(a * b, axis=1) for a in (u, v) for b in (first, second))
    xx, xy, yy = u1 * u1 + v1 * v1, u1 * u2 + v1 * v2, u2 * u2 + v2 * v2
    turn = 0.5 * np.arctan2(2 * xy, xx - yy)
    middle, swing = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    large, small = np.sqrt(middle + swing), np.sqrt(np.maximum(middle - swing, 1e-8))
    cosine, sine = np.cos(turn)[:, None], np.sin(turn)[:, None]
    rotation = np.stack([cosine * first + sine * second, cosine * second - sine * first, normal], axis=2)
    scales = np.stack([large, small, np.maximum(_THICKNESS * small, 5e-4)], axis=1)
    return scales.astype(np.float32), quaternions_from_matrices(rotation).astype(np.float32)


def _harmonics(quads: Quads, colors: Float32[np.ndarray, "n 3"], light: Daylight) -> Float32[np.ndarray, "n k 3"]:
    if not np.any(quads.gloss > 0):
        return ((colors - np.float32(0.5)) / np.float32(SH_C0))[:, None, :]
    constant, linear = light.gloss_of(quads.normals)
    sh = np.zeros((len(quads), 4, 3))
    sh[:, 0] = (colors + quads.gloss[:, None] * constant - 0.5) / SH_C0
    sh[:, 1:] = quads.gloss[:, None, None] * linear[:, [1, 2, 0]] * np.array([[-1.0], [1.0], [-1.0]]) / SH_C1
    return sh.astype(np.float32)
