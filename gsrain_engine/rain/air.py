"""Air: wind over height, gusts and turbulence; the velocities that they give to drops, and the offsets that follow.

A drop of the lattice drifts with the mean wind at one height. All else moves it away from there by an offset that is a
closed form of height and time, so that no history is needed (docs/physics/positions.md).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from .properties import CLASSES

WIND_HEIGHT_M = 10.0
"""Height above the ground for which wind is stated (WMO 2018, Guide to Instruments and Methods of Observation)."""

DRIFT_HEIGHT_M = 3.0
"""Height above the ground whose mean wind carries the lattice: the middle of the default streak region."""

GUST_PERIODS_S = (7.0, 11.3, 18.1)  # of the modes: no common multiple within hours
GUST_SPEED_M_S = 2.0
"""Vertical phase speed of the modes: their wavelengths over height are 14, 23 and 36 m."""

_RATES = 2 * np.pi / np.array(GUST_PERIODS_S)
_WAVENUMBERS = _RATES / GUST_SPEED_M_S
GUST_LENGTH_M = 36.0
"""Wavelength of the gusts' y component along x; longer in a wide lattice (`_MIN_PERIODS`)."""

_MIN_PERIODS = 2.25  # wavelengths in lattice periods: polynomials of sine and cosine then cover half a period
EDDY_LENGTH_M = 3.0
"""Size of the eddies that move single drops: as large as their distance from the ground."""

GRAVITY_M_S2 = 9.81
OWN_STEPS = 147.8
"""Standard deviation of the sum of four bytes, from which a drop's own velocity is drawn; it reaches 3.45 of them."""

NODES = 256  # of the tables over the height of the cell
_TRANSITION_S = 1.0  # time in which offsets follow changed settings
_MIN_FALL_M_S = 0.05


@dataclass(frozen=True, eq=False)
class AirScales:
    """Factors of the drops' offsets."""

    wind_m_s: Float64[np.ndarray, "2"]
    """At `WIND_HEIGHT_M`, along x and y."""
    roughness_m: float
    gust_m_s: float
    turbulence_m_s: float
    slowness_s_m: Float64[np.ndarray, " classes"]
    """Reciprocal fall speeds."""

    def toward(self, other: "AirScales", share: float) -> "AirScales":
        return AirScales(
            self.wind_m_s + share * (other.wind_m_s - self.wind_m_s),
            self.roughness_m + share * (other.roughness_m - self.roughness_m),
            self.gust_m_s + share * (other.gust_m_s - self.gust_m_s),
            self.turbulence_m_s + share * (other.turbulence_m_s - self.turbulence_m_s),
            self.slowness_s_m + share * (other.slowness_s_m - self.slowness_s_m),
        )

    @cached_property
    def by_class(self) -> Float32[np.ndarray, "classes 3"]:
        """Factors of each class; see `DropAir`."""
        slow = self.slowness_s_m
        own = -slow * (self.turbulence_m_s / OWN_STEPS) * follows(1 / slow)
        return np.stack([slow, slow / (1 + GUST_SPEED_M_S * slow), own], axis=1).astype(np.float32)


class DropAir(NamedTuple):
    """Offsets and velocities of drops in the air of one moment, tabulated over the height of the cell."""

    rows: Float32[np.ndarray, "10 nodes_and_one"]
    """Offsets times fall speed, from the lowest to the highest face: by the mean wind along x and y; times fall speed
    plus `GUST_SPEED_M_S`: by gusts along x, and along y times sine and cosine of x. Then velocities in m/s: of the mean
    wind, of gusts along x, and along y times cosine and sine of x."""
    by_class: Float32[np.ndarray, "classes 3"]
    """Reciprocals of the fall speed and of that plus `GUST_SPEED_M_S`; own offset for each meter of height and step."""
    numbers: Float32[np.ndarray, "8"]
    """Height of the lowest face above the ground, height of the cell, wavenumber along x, period, its reciprocal, the
    drift's velocity along x, and the largest magnitudes of the first and third row."""

    @property
    def fastest_m_s(self) -> float:
        """Bound on the velocity of mean wind and gusts."""
        mean, gusts = np.abs(self.rows[5:7]).max(axis=1), np.abs(self.rows[7:10]).max(axis=1)
        return float(np.hypot(*mean) + 1.5 * gusts.sum())


CALM = DropAir(
    np.zeros((10, NODES + 1), np.float32),
    np.zeros((CLASSES, 3), np.float32),
    np.array([0, 0, 0, 1, 1, 0, 0, 0], np.float32),
)
"""Still air."""


@dataclass(frozen=True, eq=False)
class Wind:
    """Mean wind, gusts and turbulence, as a smooth function of (seed, t) and place."""

    mean_m_s: tuple[float, float] = (0.0, 0.0)
    """At `WIND_HEIGHT_M`, along world x and y."""
    gust_m_s: float = 0.0
    turbulence_m_s: float = 0.0
    roughness_m: float = 0.3
    seed: int = 0

    @property
    def drift_share(self) -> float:
        """Mean wind that carries the lattice, relative to that at 10 m."""
        return _drift_share(self.roughness_m)

    @property
    def drift_m_s(self) -> Float64[np.ndarray, "2"]:
        """Mean wind that carries the lattice, along x and y."""
        return np.asarray(self.mean_m_s) * self.drift_share

    def scales(self, fall_speed_m_s: Float64[np.ndarray, " classes"]) -> AirScales:
        slowness = 1 / np.maximum(fall_speed_m_s, _MIN_FALL_M_S)
        wind_m_s = np.asarray(self.mean_m_s, np.float64)
        return AirScales(wind_m_s, self.roughness_m, self.gust_m_s, self.turbulence_m_s, slowness)

    def air(
        self,
        time_s: float,
        scales: AirScales,
        drift_m: Float64[np.ndarray, "2"],
        center_m: Float64[np.ndarray, "3"],
        period_m: Float64[np.ndarray, "3"],
        ground_m: float,
    ) -> DropAir:
        """Tabulate the air in a cell at a time; `scales` are those of the offsets, `drift_m` is that of the lattice.

        Gusts are modes of the velocity a cos(k z + k_x x - w t + phase), carried along x by the drift (the frozen
        turbulence of Taylor 1938). Velocities are across their wave vectors, and a component depends only on the axes
        that the lattice draws before its own, so that the density of drops stays uniform.
        """
        moves = *scales.wind_m_s, *self.mean_m_s, scales.gust_m_s, self.gust_m_s, scales.turbulence_m_s
        if not any(moves) and not self.turbulence_m_s:
            return CALM
        x, y, tall = (float(each) for each in period_m)
        low = float(center_m[2]) - tall / 2 - ground_m
        height = low + tall / NODES * np.arange(NODES + 1)
        rows = np.zeros((10, NODES + 1))
        # A drop falls by dz while the wind carries it by (u - u_drift) dz / v.
        below = _profile_integral(height, scales.roughness_m)
        below -= _drift_share(scales.roughness_m) * (height - DRIFT_HEIGHT_M)
        rows[0:2] = -scales.wind_m_s[:, None] * below
        rows[5:7] = np.asarray(self.mean_m_s)[:, None] * profile(height, self.roughness_m)
        along_x = 2 * np.pi / max(GUST_LENGTH_M, _MIN_PERIODS * max(x, y))
        phases, _, reaches = self.modes(time_s, 0.0, float(center_m[0] - drift_m[0]), along_x)
        angle = phases[:, :, None] + _WAVENUMBERS[:, None] * height
        reach, peak = (scales.gust_m_s * reaches)[:, None], self.gust_m_s / len(_RATES)
        rows[2] = np.sum(reach * np.sin(angle[0]), axis=0)
        rows[3], rows[4] = np.sum(reach * np.cos(angle[1]), axis=0), np.sum(reach * np.sin(angle[1]), axis=0)
        rows[7] = np.sum(peak * np.cos(angle[0]), axis=0)
        rows[8], rows[9] = np.sum(peak * np.cos(angle[1]), axis=0), -np.sum(peak * np.sin(angle[1]), axis=0)
        reach_of = np.abs(rows[[0, 2]]).max(axis=1)
        numbers = np.array([low, tall, along_x, x, 1 / x, self.drift_m_s[0], *reach_of], np.float32)
        return DropAir(rows.astype(np.float32), scales.by_class, numbers)

    def modes(
        self, time_s: float, height_m: float, x_m: float, along_x: float
    ) -> tuple[Float64[np.ndarray, "2 3"], Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """Phases of the gusts along x and y at a time, a height and x from the drift; rates in 1/s; reaches in m.

        A reach is the offset of a drop for an amplitude of 1 m/s, times its fall speed plus `GUST_SPEED_M_S`.
        """
        phases = self._phases + _WAVENUMBERS * height_m - _RATES * time_s
        phases[1] += along_x * x_m
        return phases, _RATES, -1 / (len(_RATES) * _WAVENUMBERS)

    @cached_property
    def _phases(self) -> Float64[np.ndarray, "2 3"]:
        return np.random.default_rng(self.seed).uniform(0, 2 * np.pi, (2, 3))


def blended(before: AirScales | None, since_s: float, now: AirScales, time_s: float) -> AirScales:
    """Scales of the offsets after a change: from those before it to those now, smoothly, so that no drop jumps."""
    if before is None or not since_s <= time_s < since_s + _TRANSITION_S:
        return now
    share = (time_s - since_s) / _TRANSITION_S
    return before.toward(now, share * share * (3 - 2 * share))


def profile(height_m: Float64[np.ndarray, " n"], roughness_m: float) -> Float64[np.ndarray, " n"]:
    """Mean wind at heights above the ground relative to that at 10 m: the logarithmic law of neutral air.

    u(z) / u(10 m) = ln(z / z_0) / ln(10 m / z_0), and 0 below the roughness length z_0 (Stull 1988, section 9.7).
    """
    return np.log(np.maximum(height_m, roughness_m) / roughness_m) / np.log(WIND_HEIGHT_M / roughness_m)


def _drift_share(roughness_m: float) -> float:
    return float(profile(np.array([DRIFT_HEIGHT_M]), roughness_m)[0])


def _profile_integral(height_m: Float64[np.ndarray, " n"], roughness_m: float) -> Float64[np.ndarray, " n"]:
    """Integral of `profile` over height, from `DRIFT_HEIGHT_M` on, in meters."""
    z = np.maximum(np.append(height_m, DRIFT_HEIGHT_M), roughness_m)
    antiderivative = (z * np.log(z / roughness_m) - z) / np.log(WIND_HEIGHT_M / roughness_m)
    return antiderivative[:-1] - antiderivative[-1]


def follows(fall_speed_m_s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Ratio of a drop's rms velocity to that of the air, 0..1.

    A drop that falls at V follows the air within the time V/g, and crosses an eddy of length L in L/V: the ratio of the
    variances is 1 / (1 + V^2 / (g L)) (Csanady 1963, J. Atmos. Sci. 20, for eddies that it falls through).
    """
    return 1 / np.sqrt(1 + fall_speed_m_s**2 / (GRAVITY_M_S2 * EDDY_LENGTH_M))
