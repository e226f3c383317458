"""Spray in the beams of a lidar: light lost on the way, and echoes of whole clouds of fine drops."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ...water.spray import SprayParcels, depths_along
from .rain_echoes import RainReturns, drop_reflectance
from .sensor import Beams, LidarSensor

_REACH_SIGMAS = 4.0
_CHUNK = 16_384  # beams at once, to limit memory


class SprayInBeams(NamedTuple):
    """Spray on the way of each beam, and echoes of it that are detected."""

    transmittance: Float64[np.ndarray, " n"]
    """Share of light that arrives at a beam's clear echo, one way; 1 without an echo."""
    returns: RainReturns


def spray_in_beams(
    beams: Beams, sensor: LidarSensor, parcels: SprayParcels, extinction_per_m: float, seed: int
) -> SprayInBeams:
    """Find the echoes of spray, of all drops within half a pulse, and the loss of light behind it.

    Fine drops are too many in a beam to count: together they return `drop_reflectance` of what their cross-sections,
    half of the extinction, intercept. Between beams and pulses the echo fluctuates with an exponential distribution, as
    spray is patchy below the size of a parcel; our choice. `extinction_per_m` is that of the rain.
    """
    clear = np.where(beams.is_echo, beams.ranges_m, np.inf)
    transmittance = np.ones(len(beams))
    if not len(parcels):
        return SprayInBeams(transmittance, RainReturns.none())
    reach = np.linalg.norm(parcels.centers_m - beams.origin_m, axis=1) + _REACH_SIGMAS * parcels.sigmas_m
    step_m = sensor.pulse_m
    steps = int(np.ceil(min(float(reach.max()), sensor.farthest_m) / step_m)) + 1
    middles = step_m * (np.arange(steps) + 0.5)
    matt = float(
        np.average(drop_reflectance(parcels.diameters_mm, sensor.wavelength_nm), weights=parcels.extinction_m2)
    )
    random, found = np.random.default_rng(seed), list[RainReturns]()
    for first in range(0, len(beams), _CHUNK):
        part = slice(first, first + _CHUNK)
        depths = depths_along(parcels, beams.origin_m, beams.directions[part], step_m, steps)
        fluctuation = random.exponential(size=depths.shape)
        through = np.concatenate([np.zeros((len(depths), 1)), np.cumsum(depths, axis=1)], axis=1)
        to_echo = np.clip(np.where(np.isfinite(clear[part]), clear[part], 0) / step_m, 0, steps)
        whole = np.minimum(to_echo.astype(int), steps - 1)
        rows = np.arange(len(depths))
        transmittance[part] = np.exp(-through[rows, whole] - (to_echo - whole) * depths[rows, whole])
        reflectances = 0.5 * depths * matt * fluctuation * np.exp(-2 * through[:, :-1] - depths)
        signals = sensor.signal(np.broadcast_to(middles, depths.shape), reflectances, extinction_per_m)
        signals[beams.untouched[part]] = 0
        beam, place = np.nonzero((signals >= 1) & (middles < clear[part, None] - step_m))
        found.append(RainReturns(beam + first, middles[place], reflectances[beam, place]))
    return SprayInBeams(transmittance, RainReturns.joined(*found))
