"""A render beside the truth: small pictures, where they differ, and by how much."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from ..image_metrics import psnr, ssim

WIDEST_PX = 640

Image = Float[np.ndarray, "h w 3"]
Distance = Callable[[Image, Image, Bool[np.ndarray, "h w"] | None], float]
"""Such as `Lpips.distance`: of a render, the truth, and a mask."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One view. The pictures are at most 640 px wide, the figures are those of the full size."""

    name: str
    rendered: UInt8[np.ndarray, "h w 3"]
    truth: UInt8[np.ndarray, "h w 3"]
    error: Float32[np.ndarray, "h w"]
    """Mean absolute difference of the channels, 0..1; NaN where the mask leaves the pixel out."""
    psnr_db: float
    ssim: float
    lpips: float | None = None

    @classmethod
    def measured(
        cls,
        name: str,
        rendered: Image,
        truth: Image,
        mask: Bool[np.ndarray, "h w"] | None = None,
        lpips: Distance | None = None,
    ) -> "Comparison":
        """Compare a render with the truth, values of 0..1, over the pixels of the mask."""
        error = np.abs(rendered.astype(np.float32) - truth.astype(np.float32)).mean(axis=2)
        small = _small(error)
        if mask is not None:
            seen = _small(mask.astype(np.float32))
            small = np.where(seen > 0.5, _small(np.where(mask, error, 0)) / np.maximum(seen, 0.5), np.nan)
        return cls(
            name,
            _bytes(rendered),
            _bytes(truth),
            small.astype(np.float32),
            psnr(rendered, truth, mask),
            ssim(rendered, truth, mask),
            None if lpips is None else lpips(rendered, truth, mask),
        )


def _small(values: np.ndarray) -> np.ndarray:
    height, width = values.shape[:2]
    if width <= WIDEST_PX:
        return values
    size = WIDEST_PX, max(round(height * WIDEST_PX / width), 1)
    return cv2.resize(values, size, interpolation=cv2.INTER_AREA)


def _bytes(image: Image) -> UInt8[np.ndarray, "hs ws 3"]:
    return np.rint(np.clip(_small(image.astype(np.float32)), 0, 1) * 255).astype(np.uint8)
