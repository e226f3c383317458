"""Image metrics: PSNR, SSIM, affine color fits, and comparisons of views."""

from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float64, UInt8

from ..report.charts import ImageComparison

Image = Float[np.ndarray, "h w 3"]
Mask = Bool[np.ndarray, "h w"]
ImageDistance = Callable[[Image, Image, Mask | None], float]
"""Distance of a render and the ground truth (0..1) over a mask, such as `Lpips.distance`."""

_PRIOR_WEIGHT = 1e-3  # tikhonov weight toward the identity, in squared color per pixel, for images without contrast


def fitted_affine(rendered: Image, truth: Image, mask: Mask) -> Float64[np.ndarray, "3 4"]:
    """Least-squares affine color map from rendered to true pixels; the identity without pixels."""
    identity = np.eye(3, 4)
    pixels = rendered[mask].astype(np.float64)
    basis = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
    normal = basis.T @ basis + _PRIOR_WEIGHT * len(pixels) * np.eye(4)
    change = basis.T @ (truth[mask].astype(np.float64) - pixels)
    return identity + np.linalg.solve(normal, change).T if len(pixels) else identity


def with_affine(picture: Image, affine: Float64[np.ndarray, "3 4"]) -> Image:
    """Map an image's display colors; the result is clipped to 0..1."""
    return np.clip(picture @ affine[:, :3].T + affine[:, 3], 0, 1).astype(picture.dtype)


# PSNR and SSIM

WINDOW_PX = 11
WINDOW_SIGMA_PX = 1.5
C1, C2 = 0.01**2, 0.03**2  # window and constants of Wang et al. 2004, for values of 0..1
HALF_WINDOW_PX = WINDOW_PX // 2
MIN_WEIGHT = 1e-8  # minimum window weight within the mask for a comparison
_BAND_ROWS = 32  # rows per band: SSIM runs in bands whose intermediate results fit into the CPU cache


def window() -> Float64[np.ndarray, " k"]:
    """Return the taps of SSIM's Gaussian window along one axis; they add up to 1."""
    offsets = np.arange(WINDOW_PX) - HALF_WINDOW_PX
    taps = np.exp(-0.5 * (offsets / WINDOW_SIGMA_PX) ** 2)
    return taps / taps.sum()


def check_pair(first: tuple[int, ...], second: tuple[int, ...], mask: tuple[int, ...] | None) -> None:
    """Raise ValueError for shapes of images and mask that can't be compared."""
    if first != second or len(first) != 3:
        raise ValueError(f"pictures of one size are compared, not {_size(first)} with {_size(second)}")
    if mask is not None and mask != first[:2]:
        raise ValueError(f"the mask is {_size(mask)}, the pictures are {_size(first)}")


def _size(shape: tuple[int, ...]) -> str:
    """Width and height for messages, and the number of channels unless three."""
    if len(shape) < 2:
        return f"a row of {shape[0]}" if shape else "a number"
    channels = "" if shape[2:] in ((), (3,)) else f" with {shape[2]} channels"
    return f"{shape[1]}x{shape[0]} px{channels}"


def psnr(rendered: Image, truth: Image, mask: Mask | None = None) -> float:
    """Peak signal-to-noise ratio, 10 log10(1 / mean squared difference) in dB, of values of 0..1.

    From 0 (black against white) to infinity (equal); higher is better. Over the pixels of the mask and all channels.
    Raises ValueError for different shapes and for an empty mask.
    """
    check_pair(rendered.shape, truth.shape, None if mask is None else mask.shape)
    squares = (rendered.astype(np.float64) - truth) ** 2
    chosen = squares if mask is None else squares[mask]
    if chosen.size == 0:
        raise ValueError("the mask leaves no pixel to compare")
    mean = float(chosen.mean())
    return float("inf") if mean == 0 else -10 * float(np.log10(mean))


def ssim(rendered: Image, truth: Image, mask: Mask | None = None) -> float:
    """Structural similarity of values of 0..1: the mean of `ssim_map` over the pixels of the mask.

    Wang et al. 2004, eq. 13; unitless, from -1 to 1 (equal); higher is better.
    """
    similarity = ssim_map(rendered, truth, mask)
    if mask is None:
        return float(similarity.mean())
    inside = _valid(mask)
    if not inside.any():
        raise ValueError("the mask leaves no pixel to compare")
    return float(similarity[inside].mean())


def ssim_map(rendered: Image, truth: Image, mask: Mask | None = None) -> Float64[np.ndarray, "hv wv 3"]:
    """Structural similarity around each pixel (Wang et al. 2004, eq. 13), for each channel.

    Windows that cross the edge are excluded, as in the paper: the map is 10 px smaller than the image. Pixels outside
    the mask have no weight in any window. Raises ValueError for different shapes and for images smaller than the
    window.
    """
    check_pair(rendered.shape, truth.shape, None if mask is None else mask.shape)
    if min(rendered.shape[:2]) < WINDOW_PX:
        raise ValueError(f"SSIM takes pictures of at least {WINDOW_PX} px a side, not {_size(rendered.shape)}")
    tops = range(0, len(rendered) - 2 * HALF_WINDOW_PX, _BAND_ROWS)
    bands = [slice(top, top + _BAND_ROWS + 2 * HALF_WINDOW_PX) for top in tops]
    return np.concatenate([_similarity(rendered[b], truth[b], None if mask is None else mask[b]) for b in bands])


def _similarity(rendered: Image, truth: Image, mask: Mask | None) -> Float64[np.ndarray, "hv wv 3"]:
    x, y = rendered.astype(np.float64), truth.astype(np.float64)
    weights = None if mask is None else mask.astype(np.float64)[..., None]

    def mean(values: Float64[np.ndarray, "h w 3"]) -> Float64[np.ndarray, "hv wv 3"]:
        if weights is None:
            return _blurred(values)
        return _blurred(values * weights) / np.maximum(_blurred(weights), MIN_WEIGHT)

    mean_x, mean_y = mean(x), mean(y)
    variance_x, variance_y = mean(x * x) - mean_x**2, mean(y * y) - mean_y**2
    covariance = mean(x * y) - mean_x * mean_y
    likeness = (2 * mean_x * mean_y + C1) * (2 * covariance + C2)
    return likeness / ((mean_x**2 + mean_y**2 + C1) * (variance_x + variance_y + C2))


def _blurred(values: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "hv wv c"]:
    whole = cv2.sepFilter2D(values, -1, window(), window(), borderType=cv2.BORDER_CONSTANT)
    return _valid(whole.reshape(values.shape))  # OpenCV drops the axis of a single channel


def _valid(values: np.ndarray) -> np.ndarray:
    return values[HALF_WINDOW_PX:-HALF_WINDOW_PX, HALF_WINDOW_PX:-HALF_WINDOW_PX]


# Comparison of one view, for a report

WIDEST_PX = 640


def compare_images(
    name: str, rendered: Image, truth: Image, mask: Mask | None = None, lpips: ImageDistance | None = None
) -> ImageComparison:
    """Compare a render with the ground truth, values of 0..1, over the pixels of the mask."""
    error = np.abs(rendered.astype(np.float32) - truth.astype(np.float32)).mean(axis=2)
    small = _small(error)
    if mask is not None:
        share = _small(mask.astype(np.float32))
        small = np.where(share > 0.5, _small(np.where(mask, error, 0)) / np.maximum(share, 0.5), np.nan)
    distance = None if lpips is None else lpips(rendered, truth, mask)
    metrics = psnr(rendered, truth, mask), ssim(rendered, truth, mask), distance
    return ImageComparison(name, _bytes(rendered), _bytes(truth), small.astype(np.float32), *metrics)


def _small(values: np.ndarray) -> np.ndarray:
    height, width = values.shape[:2]
    if width <= WIDEST_PX:
        return values
    size = WIDEST_PX, max(round(height * WIDEST_PX / width), 1)
    return cv2.resize(values, size, interpolation=cv2.INTER_AREA)


def _bytes(image: Image) -> UInt8[np.ndarray, "hs ws 3"]:
    return np.rint(np.clip(_small(image.astype(np.float32)), 0, 1) * 255).astype(np.uint8)
