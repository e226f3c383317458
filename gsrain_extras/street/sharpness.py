"""Factors on the colors of Gaussians with which pictures of the built-in streets are as sharp as those of their mesh.

A Gaussian fades toward the end of its cell, where its neighbors and what is behind it show through. Its color can make
up for that: factors for which pictures along the drive have the least error from the mesh, also in the differences
between neighboring pixels, are kept in files beside this module. They hold for every light, dry and wet. A change of
the streets' geometry needs them anew: `python -m benchmarks.sharpen_street street street:dusk`.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int8
from msgspec import structs

from gsrain_engine.safe_io.files import whole_file
from gsrain_engine.scene.gaussians import SH_C0

from .layout import STREETS, StreetParameters

STEPS = 32
"""Steps of a factor from one power of 2 to the next."""
_LOWEST, _HIGHEST = 0.25, 2.0


def sharpness_file(parameters: StreetParameters) -> Path | None:
    """File of the built-in street with this geometry, which does not depend on the time of day."""
    for name in ("street", "street:dusk"):
        if structs.replace(STREETS[name], time_of_day=parameters.time_of_day) == parameters:
            return Path(__file__).parent / f"sharpness_{name.removeprefix('street:')}.npz"
    return None


def color_factors(parameters: StreetParameters) -> Mapping[str, Float32[np.ndarray, " n"]]:
    """Factors by layer and `LEAD_ID`; none for other streets than the built-in ones."""
    file = sharpness_file(parameters)
    if file is None:
        return {}
    with np.load(file, allow_pickle=False) as steps:
        return {key: np.exp2(steps[key].astype(np.float32) / STEPS) for key in steps.files}


def write_color_factors(file: Path, factors: Mapping[str, Float[np.ndarray, " n"]]) -> None:
    """Write factors by layer, rounded to steps."""
    steps = {key: _steps(each) for key, each in factors.items()}
    with whole_file(file) as written, written.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **steps)


def _steps(factors: Float[np.ndarray, " n"]) -> Int8[np.ndarray, " n"]:
    powers = np.log2(np.clip(factors, _LOWEST, _HIGHEST))
    return np.rint(STEPS * powers).astype(np.int8)


def sharpened(
    sh: Float32[np.ndarray, "n k 3"], factors: Float32[np.ndarray, " m"] | None
) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics whose constant color is multiplied; without factors, or with those of other Gaussians, as they are."""
    if factors is None or len(factors) != len(sh):
        return sh
    sharp = sh.copy()
    sharp[:, 0] += (factors[:, None] - 1) * (sh[:, 0] + np.float32(0.5 / SH_C0))
    return sharp
