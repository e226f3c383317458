"""Physical properties of rain: drop numbers, sizes, fall speeds and extinction from the intensity."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from typing import Any, Literal

import msgspec
import numpy as np
import scipy  # loads its submodules lazily: at the calibration's rows none is needed
from jaxtyping import Float, Float64
from scipy import special

from .calibration import Calibration, atlas_velocity, load_calibration
from .fog import fog_extinction_per_m
from .haze import extinction_per_m, haze_count
from .settings import CALIBRATED_UP_TO_MM_H, HEAVIEST_MM_H, LARGEST_MM, SMALLEST_MM, RainSettings

CLASSES = 16384
"""Diameter classes: class c is the quantile (c + 1/2) / CLASSES, and a drop keeps its class as R changes."""

Closure = Literal["density", "published"]
_LARGE_SHARE = 0.975
_MIN_MM_H = 1e-3  # intensity below which drop sizes no longer change
Velocity = Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]]


@dataclass(frozen=True)
class DropSizes:
    """Gamma distribution of drop diameters with shape mu and scale theta (mm), cut to [0.1, 8] mm (paper, eq. 8)."""

    shape: float
    scale_mm: float

    @cached_property
    def _limits(self) -> tuple[float, float]:
        low, high = special.gammainc(self.shape, np.array([SMALLEST_MM, LARGEST_MM]) / self.scale_mm)
        return float(low), float(high)

    def quantile(self, probability: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Diameter in mm below which this share of the drops lies."""
        low, high = self._limits
        diameter = self.scale_mm * special.gammaincinv(self.shape, low + probability * (high - low))
        return np.clip(diameter, SMALLEST_MM, LARGEST_MM)

    def probability_per_mm(self, diameter_mm: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Probability density in 1/mm, for diameters within the bounds."""
        low, high = self._limits
        x = diameter_mm / self.scale_mm
        density = np.exp((self.shape - 1) * np.log(x) - x - special.gammaln(self.shape))
        return density / (self.scale_mm * (high - low))

    @cached_property
    def class_diameters_mm(self) -> Float64[np.ndarray, " classes"]:
        """Diameter of each class in mm, rising."""
        return self.quantile((np.arange(CLASSES) + 0.5) / CLASSES)

    @cached_property
    def large_diameter_mm(self) -> float:
        """Diameter in mm that 97.5 % of the drops do not reach: D of the maximum visible distance (paper, eq. 6).

        The paper takes 1.5 mm at 8.5 mm/h, since diameters are "generally" below it: 97.4 % of its gamma law are.
        """
        return float(self.quantile(np.array([_LARGE_SHARE]))[0])

    @cached_property
    def median_volume_diameter_mm(self) -> float:
        """Diameter D_0 in mm: half of the water in the air is in smaller drops.

        D^3 times a gamma density is one of shape + 3, so this is the median of that law within the same bounds.
        """
        return float(DropSizes(self.shape + 3, self.scale_mm).quantile(np.array([0.5]))[0])

    def expectation(self, quantity: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]) -> float:
        """Mean of a function of the diameter (mm) over the drops, by Gauss-Legendre quadrature."""
        diameter, weight = _quadrature()
        log_density = (self.shape - 1) * np.log(diameter) - diameter / self.scale_mm
        mass = weight * np.exp(log_density - log_density.max())
        return float(np.sum(mass * quantity(diameter)) / np.sum(mass))


@dataclass(frozen=True, slots=True, kw_only=True)
class RainProperties:
    """Physical properties of rain at one intensity."""

    intensity_mm_h: float
    """Intensity in the settings."""
    calibrated_up_to_mm_h: float
    """Highest intensity that the calibration was fitted to; beyond it is extrapolated."""
    density_m3: float
    """Drops per cubic meter, after the closure."""
    table_density_m3: float
    """Drops per cubic meter in the calibration's table."""
    shape: float
    scale_mm: float
    mean_diameter_mm: float
    mean_fall_speed_m_s: float
    implied_mm_h: float
    """Rain rate of the drawn drops: 6e-4 pi N E[V D^3]."""
    table_implied_mm_h: float
    """Rain rate of the table's own density in calm air."""
    extinction_per_m: float
    """beta: that of the drops, (pi/4) Q N E[D^2] times the haze gain, and that of fog."""
    fog_extinction_per_m: float
    """Part of beta that is fog."""
    visibility_m: float
    """Meteorological optical range, at which 5 % of a beam remains: ln(20) / beta; infinite without rain and fog."""
    drops: int
    """Drops in the streak region: density times volume."""
    haze_gaussians: int
    """M: haze Gaussians of full opacity in the haze region, with `haze: gaussians`; `make_haze` splits them."""

    @property
    def beyond_calibration(self) -> bool:
        """True if the intensity exceeds the calibrated range."""
        return self.intensity_mm_h > self.calibrated_up_to_mm_h

    @property
    def marshall_palmer_extinction_per_m(self) -> float:
        """Beta of as much rain with the drops of Marshall and Palmer, a reference for any calibration."""
        return _marshall_palmer_extinction_per_m(self.intensity_mm_h)

    @property
    def extinction_text(self) -> str:
        """Beta of the drops, also as a multiple of Marshall and Palmer's; there must be rain."""
        per_m = self.extinction_per_m - self.fog_extinction_per_m
        return f"{1000 * per_m:.3g} /km ({per_m / self.marshall_palmer_extinction_per_m:.2g} times Marshall-Palmer's)"

    @property
    def is_clear(self) -> bool:
        """True without rain and fog."""
        return self.intensity_mm_h == 0 and self.extinction_per_m == 0

    @property
    def rain_class(self) -> str:
        return rain_class(self.intensity_mm_h)

    @property
    def sizes(self) -> DropSizes:
        return DropSizes(self.shape, self.scale_mm)


_RAIN_CLASSES = ((0.1, ""), (0.5, "very light"), (1.9, "light"), (8.1, "moderate"), (34.0, "heavy"))
"""Upper bounds in mm/h of the classes of ASAM OSI 3 (`EnvironmentalConditions.Precipitation`), and their names."""


def rain_class(intensity_mm_h: float) -> str:
    """Class of an intensity, "very light" to "very heavy", after ASAM OSI; "" below 0.1 mm/h."""
    return next((name for below, name in _RAIN_CLASSES if intensity_mm_h < below), "very heavy")


def calibrated_up_to(calibration: Calibration) -> float:
    """Highest intensity in mm/h that is not extrapolated: the last row of a fit to measurements, or the paper's."""
    return calibration.rows[-1].intensity_mm_h if calibration.provenance is not None else CALIBRATED_UP_TO_MM_H


def fall_speed(rain: RainSettings, calibration: Calibration) -> Velocity:
    """Mean fall speed in m/s over the diameter in mm for these settings."""
    still, share = still_fall_speed(rain, calibration), turbulent_fall_share(rain.turbulence_m_s)
    return still if share == 1 else lambda diameter_mm: share * still(diameter_mm)


def still_fall_speed(rain: RainSettings, calibration: Calibration) -> Velocity:
    """Fall speed in m/s over the diameter in mm in calm air."""
    return atlas_velocity if rain.velocity == "atlas" else calibration.velocity


def turbulent_fall_share(turbulence_m_s: float) -> float:
    """Mean fall speed of drops in turbulent air relative to that in calm air, 0.7..1: 1 - 0.3 (1 - exp(-(s/2)^2)).

    Disdrometers find no change in calm air, and 25-30 % less in the strongest turbulence (Thurai et al. 2019, Adv. Sci.
    Res. 16; 2021, Adv. Sci. Res. 18). The course between is ours; s is the rms of a horizontal component in m/s.
    """
    return 1 - 0.3 * (1 - float(np.exp(-((turbulence_m_s / 2) ** 2))))


def flux_mm_h(density_m3: float, sizes: DropSizes, velocity: Velocity) -> float:
    """Rain rate of a drop population: R = 6e-4 pi N E[V D^3], N in 1/m^3, V in m/s, D in mm."""
    return 6e-4 * np.pi * density_m3 * sizes.expectation(lambda d: velocity(d) * d**3)


def rain_properties(rain: RainSettings, calibration: Calibration) -> RainProperties:
    """Compute the properties of the rain (docs/physics/drops.md, docs/physics/extinction.md)."""
    intensity = rain.intensity_mm_h
    # At R = 0 there are no drops; their sizes stay those of the faintest rain to avoid division by zero.
    table_density, sizes = _interpolate_table(calibration, max(intensity, _MIN_MM_H), rain.closure)
    if rain.diameter_scale != 1:
        sizes = DropSizes(sizes.shape, rain.diameter_scale * sizes.scale_mm)
    velocity = fall_speed(rain, calibration)
    if intensity == 0:
        table_density = 0.0
    implied = flux_mm_h(table_density, sizes, velocity)
    density, drawn = table_density, implied
    if rain.closure == "density" and implied > 0:
        density, drawn = table_density * intensity / implied, intensity
    square_m2 = 1e-6 * sizes.expectation(lambda d: d**2)
    of_drops, of_fog = extinction_per_m(rain, density, square_m2), fog_extinction_per_m(rain.visibility_m)
    extinction = of_drops + of_fog
    return RainProperties(
        intensity_mm_h=intensity,
        calibrated_up_to_mm_h=calibrated_up_to(calibration),
        density_m3=density,
        table_density_m3=table_density,
        shape=sizes.shape,
        scale_mm=sizes.scale_mm,
        mean_diameter_mm=sizes.expectation(lambda d: d),
        mean_fall_speed_m_s=sizes.expectation(velocity),
        implied_mm_h=drawn,
        table_implied_mm_h=flux_mm_h(table_density, sizes, still_fall_speed(rain, calibration)),
        extinction_per_m=extinction,
        fog_extinction_per_m=of_fog,
        visibility_m=float(np.log(20)) / float(extinction) if extinction > 0 else float("inf"),
        drops=round(density * rain.streak_region.volume_m3),
        haze_gaussians=haze_count(rain, of_drops),
    )


@lru_cache(maxsize=256)
def _marshall_palmer_extinction_per_m(intensity_mm_h: float) -> float:
    calibration = load_calibration("marshall_palmer")
    return rain_properties(RainSettings(intensity_mm_h=intensity_mm_h), calibration).extinction_per_m


def extinction_note(rains: Iterable[RainSettings]) -> str:
    """Return the extinction of several rains beside Marshall and Palmer's as a sentence; "" without rain."""
    falling = {each.intensity_mm_h: each for each in rains if each.intensity_mm_h > 0}
    states = [rain_properties(falling[rate], load_calibration(falling[rate].calibration)) for rate in sorted(falling)]
    parts = ", ".join(f"{each.extinction_text} at {each.intensity_mm_h:g} mm/h" for each in states)
    return f"Extinction of the rain: {parts}." if parts else ""


def intensity_for_density(density_m3: float, rain: RainSettings, calibration: Calibration) -> float:
    """Intensity in mm/h at which rain with these settings has a drop density; 0 for 0.

    Raises `ValueError` for densities above that at 149 mm/h.
    """
    if density_m3 == 0:
        return 0.0

    def surplus(log_intensity: float) -> float:
        state = rain_properties(msgspec.structs.replace(rain, intensity_mm_h=float(np.exp(log_intensity))), calibration)
        return float(np.log(state.density_m3 / density_m3))

    low, high = float(np.log(_MIN_MM_H)), float(np.log(HEAVIEST_MM_H))
    if not density_m3 > 0 or surplus(high) < 0:
        most = f"what {calibration.name} has at {HEAVIEST_MM_H:g} mm/h"
        raise ValueError(f"{density_m3:g} drops per m3: must be within 0 and {most}")
    if surplus(low) >= 0:
        return _MIN_MM_H
    return float(np.exp(scipy.optimize.root_scalar(surplus, bracket=(low, high), method="brentq").root))


def _interpolate_table(calibration: Calibration, intensity: float, closure: Closure) -> tuple[float, DropSizes]:
    """Density and sizes between and beyond the calibration's rows; exactly the row at a row."""
    for row in calibration.rows:
        if row.intensity_mm_h == intensity:
            return row.density_m3, DropSizes(row.shape, row.scale_mm)
    if closure == "density" and calibration.diameter_growth is not None and intensity > calibrated_up_to(calibration):
        return _grown(calibration, intensity, calibration.diameter_growth)
    curves, (low, high), slopes = _log_curves(calibration)
    x = float(np.log(intensity))
    inside = min(max(x, low), high)
    values = zip(curves(inside).tolist(), slopes, strict=True)
    log_density, log_mean, shape = (value + slope * (x - inside) for value, slope in values)
    return float(np.exp(log_density)), DropSizes(shape, float(np.exp(log_mean)) / shape)


def _grown(calibration: Calibration, intensity: float, growth: float) -> tuple[float, DropSizes]:
    """Density and sizes beyond the calibrated range: drops of the shape at its end that carry the same share of R.

    Their diameters grow as R^growth.
    """
    limit = calibrated_up_to(calibration)
    density, sizes = _interpolate_table(calibration, limit, "density")
    grown = DropSizes(sizes.shape, sizes.scale_mm * (intensity / limit) ** growth)
    carried = flux_mm_h(1, sizes, calibration.velocity) / flux_mm_h(1, grown, calibration.velocity)
    return density * carried * intensity / limit, grown


@lru_cache(maxsize=8)
def _log_curves(calibration: Calibration) -> tuple[Any, tuple[float, float], tuple[float, float, float]]:
    """Logarithms of density and mean diameter, and the shape, over ln R: curves, ends, and slopes beyond the ends.

    The curves are shape-preserving cubics (Fritsch and Carlson, 1980), the slopes fitted to all rows; the shape stays.
    """
    rows = calibration.rows
    log_r = np.log([row.intensity_mm_h for row in rows])
    log_density = np.log([row.density_m3 for row in rows])
    log_mean = np.log([row.shape * row.scale_mm for row in rows])
    columns = np.stack([log_density, log_mean, [row.shape for row in rows]], axis=1)
    slopes = float(np.polyfit(log_r, log_density, 1)[0]), float(np.polyfit(log_r, log_mean, 1)[0]), 0.0
    return scipy.interpolate.PchipInterpolator(log_r, columns), (float(log_r[0]), float(log_r[-1])), slopes


_PANELS, _NODES = 20, 20
"""Few nodes in each of many panels: the eigenvalues for 400 nodes at once take seconds on a busy machine."""


@cache
def _quadrature() -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Gauss-Legendre nodes in mm and their weights, in the square root of D: denser at small drops."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    edges = np.linspace(np.sqrt(SMALLEST_MM), np.sqrt(LARGEST_MM), _PANELS + 1)[:, None]
    root = (edges[:-1] + 0.5 * (nodes + 1) * np.diff(edges, axis=0)).ravel()
    return root**2, np.tile(weights, _PANELS) * root


# Diameter and fall speed of each class over the intensity
# Tabulated and interpolated, so that drops change continuously with the intensity.

LOWEST_MM_H = 0.02  # intensity below which drops no longer change

_RATIO = 1.2
"""Ratio of successive nodes. Linear interpolation is off by 0.05 % in diameter outside the calibration; between the
paper's rows at 8.5 and 12 mm/h, which differ most, by 0.4 % in the median class and 3 % in the smallest drops.
"""

_CACHED_TABLES = 96  # maximum number of cached nodes, 256 kB each; 0 to 149 mm/h needs 55


@dataclass(frozen=True, eq=False)
class DropClassTable:
    """Diameters and fall speeds of all classes at some intensities, with linear interpolation."""

    nodes_mm_h: Float64[np.ndarray, " nodes"]
    """Rising."""
    diameters_mm: tuple[Float64[np.ndarray, " classes"], ...]
    fall_speed_m_s: tuple[Float64[np.ndarray, " classes"], ...]

    @classmethod
    def between(
        cls, lowest_mm_h: float, highest_mm_h: float, rain: RainSettings, calibration: Calibration
    ) -> "DropClassTable":
        """Tabulate a range of intensities; exact for a single intensity."""
        if lowest_mm_h == highest_mm_h:
            nodes = np.array([lowest_mm_h])
        else:
            first = int(np.floor(_steps(lowest_mm_h)))
            last = max(first + 1, int(np.ceil(_steps(highest_mm_h))))
            grid = np.minimum(LOWEST_MM_H * _RATIO ** np.arange(first, last + 1), HEAVIEST_MM_H)
            # The table has kinks at the calibration's rows and at the end of its range.
            rows = np.array([*(row.intensity_mm_h for row in calibration.rows), calibrated_up_to(calibration)])
            low = [0.0] if lowest_mm_h < LOWEST_MM_H else []
            nodes = np.unique(np.concatenate([low, grid, rows[(rows > grid[0]) & (rows < grid[-1])]]))
        rates = np.maximum(nodes, LOWEST_MM_H).tolist()
        diameters, speeds = zip(
            *(
                _classes_at(rate, rain.closure, rain.velocity, rain.turbulence_m_s, rain.diameter_scale, calibration)
                for rate in rates
            ),
            strict=True,
        )
        return cls(nodes, diameters, speeds)

    def interval(self, intensity_mm_h: float) -> int:
        """Index of the last node at or below an intensity, except the last node."""
        node = int(np.searchsorted(self.nodes_mm_h, intensity_mm_h, side="right")) - 1
        return min(max(node, 0), max(len(self.nodes_mm_h) - 2, 0))

    def at(
        self, of: tuple[Float64[np.ndarray, " classes"], ...], intensity_mm_h: float
    ) -> Float64[np.ndarray, " classes"]:
        """Diameters or speeds at an intensity within the nodes, by linear interpolation."""
        if len(of) == 1:
            return of[0]
        j = self.interval(intensity_mm_h)
        low, high = self.nodes_mm_h[j], self.nodes_mm_h[j + 1]
        share = min(max((intensity_mm_h - low) / (high - low), 0.0), 1.0)
        return (1 - share) * of[j] + share * of[j + 1]

    def mean_shares(
        self, start_mm_h: Float64[np.ndarray, " n"], end_mm_h: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n nodes"]:
        """Mean weight of each node while the intensity changes linearly from start to end. Exact."""
        if len(self.nodes_mm_h) == 1:
            return np.ones((len(start_mm_h), 1))
        change = end_mm_h - start_mm_h
        share = np.zeros((len(change), len(self.nodes_mm_h)))
        still = change == 0
        divisor = np.where(still, 1.0, change)
        last = float(self.nodes_mm_h[-1])
        for j, (low, high) in enumerate(pairwise(self.nodes_mm_h.tolist())):
            a, b = np.clip(start_mm_h, low, high), np.clip(end_mm_h, low, high)
            inside = np.where(still, (start_mm_h >= low) & ((start_mm_h < high) | (high == last)), (b - a) / divisor)
            rising = ((a - low) + (b - low)) / (2 * (high - low))
            share[:, j] += inside * (1 - rising)
            share[:, j + 1] += inside * rising
        return share

    def mix(
        self, of: tuple[Float64[np.ndarray, " classes"], ...], shares: Float64[np.ndarray, " nodes"]
    ) -> Float64[np.ndarray, " classes"]:
        """Weighted sum of nodes in a fixed order, for identical results on every machine."""
        total = np.zeros(len(of[0]))
        for j in np.flatnonzero(shares):
            total += shares[j] * of[j]
        return total


def _steps(intensity_mm_h: float) -> float:
    return float(np.log(max(intensity_mm_h, LOWEST_MM_H) / LOWEST_MM_H) / np.log(_RATIO))


@lru_cache(maxsize=_CACHED_TABLES)
def _classes_at(
    intensity_mm_h: float,
    closure: Closure,
    velocity: Literal["calibration", "atlas"],
    turbulence_m_s: float,
    diameter_scale: float,
    calibration: Calibration,
) -> tuple[Float64[np.ndarray, " classes"], Float64[np.ndarray, " classes"]]:
    rain = RainSettings(
        intensity_mm_h=intensity_mm_h,
        closure=closure,
        velocity=velocity,
        turbulence_m_s=turbulence_m_s,
        diameter_scale=diameter_scale,
    )
    diameters = rain_properties(rain, calibration).sizes.class_diameters_mm
    return diameters, fall_speed(rain, calibration)(diameters)


# Calibration curves for plots

_INTENSITIES_MM_H, _DIAMETERS_MM = np.geomspace(0.1, HEAVIEST_MM_H, 64), np.linspace(SMALLEST_MM, LARGEST_MM, 159)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CalibrationCurves:
    """Curves of the calibration's own table, before any closure."""

    intensities_mm_h: Float64[np.ndarray, " n"]
    density_m3: Float64[np.ndarray, " n"]
    mean_diameter_mm: Float64[np.ndarray, " n"]
    implied_share: Float64[np.ndarray, " n"]
    """Rain rate of the drops, relative to the intensity."""
    diameters_mm: Float64[np.ndarray, " d"]
    fall_speed_m_s: Float64[np.ndarray, " d"]


@cache
def calibration_curves(calibration: Calibration) -> CalibrationCurves:
    """Evaluate a calibration from 0.1 to 149 mm/h and from 0.1 to 8 mm."""
    states = [rain_properties(RainSettings(intensity_mm_h=float(each)), calibration) for each in _INTENSITIES_MM_H]
    return CalibrationCurves(
        intensities_mm_h=_INTENSITIES_MM_H,
        density_m3=np.array([each.table_density_m3 for each in states]),
        mean_diameter_mm=np.array([each.mean_diameter_mm for each in states]),
        implied_share=np.array([each.table_implied_mm_h for each in states]) / _INTENSITIES_MM_H,
        diameters_mm=_DIAMETERS_MM,
        fall_speed_m_s=calibration.velocity(_DIAMETERS_MM),
    )


@cache
def spectrum_at(calibration: Calibration, intensity_mm_h: float) -> Float64[np.ndarray, " d"]:
    """Drop spectrum N(D) in 1/(m^3 mm) at `CalibrationCurves.diameters_mm`, with the table's own density."""
    state = rain_properties(RainSettings(intensity_mm_h=intensity_mm_h), calibration)
    return state.table_density_m3 * state.sizes.probability_per_mm(_DIAMETERS_MM)
