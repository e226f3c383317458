"""How much light water mirrors: Fresnel's law for unpolarized light."""

from math import erfc, exp, pi, sqrt
from typing import no_type_check

import numba

WATER_INDEX = 1.333
"""Refractive index of water in visible light at 20 C."""


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def reflectance(cosine, index):
    """Share of unpolarized light that a smooth dielectric mirrors (Fresnel 1823): the mean over both polarizations.

    `cosine` is that of the angle between ray and normal, 0 to 1; `index` the refractive index of the inside.
    """
    inside = sqrt(max(1 - (1 - cosine * cosine) / (index * index), 0.0))
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return 0.5 * (across * across + along * along)


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def unshadowed(cosine, slope):
    """Share of a rough surface's facets that a ray this flat meets unhindered (Smith 1967, Gaussian slopes).

    `cosine` is that of the angle to the mean normal, `slope` the facets' standard deviation of slope along the ray.
    """
    if cosine <= 0:
        return 0.0
    if slope <= 0 or cosine >= 1:
        return 1.0
    v = cosine / sqrt(1 - cosine * cosine) / (sqrt(2.0) * slope)
    if v > 4:
        return 1.0
    return 1 / (1 + 0.5 * (exp(-v * v) / (v * sqrt(pi)) - erfc(v)))
