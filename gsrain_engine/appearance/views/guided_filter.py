"""Smooths values along the edges of a picture: a guided filter (He, Sun and Tang 2013), where values are known."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32


def guided(
    values: Float32[np.ndarray, "h w"],
    guide: Float32[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    radius_px: int,
    spread: float,
) -> Float32[np.ndarray, "h w"]:
    """Fit values by a linear function of the guide's colour in each window, and take the mean of the fits.

    Args:
        values: What is smoothed.
        guide: Display colour, 0..1.
        known: Where values count; elsewhere they are told by those around.
        radius_px: Of the windows.
        spread: Deviation of colour below which nothing is taken for an edge.
    """
    side = (2 * radius_px + 1, 2 * radius_px + 1)

    def mean(each: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.blur(each, side, borderType=cv2.BORDER_REFLECT))

    weight = known.astype(np.float32)
    total = np.maximum(mean(weight), 1e-6)
    color = mean(guide * weight[..., None]) / total[..., None]
    value = mean(values * weight) / total
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    covariance = np.zeros((*values.shape, 3, 3), np.float32)
    for i, j in pairs:
        product = mean(guide[..., i] * guide[..., j] * weight) / total - color[..., i] * color[..., j]
        covariance[..., i, j] = covariance[..., j, i] = product
    covariance[..., range(3), range(3)] += np.float32(spread**2)
    with_value = mean(guide * (values * weight)[..., None]) / total[..., None] - color * value[..., None]
    slope = np.linalg.solve(covariance, with_value[..., None])[..., 0]
    offset = value - (slope * color).sum(axis=-1)
    told = (mean(weight) > 1e-6).astype(np.float32)  # windows in which anything is known have a say
    fitted = (mean(slope * told[..., None]) * guide).sum(axis=-1) + mean(offset * told)
    return (fitted / np.maximum(mean(told), 1e-6)).astype(np.float32)
