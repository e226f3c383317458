"""Optics of water on surfaces: wet albedo, Fresnel reflectance, and shadowing by rough facets."""

from math import erfc, exp, pi, sqrt
from typing import Any, TypeVar, no_type_check

from ..kernels import kernel

WATER_REFLECTANCE = 0.02
"""Reflectance of water at normal incidence (refractive index 1.33)."""
INTERNAL_REFLECTION = 0.55
"""Share of diffuse light that the water's surface reflects back down: 1 - (1 - 0.07) / 1.33^2, rounded up."""
WATER_INDEX = 1.333
"""Refractive index of water in visible light at 20 C."""

Albedo = TypeVar("Albedo")


def wet_albedo(albedo: Albedo) -> Albedo:
    """Diffuse albedo (0..1, number or array, per channel) under a film of water (Lekner and Dorf 1988).

    Light enters with 1 - R, is reflected by the surface with d, and repeatedly reflected back by the film with p:
    w = (1 - R) (1 - p) d / (1 - p d), without their change of index. Dark colors lose more than bright ones, so
    saturation grows too.
    """
    d: Any = albedo
    return (1 - WATER_REFLECTANCE) * (1 - INTERNAL_REFLECTION) * d / (1 - INTERNAL_REFLECTION * d)


@kernel(error_model="numpy")
@no_type_check
def reflectance(cosine, index):
    """Reflectance of a smooth dielectric for unpolarized light (Fresnel 1823): the mean over both polarizations.

    `cosine` is that of the angle between ray and normal, 0 to 1; `index` the refractive index of the inside.
    """
    inside = sqrt(max(1 - (1 - cosine * cosine) / (index * index), 0.0))
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return 0.5 * (across * across + along * along)


@kernel(error_model="numpy")
@no_type_check
def unshadowed(cosine, slope):
    """Share of a rough surface's facets that a ray reaches unshadowed (Smith 1967, Gaussian slopes).

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
