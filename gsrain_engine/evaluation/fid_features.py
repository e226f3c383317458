"""Feature extractors for image distances, with weight-free cell statistics; only Inception's distance is named FID."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from PIL import Image


@dataclass(frozen=True, slots=True, kw_only=True)
class Extractor:
    """Features of one image at a time, independent of other images."""

    metric: str
    """Name of the Frechet distance of these features: FID, or "FD-" and a name."""
    described: str
    """Network, weights with their hash, and input size."""
    features: int
    key: str | None
    """Identifies this extractor's features in the cache; None if they are not worth caching."""
    function: Callable[[UInt8[np.ndarray, "h w 3"]], Float32[np.ndarray, " d"]]

    @property
    def kernel_metric(self) -> str:
        """Name of the kernel distance of these features: KID for Inception's alone, else "KD-" and the name."""
        return "KID" if self.metric == "FID" else self.metric.replace("FD-", "KD-", 1)

    def __call__(self, image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
        return self.function(image)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtractorChoice:
    """Choice of extractor and of its weights."""

    name: str = "inception"
    weights: Path | None = None
    """A file; None searches this machine's folders for weights."""
    device: str = "cpu"
    allows_torchscript: bool = False
    """Allow running a TorchScript file of Inception, which contains code, not only numbers."""


# Resizing as in clean-fid


def resized(image: UInt8[np.ndarray, "h w 3"], width: int, height: int) -> Float32[np.ndarray, "hr wr 3"]:
    """Return display values of 0..255 at another size; proportions are not kept, as in FID.

    Pillow's bicubic filter on each channel as float32, antialiased when downscaling, clipped to 0..255: the clean
    resizing of Parmar et al. 2022 ("On aliased resizing and surprising subtleties in GAN evaluation"). Libraries' fast
    resizing skips pixels, which alone shifts FID by several units.
    """
    channels = [Image.fromarray(np.ascontiguousarray(image[..., c], np.float32)) for c in range(3)]
    sized = [np.asarray(channel.resize((width, height), Image.Resampling.BICUBIC)) for channel in channels]
    return np.clip(np.stack(sized, axis=2), 0, 255).astype(np.float32)


# Cell statistics
# The features of "FD-pixels16", without network weights.

CELLS, SIZE_PX = 4, 128


def cell_statistics(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
    """Return 160 numbers: mean color, its spread, and edges by direction, of each of 4 x 4 cells.

    Computed on the image at 128 x 128 (`resized`), in display values of 0..1: means and deviations of the three
    channels, and the root mean square gradient of their mean along four directions (0, 45, 90, 135 degrees). They cover
    brightness, color, contrast and texture but no content: for tests, and if no weights are available.
    """
    values = resized(image, SIZE_PX, SIZE_PX).astype(np.float64) / 255
    across, down = np.gradient(values.mean(axis=2), axis=(1, 0))
    slopes = np.stack([across, (across + down) / np.sqrt(2), down, (down - across) / np.sqrt(2)], axis=2)
    means = _means(values)
    deviations = np.sqrt(np.maximum(_means(values**2) - means**2, 0))
    return np.concatenate((means, deviations, np.sqrt(_means(slopes**2))), axis=2).reshape(-1).astype(np.float32)


def _means(values: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "cells cells c"]:
    height, width, channels = values.shape
    return values.reshape(CELLS, height // CELLS, CELLS, width // CELLS, channels).mean(axis=(1, 3))
