"""Files of Gaussians as road users."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gsrain_engine.scene.bounds import robust_bounds
from gsrain_engine.scene.formats.gaussian_files import read_gaussians
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.street.cars import vehicle_shadow
from gsrain_engine.scene.street.daylight import Daylight
from gsrain_engine.scene.street.parameters import StreetParameters
from gsrain_engine.scene.street.splatting import gaussians_of

from .look import UserLook

_SHARE = 0.995
"""Share of the opacity along each axis that a model's box holds: captures have strays."""
_OPAQUE = 0.2
"""Fainter Gaussians say nothing about a model's size."""
_LEAST_M, _MOST_M = 0.1, 30.0


def model_of_file(path: Path) -> UserLook:
    """Read a model in metres (x forward, y left, z up), stand it on the ground, and give it a soft shadow there.

    Its box is where nearly all of what is opaque in it lies; the middle of its foot becomes the origin. The last few
    files are kept as long as they do not change. Raises ValueError for what can't be a road user.
    """
    known = path.stat()
    return _read(path, known.st_mtime_ns, known.st_size)


@lru_cache(maxsize=16)
def _read(path: Path, changed_ns: int, size: int) -> UserLook:
    gaussians = read_gaussians(path)
    opaque = gaussians.take(np.flatnonzero(gaussians.opacities >= _OPAQUE))
    if not len(opaque):
        raise ValueError(f"{path}: nothing in it can be seen, so it can't be a road user")
    low, high = robust_bounds(opaque, share=_SHARE)
    length, width, height = (float(side) for side in high - low)
    if not all(_LEAST_M <= side <= _MOST_M for side in (length, width, height)):
        raise ValueError(
            f"{path}: {length:.3g} x {width:.3g} x {height:.3g} m is no road user's size; a model is in metres, each "
            f"side {_LEAST_M:g} to {_MOST_M:g} m"
        )
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]], np.float32)
    standing = replace(gaussians, means=gaussians.means - foot)
    return UserLook(Gaussians.concatenate([_shadow(length, width), standing]), (length, width, height))


def _shadow(length: float, width: float) -> Gaussians:
    return gaussians_of(vehicle_shadow(length, width), Daylight.over(StreetParameters()))
