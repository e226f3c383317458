"""What follows from the intensity: drop numbers, sizes, speeds, extinction. Plain numbers, no arrays."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
import scipy  # which loads its parts where they are used first: at the calibration's rows none is
from jaxtyping import Float

from .calibration import Calibration, atlas_velocity
from .drop_sizes import DropSizes
from .rain import CALIBRATED_UP_TO_MM_H, Rain

EXTINCTION_EFFICIENCY = 2.0
"""Q: a drop much larger than the wavelength removes twice its cross-section from a beam (van de Hulst, 1957)."""

_LEAST_MM_H = 1e-3
"""Fainter rain has the sizes of this."""

Velocity = Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]]


@dataclass(frozen=True, slots=True, kw_only=True)
class RainState:
    """The rain at one intensity."""

    intensity_mm_h: float
    """As requested."""
    density_m3: float
    """Drops a cubic metre, after the closure."""
    table_density_m3: float
    """Drops a cubic metre as the calibration's table has it."""
    shape: float
    scale_mm: float
    mean_diameter_mm: float
    mean_fall_speed_m_s: float
    implied_mm_h: float
    """Rate that the drawn drops carry: 6e-4 pi N E[V D^3]."""
    table_implied_mm_h: float
    """Rate that the table's own density would carry."""
    extinction_per_m: float
    """beta = (pi/4) Q N E[D^2] times the haze gain."""
    visibility_m: float
    """Meteorological optical range: where 5 % of a beam is left, ln(20) / beta; infinite without rain."""
    drops: int
    """Drops in the streak region: density times volume."""
    haze_gaussians: int
    """M: haze Gaussians of full opacity in the haze region; `make_haze` splits them up."""

    @property
    def beyond_calibration(self) -> bool:
        """Whether the intensity lies above what was measured."""
        return self.intensity_mm_h > CALIBRATED_UP_TO_MM_H

    @property
    def sizes(self) -> DropSizes:
        return DropSizes(self.shape, self.scale_mm)


def fall_speed(rain: Rain, calibration: Calibration) -> Velocity:
    """Fall speed in m/s over the diameter in mm that this rain uses."""
    return atlas_velocity if rain.velocity == "atlas" else calibration.velocity


def flux_mm_h(density_m3: float, sizes: DropSizes, velocity: Velocity) -> float:
    """Rain rate that a population carries: R = 6e-4 pi N E[V D^3], N in 1/m^3, V in m/s, D in mm."""
    return 6e-4 * np.pi * density_m3 * sizes.expectation(lambda d: velocity(d) * d**3)


def rain_state(rain: Rain, calibration: Calibration) -> RainState:
    """Work out the state at an intensity (docs/physics.md, sections 1 and 2)."""
    intensity = rain.intensity_mm_h
    # At R = 0 the sizes stay those of the faintest rain, so that nothing divides by nothing; there are no drops.
    table_density, sizes = _interpolate_table(calibration, max(intensity, _LEAST_MM_H))
    velocity = fall_speed(rain, calibration)
    if intensity == 0:
        table_density = 0.0
    implied = flux_mm_h(table_density, sizes, velocity)
    density, drawn = table_density, implied
    if rain.closure == "density" and implied > 0:
        density, drawn = table_density * intensity / implied, intensity
    square_m2 = 1e-6 * sizes.expectation(lambda d: d**2)
    extinction = rain.haze_gain * np.pi / 4 * EXTINCTION_EFFICIENCY * density * square_m2
    return RainState(
        intensity_mm_h=intensity,
        density_m3=density,
        table_density_m3=table_density,
        shape=sizes.shape,
        scale_mm=sizes.scale_mm,
        mean_diameter_mm=sizes.mean_mm,
        mean_fall_speed_m_s=sizes.expectation(velocity),
        implied_mm_h=drawn,
        table_implied_mm_h=implied,
        extinction_per_m=extinction,
        visibility_m=float(np.log(20)) / float(extinction) if extinction > 0 else float("inf"),
        drops=round(density * rain.streak_region.volume_m3),
        haze_gaussians=_haze_gaussians(rain, extinction),
    )


def intensity_of(density_m3: float, rain: Rain, calibration: Calibration) -> float:
    """Intensity in mm/h at which a rain has so many drops a cubic metre, with its closure. 0 for none.

    Raises `ValueError` for more than there are at 100 mm/h.
    """
    if density_m3 == 0:
        return 0.0

    def surplus(log_intensity: float) -> float:
        state = rain_state(msgspec.structs.replace(rain, intensity_mm_h=float(np.exp(log_intensity))), calibration)
        return float(np.log(state.density_m3 / density_m3))

    least, most = float(np.log(_LEAST_MM_H)), float(np.log(100.0))
    if not density_m3 > 0 or surplus(most) < 0:
        raise ValueError(f"{density_m3:g} drops per m3: must be within 0 and what {calibration.name} has at 100 mm/h")
    if surplus(least) >= 0:
        return _LEAST_MM_H
    return float(np.exp(scipy.optimize.root_scalar(surplus, bracket=(least, most), method="brentq").root))


def _haze_gaussians(rain: Rain, extinction_per_m: float) -> int:
    """M = beta V_f / (2 pi s_h^2 alpha_m): a ray through the region loses what the drops would take from it."""
    if extinction_per_m == 0:
        return 0
    if rain.haze_count is not None:
        return rain.haze_count
    shadow = 2 * np.pi * rain.haze_sigma_m**2 * rain.haze_opacity
    return round(extinction_per_m * rain.haze_region.volume_m3 / shadow)


def _interpolate_table(calibration: Calibration, intensity: float) -> tuple[float, DropSizes]:
    """Density and sizes between and beyond the rows; at a row the row itself comes back."""
    for row in calibration.rows:
        if row.intensity_mm_h == intensity:
            return row.density_m3, DropSizes(row.shape, row.scale_mm)
    table = _table(calibration)
    x = float(np.log(intensity))
    density = float(np.exp(table.log_density(x)))
    mean = float(np.exp(table.log_mean(x)))
    shape = float(table.shape.inside(np.clip(x, *table.shape.ends)))
    return density, DropSizes(shape, mean / shape)


@dataclass(frozen=True, slots=True, eq=False)
class _Curve:
    """Shape-preserving cubic inside (Fritsch and Carlson, 1980); outside, on with the slope fitted over all points."""

    inside: Callable[[float], Any]
    ends: tuple[float, float]
    slope: float

    @classmethod
    def through(cls, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> "_Curve":
        inside = scipy.interpolate.PchipInterpolator(x, y)
        return cls(inside, (float(x[0]), float(x[-1])), float(np.polyfit(x, y, 1)[0]))

    def __call__(self, at: float) -> float:
        inside = min(max(at, self.ends[0]), self.ends[1])
        return float(self.inside(inside)) + self.slope * (at - inside)


class _Table(NamedTuple):
    """A calibration's rows as curves over ln R."""

    log_density: _Curve
    log_mean: _Curve
    shape: _Curve


@lru_cache(maxsize=8)
def _table(calibration: Calibration) -> _Table:
    rows = calibration.rows
    log_r = np.log([row.intensity_mm_h for row in rows])
    return _Table(
        _Curve.through(log_r, np.log([row.density_m3 for row in rows])),
        _Curve.through(log_r, np.log([row.shape * row.scale_mm for row in rows])),
        _Curve.through(log_r, np.array([row.shape for row in rows])),
    )
