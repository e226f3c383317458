"""Fall speed over diameter (paper, eq. 9): a quadratic through the mean speed of each diameter class."""

import numpy as np
from jaxtyping import Bool, Float64

from ..calibration import VelocityFit, atlas_velocity
from ..drop_sizes import LARGEST_MM

FEWEST_DROPS = 10
"""A class with fewer drops doesn't tell a mean speed."""

_DROPS_M_S = 0.8
"""By this much single drops of a class differ, as measured by a Parsivel and a 2DVD."""
_QUADRATIC_M_S = 0.2
"""By this much a quadratic misses real fall speeds: more drops in a class don't make it count more without end."""


def fitted_speeds(
    diameters_mm: Float64[np.ndarray, " classes"], drops: Float64[np.ndarray, " classes"]
) -> Bool[np.ndarray, " classes"]:
    """Classes that the quadratic goes through: at least `FEWEST_DROPS` drops, none larger than rain has."""
    return (drops >= FEWEST_DROPS) & (diameters_mm < LARGEST_MM)


def speed_weights(drops: Float64[np.ndarray, " classes"]) -> Float64[np.ndarray, " classes"]:
    """One over the standard error of each class's mean, in s/m: what `numpy.polyfit` takes."""
    return 1 / np.sqrt(_DROPS_M_S**2 / drops + _QUADRATIC_M_S**2)


def fit_velocity(
    diameters_mm: Float64[np.ndarray, " classes"],
    mean_speeds_m_s: Float64[np.ndarray, " classes"],
    drops: Float64[np.ndarray, " classes"],
) -> VelocityFit:
    """Weighted least squares through the classes' means; R^2 with the same weights.

    Weighted by drops alone it would follow the small ones. Raises `ValueError` with fewer than four classes to fit.
    """
    used = fitted_speeds(diameters_mm, drops)
    if used.sum() < 4:
        raise ValueError(
            f"fall speed: {used.sum()} diameter classes with at least {FEWEST_DROPS} drops, expected four or more"
        )
    d, v, w = diameters_mm[used], mean_speeds_m_s[used], speed_weights(drops[used])
    coefficients = np.polyfit(d, v, 2, w=w)
    unexplained = np.sum((w * (v - np.polyval(coefficients, d))) ** 2)
    spread = np.sum((w * (v - np.average(v, weights=w**2))) ** 2)
    a, b, c = (float(value) for value in coefficients)
    return VelocityFit(coefficients=(a, b, c), r2=float(1 - unexplained / spread))


def assumed_velocity() -> VelocityFit:
    """A quadratic through Atlas et al. (1973) from 0.3 to 5 mm, for instruments that measure no speed."""
    d = np.linspace(0.3, 5.0, 48)
    a, b, c = (float(value) for value in np.polyfit(d, atlas_velocity(d), 2))
    return VelocityFit(coefficients=(a, b, c))
