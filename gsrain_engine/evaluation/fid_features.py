"""What turns a picture into features, under the name that its distance may carry: only Inception's is FID."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from PIL import Image


@dataclass(frozen=True, slots=True, kw_only=True)
class Extractor:
    """Features of one picture at a time, so that they don't depend on what else is looked at."""

    metric: str
    """What the Frechet distance of these features is called: FID, or "FD-" and a name."""
    described: str
    """Network, weights with their hash, and size of its input."""
    features: int
    """Numbers a picture."""
    key: str | None
    """Tells features of this extractor from those of others; None where they are not worth keeping."""
    function: Callable[[UInt8[np.ndarray, "h w 3"]], Float32[np.ndarray, " d"]]

    @property
    def kernel_metric(self) -> str:
        """What the kernel distance of these features is called: KID of Inception's alone, else "KD-" and the name."""
        return "KID" if self.metric == "FID" else self.metric.replace("FD-", "KD-", 1)

    def __call__(self, image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
        """Return the features of a picture in display values."""
        return self.function(image)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtractorChoice:
    """Which extractor, and where its weights come from."""

    name: str = "inception"
    weights: Path | None = None
    """A file; None looks where this machine keeps weights."""
    device: str = "cpu"
    """As torch calls it: cpu, cuda."""
    allows_torchscript: bool = False
    """Whether a TorchScript file of Inception may be run: it is a program, not only numbers."""


# § Brings a picture to the size that a network takes, as clean-fid does: filtered, in float, without rounding.


def resized(image: UInt8[np.ndarray, "h w 3"], width: int, height: int) -> Float32[np.ndarray, "hr wr 3"]:
    """Return display values of 0..255 at another size; proportions are not kept, as FID does not keep them.

    Pillow's bicubic filter, each channel as float32, widened where the picture shrinks (so that nothing aliases), and
    cut to 0..255: what Parmar et al. 2022 ("On aliased resizing and surprising subtleties in GAN evaluation") call
    clean. The libraries' quick resizing skips pixels, which alone moves FID by several units.
    """
    channels = [Image.fromarray(np.ascontiguousarray(image[..., c], np.float32)) for c in range(3)]
    sized = [np.asarray(channel.resize((width, height), Image.Resampling.BICUBIC)) for channel in channels]
    return np.clip(np.stack(sized, axis=2), 0, 255).astype(np.float32)


# § Plain numbers of a picture's sixteen cells, which need no weights: the features of "FD-pixels16".

CELLS = 4

SIZE_PX = 128

PER_CELL = 10

FEATURES = CELLS * CELLS * PER_CELL


def cell_statistics(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " d"]:
    """Return 160 numbers: colour, its spread, and edges by direction, of each of 4 x 4 cells.

    Of the picture at 128 x 128 (`resized`), in display values of 0..1: means and deviations of the three channels, and
    the mean square gradient of their mean along four directions (0, 45, 90, 135 degrees), as roots. It sees brightness,
    colour, contrast and texture, and nothing of what is shown: for tests, and where there are no weights.
    """
    values = resized(image, SIZE_PX, SIZE_PX).astype(np.float64) / 255
    across, down = np.gradient(values.mean(axis=2), axis=(1, 0))
    slopes = np.stack([across, (across + down) / np.sqrt(2), down, (down - across) / np.sqrt(2)], axis=2)
    parts = (_means(values), _deviations(values), np.sqrt(_means(slopes**2)))
    return np.concatenate(parts, axis=2).reshape(-1).astype(np.float32)


def _means(values: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "cells cells c"]:
    height, width, channels = values.shape
    return values.reshape(CELLS, height // CELLS, CELLS, width // CELLS, channels).mean(axis=(1, 3))


def _deviations(values: Float64[np.ndarray, "h w c"]) -> Float64[np.ndarray, "cells cells c"]:
    return np.sqrt(np.maximum(_means(values**2) - _means(values) ** 2, 0))
