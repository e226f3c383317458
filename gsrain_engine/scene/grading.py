"""Colour grading: an affine change of display colours, so that it can be baked into harmonics exactly."""

from typing import Annotated

import msgspec
import numpy as np
from jaxtyping import Float32, Float64
from msgspec import Meta

_LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Rec. 709."""

_ENCODING = 2.2
"""Display values are about light to the power of 1/2.2, so a factor of light is this root of it in display values."""


class Grading(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is done to colours, in this order. The defaults change nothing."""

    exposure_ev: Annotated[
        float, Meta(ge=-6, le=6, title="Exposure", description="Stops brighter or darker.", extra={"unit": "EV"})
    ] = 0.0
    temperature: Annotated[
        float, Meta(ge=-1, le=1, title="Temperature", description="Blue to the left, amber to the right.")
    ] = 0.0
    tint: Annotated[float, Meta(ge=-1, le=1, title="Tint", description="Green to the left, magenta to the right.")] = (
        0.0
    )
    contrast: Annotated[
        float, Meta(ge=0, le=3, title="Contrast", description="Distance from middle grey; 1 changes nothing.")
    ] = 1.0
    saturation: Annotated[
        float, Meta(ge=0, le=3, title="Saturation", description="Distance from grey; 1 changes nothing, 0 is grey.")
    ] = 1.0

    @property
    def matrix(self) -> Float64[np.ndarray, "3 4"]:
        """Display colour c (0..1) becomes matrix[:, :3] @ c + matrix[:, 3]."""
        light = 2.0**self.exposure_ev * np.array(
            [2.0 ** (self.temperature + self.tint / 2), 2.0**-self.tint, 2.0 ** (-self.temperature + self.tint / 2)]
        )
        gains = np.diag(light ** (1 / _ENCODING))
        greyed = np.outer(np.ones(3), _LUMA)
        linear = (self.saturation * np.eye(3) + (1 - self.saturation) * greyed) @ (self.contrast * gains)
        return np.concatenate([linear, np.full((3, 1), 0.5 * (1 - self.contrast))], axis=1)


UNCHANGED = Grading()


def graded(sh: Float32[np.ndarray, "n k 3"], matrix: Float64[np.ndarray, "3 4"]) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics of colours after an affine change; the colours are sums of harmonics + 0.5, as in 3DGS."""
    changed = sh.astype(np.float64) @ matrix[:, :3].T
    changed[:, 0] += (matrix @ np.array([0.5, 0.5, 0.5, 1.0]) - 0.5) / _FIRST
    return changed.astype(np.float32)


_FIRST = 0.28209479177387814
"""The first harmonic, 1/(2 sqrt(pi))."""
