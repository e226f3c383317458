"""Mie phase functions of rain and fog: writes gsrain_engine/rain/phase_functions.npy. Needs miepython.

Unpolarized light of three wavelengths, on spheres of water. Rain has the drop sizes of the default calibration at
`RATES_MM_H`, fog a gamma law of radii. Each row is an average over scattering cross-sections, sizes and wavelengths,
and over the solid angle around each of its angles. Its first number is what 4 pi leaves to the forward peak, since rain
diffracts by hundredths of a degree.

    .venv/bin/python -m benchmarks.phase_functions
"""

import json
import os
import sys
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.phase import ANGLES, RATES_MM_H, TABLE, asymmetry, sphere_weights
from gsrain_engine.rain.properties import rain_properties
from gsrain_engine.rain.settings import RainSettings

os.environ.setdefault("MIEPYTHON_USE_JIT", "1")  # read when miepython is first imported

WAVELENGTHS_UM = (0.45, 0.55, 0.65)
REFRACTIVE_INDICES = (1.337, 1.333, 1.331)  # of water (Hale and Querry 1973)
FOG_SHAPE, FOG_PER_UM = 3.0, 0.6
"""Number of droplets by radius r: r^3 exp(-0.6 r / um), with the mode at 5 um and an effective radius of 10 um; between
the radiation and the advection fogs of Shettle and Fenn (1979)."""
_PARTS = 6  # angles for each one of the table


def main(sizes: int = 900) -> None:
    """Write the table and print the asymmetry of each row."""
    diameters_um, radii_um = np.geomspace(150.0, 6000.0, sizes), np.linspace(0.25, 45.0, 4 * sizes)
    drops, droplets = MieLight.of(diameters_um, all_angles()), MieLight.of(2 * radii_um, all_angles())
    rows = [drops.row(rain_numbers(diameters_um, rate)) for rate in RATES_MM_H]
    rows.append(droplets.row(fog_numbers(radii_um)))
    np.save(TABLE, np.array(rows, np.float32))
    json.dump({"asymmetry": [round(asymmetry(row), 4) for row in rows]}, sys.stdout)


def all_angles() -> Float64[np.ndarray, "a p"]:
    """Scattering angles (radians) around each angle of the table, at equal steps."""
    step = np.pi / (ANGLES - 1)
    around = ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5) * step
    angles = np.abs(np.arange(ANGLES)[:, None] * step + around)
    return np.where(angles > np.pi, 2 * np.pi - angles, angles)


def rain_numbers(diameters_um: Float64[np.ndarray, " n"], rate_mm_h: float) -> Float64[np.ndarray, " n"]:
    """Relative number of drops by diameter, at equal steps of its logarithm."""
    rain = RainSettings(intensity_mm_h=rate_mm_h)
    sizes = rain_properties(rain, load_calibration(rain.calibration)).sizes
    return sizes.probability_per_mm(1e-3 * diameters_um) * diameters_um


def fog_numbers(radii_um: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Relative number of droplets by radius, at equal steps."""
    return radii_um**FOG_SHAPE * np.exp(-FOG_PER_UM * radii_um)


class MieLight:
    """Light that drops scatter, by diameter; the wavelength changes from one to the next, so that many are a band."""

    def __init__(self, light: Float64[np.ndarray, "n a"], areas: Float64[np.ndarray, " n"]) -> None:
        self.light, self.areas = light, areas

    @classmethod
    def of(cls, diameters_um: Float64[np.ndarray, " n"], angles: Float64[np.ndarray, "a p"]) -> "MieLight":
        """Compute phase functions (integral 4 pi) averaged over each row of angles, and scattering cross-sections."""
        import miepython  # optional: only this benchmark and its test use it

        library: Any = miepython
        light, areas = np.empty((len(diameters_um), len(angles))), np.empty(len(diameters_um))
        rings = np.sin(angles) / np.sin(angles).sum(axis=1, keepdims=True)
        for k, diameter_um in enumerate(diameters_um):
            band = k % len(WAVELENGTHS_UM)
            drop = complex(REFRACTIVE_INDICES[band]), np.pi * diameter_um / WAVELENGTHS_UM[band]
            found = library.i_unpolarized(*drop, np.cos(angles).ravel(), norm="4pi").reshape(angles.shape)
            light[k] = (found * rings).sum(axis=1)
            areas[k] = library.efficiencies_mx(*drop)[1] * diameter_um**2
        return cls(light, areas)

    def row(self, numbers: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " a"]:
        """Phase function of drops with these relative numbers, with 4 pi as its integral."""
        row = self.mean(numbers)
        weights = sphere_weights()
        row[0] = (4 * np.pi - weights[1:] @ row[1:]) / weights[0]
        return row

    def mean(self, numbers: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " a"]:
        """Mean over drops with these relative numbers, at each row of angles."""
        weights = numbers * self.areas
        return weights @ self.light / weights.sum()


if __name__ == "__main__":
    main()
