"""The affine map of colour between two pictures of the same thing."""

import numpy as np
from jaxtyping import Bool, Float, Float64

_PULL = 1e-3
"""Tikhonov pull towards no change, in squared colour a pixel: what a picture without contrast can't tell."""


def fitted_affine(
    rendered: Float[np.ndarray, "h w 3"], truth: Float[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"]
) -> Float64[np.ndarray, "3 4"]:
    """Map of colour that takes rendered pixels nearest to true ones, by least squares; no change without pixels."""
    identity = np.eye(3, 4)
    there = rendered[mask].astype(np.float64)
    basis = np.concatenate([there, np.ones((len(there), 1))], axis=1)
    normal = basis.T @ basis + _PULL * len(there) * np.eye(4)
    wanted = basis.T @ (truth[mask].astype(np.float64) - there)
    return identity + np.linalg.solve(normal, wanted).T if len(there) else identity


def with_affine(picture: Float[np.ndarray, "h w 3"], affine: Float64[np.ndarray, "3 4"]) -> Float[np.ndarray, "h w 3"]:
    """Map a picture's display colours; the result is cut to 0..1."""
    return np.clip(picture @ affine[:, :3].T + affine[:, 3], 0, 1).astype(picture.dtype)
