"""Which way a spectrum's numbers run: class by class of diameter, or of fall speed."""

from typing import Literal

import numpy as np
from jaxtyping import Float64

from gsrain_engine.rain.calibration import atlas_velocity

Order = Literal["diameters first", "velocities first"]
"""Which index is the slower one: `velocities first` writes all diameters of the lowest speed, then of the next."""

_LOWEST_RATE_MM_H = 0.1
_FEWEST_DROPS = 10
_WORST_RATIO = 3.0
_ENOUGH_DROPS = 50


def arrange(
    counts: Float64[np.ndarray, "records classes"],
    written: Order,
    *,
    diameter_edges_mm: Float64[np.ndarray, " diameters_and_one"],
    velocity_edges_m_s: Float64[np.ndarray, " velocities_and_one"],
    area_m2: Float64[np.ndarray, " diameters"],
    seconds: Float64[np.ndarray, " records"],
    reported_mm_h: Float64[np.ndarray, " records"],
) -> tuple[Float64[np.ndarray, "records diameters velocities"], Order]:
    """Turn numbers in the order of their file into spectra, and say which order that was.

    The rate that follows from the spectra must agree with the reported one: the order with the nearer rate wins (the
    wrong one is a hundred times off). Where no record reports rain of 0.1 mm/h, or where both orders are off by more
    than three times (snow, insects, other classes: the check of the rates says so), the drops' speeds decide: the other
    order wins where its drops are twice as near to Atlas et al. (1973). Below 50 drops `written` (the maker's) stands.
    """
    diameters = 0.5 * (diameter_edges_mm[:-1] + diameter_edges_mm[1:])
    velocities = 0.5 * (velocity_edges_m_s[:-1] + velocity_edges_m_s[1:])
    other: Order = "diameters first" if written == "velocities first" else "velocities first"
    arranged = {order: _arranged(counts, order, len(diameters), len(velocities)) for order in (written, other)}

    rainy = (reported_mm_h >= _LOWEST_RATE_MM_H) & (counts.sum(axis=1) >= _FEWEST_DROPS)
    if rainy.any():
        depth_mm = np.pi / 6 * diameters**3 / (1e6 * area_m2)
        reported_mm = reported_mm_h[rainy] * seconds[rainy] / 3600
        ratio = {
            order: float(np.median(spectra[rainy].sum(axis=2) @ depth_mm / reported_mm))
            for order, spectra in arranged.items()
        }
        off = {order: abs(np.log(max(each, 1e-12))) for order, each in ratio.items()}
        order = other if off[other] < off[written] else written
        if off[order] <= np.log(_WORST_RATIO):
            return arranged[order], order
    if counts.sum() < _ENOUGH_DROPS:
        return arranged[written], written
    far = np.abs(velocities - atlas_velocity(diameters)[:, None])
    wrong = {order: float((spectra.sum(axis=0) * far).sum()) for order, spectra in arranged.items()}
    order = other if wrong[other] < 0.5 * wrong[written] else written
    return arranged[order], order


def _arranged(
    counts: Float64[np.ndarray, "records classes"], order: Order, diameters: int, velocities: int
) -> Float64[np.ndarray, "records diameters velocities"]:
    if order == "diameters first":
        return counts.reshape(-1, diameters, velocities)
    return counts.reshape(-1, velocities, diameters).transpose(0, 2, 1)
