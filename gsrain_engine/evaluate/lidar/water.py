"""Water in near infrared: what a drop sends straight back, and what a film of it takes from a wet road."""

import numpy as np
from jaxtyping import Float, Float64

REFRACTIVE_INDEX = {905: 1.327, 1550: 1.318}
"""Of water, at wavelengths in nm (Hale and Querry 1973, Applied Optics 12)."""

ABSORPTION_PER_MM = {905: 0.007, 1550: 1.09}
"""Of water: 4 pi k / wavelength with k = 5.0e-7 and 1.35e-4 (Hale and Querry 1973; Kou, Labrie and Chylek 1993)."""

_MIRRORED_INSIDE = 0.472
"""Share of diffuse light under a flat water surface that is mirrored back down, n = 1.33 (Saunderson 1942)."""


def drop_reflectance(diameter_mm: Float[np.ndarray, "*n"], wavelength_nm: int) -> Float64[np.ndarray, "*n"]:
    """Reflectance of a matt disc with a drop's shadow that would send back as much: 0.005..0.025.

    Geometric optics of a sphere, axial rays: those that its front mirrors, F / 4, and those that its back mirrors,
    (1 - F)^2 F (n / (2 - n))^2 / 4, weakened by the water that they pass twice; F = ((n - 1) / (n + 1))^2. A disc of
    reflectance rho has the radar cross-section 4 rho A, a sphere's mirrored front F A (van de Hulst 1957, chapter 12).
    At 1550 nm water is so dark that drops above a millimetre keep the front's alone. The glory is left out: large
    drops are too flat and too restless for it.
    """
    n = REFRACTIVE_INDEX[wavelength_nm]
    front = ((n - 1) / (n + 1)) ** 2
    back = (1 - front) ** 2 * front * (n / (2 - n)) ** 2
    passed = np.exp(-2 * ABSORPTION_PER_MM[wavelength_nm] * np.asarray(diameter_mm, np.float64))
    return (front + back * passed) / 4


def fresnel_reflectance(cosine: Float[np.ndarray, "*n"], index: float) -> Float64[np.ndarray, "*n"]:
    """Share of unpolarized light that a flat surface of water mirrors, by the cosine of incidence; 0..1 (Fresnel)."""
    inside = np.sqrt(1 - (1 - np.asarray(cosine, np.float64) ** 2) / index**2)
    across = ((cosine - index * inside) / (cosine + index * inside)) ** 2
    along = ((inside - index * cosine) / (inside + index * cosine)) ** 2
    return (across + along) / 2


def wet_road_share(
    cosine: Float[np.ndarray, "*n"],
    reflectance: Float[np.ndarray, "*n"],
    wetness: float,
    film_mm: float,
    wavelength_nm: int,
) -> Float64[np.ndarray, "*n"]:
    """Share of a dry road's echo that is left when it is wet, 0..1.

    Where water stands, a beam crosses its surface twice, (1 - F)^2, spreads on leaving it, 1 / n^2, and is partly
    mirrored back onto the road, 1 / (1 - 0.472 rho): a matt ground under a flat film (Saunderson 1942, Lekner and Dorf
    1988). The film absorbs on the slanted way down and up. What it mirrors goes on ahead and never comes back, which is
    why far, grazing returns vanish first. `cosine` of incidence, `reflectance` of the dry road; `wetness` is the share
    of it that is covered.
    """
    n = REFRACTIVE_INDEX[wavelength_nm]
    slant = np.sqrt(1 - (1 - np.asarray(cosine, np.float64) ** 2) / n**2)
    passed = np.exp(-2 * ABSORPTION_PER_MM[wavelength_nm] * film_mm / slant)
    under_film = (1 - fresnel_reflectance(cosine, n)) ** 2 * passed / (n**2 * (1 - _MIRRORED_INSIDE * reflectance))
    return 1 - wetness + wetness * under_film
