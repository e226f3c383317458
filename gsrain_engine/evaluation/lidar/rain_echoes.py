"""Lidar returns from raindrops and the echo loss of a wet road."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64, Int64
from scipy.spatial import KDTree
from scipy.stats import poisson

from ...rain.frame import RainFrame
from ...rain.properties import CLASSES, RainProperties
from ...rain.settings import RegionBox
from .sensor import Beams, LidarSensor

_STEP_M = 0.01
_BETWEEN = 0.9  # lower bound of what is needed between two steps over what is needed on them


class RainReturns(NamedTuple):
    """Detected drops, each in one of the sensor's beams."""

    beams: Int64[np.ndarray, " m"]
    ranges_m: Float64[np.ndarray, " m"]
    reflectances: Float64[np.ndarray, " m"]
    """Equivalent reflectance of a beam-filling target with the same echo."""

    @staticmethod
    def none() -> "RainReturns":
        return RainReturns(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))

    @staticmethod
    def joined(*parts: "RainReturns") -> "RainReturns":
        return RainReturns(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class DropReturnModel:
    """Echoes of one rain's drops in one sensor's beams.

    A drop with its center in a beam of width w intercepts (D / w)^2 of it and returns `drop_reflectance` of that. Drops
    count individually: the sum of two drops within a pulse is neglected.
    """

    sensor: LidarSensor
    state: RainProperties

    @cached_property
    def _strengths_mm2(self) -> Float64[np.ndarray, " classes"]:
        """Increases with the class: a larger drop's size adds more than absorption removes from its back reflection."""
        diameters = self.state.sizes.class_diameters_mm
        return diameters**2 * drop_reflectance(diameters, self.sensor.wavelength_nm)

    def reflectances(
        self, ranges_m: Float64[np.ndarray, " m"], classes: Int64[np.ndarray, " m"]
    ) -> Float64[np.ndarray, " m"]:
        """Equivalent reflectance of a beam-filling target with the echo of a drop of a class."""
        return 1e-6 * self._strengths_mm2[classes] / self.sensor.beam_width_m(ranges_m) ** 2

    def first_detected(self, ranges_m: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
        """Smallest class that is detected at a range; `CLASSES` if none is."""
        clear = np.exp(2 * self.state.extinction_per_m * ranges_m)
        with np.errstate(over="ignore"):
            needed = 1e6 * self.sensor.detectable(ranges_m) * clear * self.sensor.beam_width_m(ranges_m) ** 2
        return np.searchsorted(self._strengths_mm2, needed)

    @cached_property
    def reach_m(self) -> float:
        """Range beyond which no drop is detected."""
        ranges = np.arange(0, min(self.sensor.range_m, self.sensor.farthest_m) + _STEP_M, _STEP_M)
        detected = np.flatnonzero(self.first_detected(ranges) < CLASSES)
        return float(ranges[detected[-1]]) + _STEP_M if len(detected) else 0.0

    @cached_property
    def smallest_detected(self) -> int:
        """Class below which drops are detected at no range."""
        needed = self.sensor.detectable(self.grid_m) * self.sensor.beam_width_m(self.grid_m) ** 2
        # Between the ranges of the grid a drop may be detected that is not on it.
        return int(np.searchsorted(self._strengths_mm2, _BETWEEN * 1e6 * needed.min(initial=np.inf)))

    @cached_property
    def grid_m(self) -> Float64[np.ndarray, " k"]:
        """Evenly spaced ranges up to `reach_m`."""
        return np.linspace(0, self.reach_m, max(round(self.reach_m / _STEP_M), 1) + 1)

    @cached_property
    def expected(self) -> Float64[np.ndarray, " k"]:
        """Mean number of detected drops in a beam up to each range of the grid; 0 without rain.

        The integral of N pi/4 w(r)^2 P(D is detected at r) over r.
        """
        shares = 1 - self.first_detected(self.grid_m) / CLASSES
        per_m = self.state.density_m3 * np.pi / 4 * self.sensor.beam_width_m(self.grid_m) ** 2 * shares
        steps = np.diff(self.grid_m) * (per_m[1:] + per_m[:-1]) / 2
        return np.concatenate([[0.0], np.cumsum(steps)])

    def expected_up_to(self, ranges_m: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Mean number of detected drops in a beam up to a range."""
        return np.interp(ranges_m, self.grid_m, self.expected)


# Drops outside the simulated field
# Sampled from the drop spectrum.

_MAX_RETURNS = 4  # maximum number of sampled drops per beam; there are seldom two
_Span = tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]


def sample_far_returns(
    beams: Beams, listened_m: Float64[np.ndarray, " n"], simulated: _Span, signals: DropReturnModel, seed: int
) -> RainReturns:
    """Sample detected drops along each beam up to `listened_m`, except within the `simulated` range interval (m).

    Counts are Poisson with the integral of the detected spectrum over the beam's volume, ranges follow its growth,
    sizes the detected part of the spectrum at that range. A seed gives the same random numbers at all rain rates, so
    that more rain only adds drops.
    """
    draws = np.random.default_rng(seed).random((len(beams), 1 + 2 * _MAX_RETURNS))
    start, end = (np.minimum(each, listened_m) for each in simulated)
    left_out = signals.expected_up_to(start), signals.expected_up_to(end)
    mean = signals.expected_up_to(listened_m) - (left_out[1] - left_out[0])
    counts = np.minimum(poisson.ppf(draws[:, 0], np.maximum(mean, 0)), _MAX_RETURNS).astype(np.int64)
    beam = np.repeat(np.arange(len(beams)), counts)
    turn = np.arange(len(beam)) - np.repeat(np.cumsum(counts) - counts, counts)
    place, size = draws[beam, 1 + 2 * turn], draws[beam, 2 + 2 * turn]
    drawn = place * mean[beam]
    drawn += np.where(drawn > left_out[0][beam], (left_out[1] - left_out[0])[beam], 0)
    ranges = np.interp(drawn, signals.expected, signals.grid_m)
    smallest = np.minimum(signals.first_detected(ranges), CLASSES - 1)
    classes = smallest + np.floor(size * (CLASSES - smallest)).astype(np.int64)
    return RainReturns(beam, ranges, signals.reflectances(ranges, classes))


def box_span(beams: Beams, box: RegionBox, frame: Float64[np.ndarray, "4 4"]) -> _Span:
    """Entry and exit range of each beam in a box of a frame, in meters; 0 and 0 for a miss."""
    turn = frame[:3, :3]
    origin, directions = turn.T @ (beams.origin_m - frame[:3, 3]), beams.directions @ turn
    directions = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
    faces = np.stack([(np.array(face) - origin) / directions for face in (box.minimum_m, box.maximum_m)])
    enter, leave = faces.min(axis=0).max(axis=1), faces.max(axis=0).min(axis=1)
    met = leave > np.maximum(enter, 0)
    return np.where(met, np.maximum(enter, 0), 0), np.where(met, leave, 0)


# Drops of the simulated field
# The same drops as in camera images.


def drop_field_returns(
    field: RainFrame, beams: Beams, listened_m: Float64[np.ndarray, " n"], signals: DropReturnModel
) -> RainReturns:
    """Find the field's detected drops nearer than `listened_m`, each in every beam whose width contains its center."""
    drops = field.visible_drops(in_view=False, smallest_class=signals.smallest_detected)
    away = drops.positions_m - beams.origin_m
    ranges = np.linalg.norm(away, axis=1)
    detected = np.flatnonzero(drops.class_index >= signals.first_detected(ranges))
    listening = np.flatnonzero(listened_m > 0)
    if not len(detected) or not len(listening):
        return RainReturns.none()
    ranges, directions = ranges[detected], away[detected] / ranges[detected, None]
    half_angles = np.arcsin(np.minimum(signals.sensor.beam_width_m(ranges) / 2 / ranges, 1))
    tree = KDTree(beams.directions[listening])
    met = tree.query_ball_point(directions, 2 * np.sin(half_angles / 2), return_sorted=True)
    counts = np.array([len(each) for each in met])
    drop = np.repeat(np.arange(len(detected)), counts)
    beam = listening[np.fromiter((index for each in met for index in each), np.int64, int(counts.sum()))]
    nearer = ranges[drop] < listened_m[beam]
    drop, beam = drop[nearer], beam[nearer]
    return RainReturns(beam, ranges[drop], signals.reflectances(ranges[drop], drops.class_index[detected[drop]]))


# Optics of water in the near infrared

REFRACTIVE_INDEX = {905: 1.327, 1550: 1.318}  # of water, at wavelengths in nm (Hale and Querry 1973, Applied Optics 12)
ABSORPTION_PER_MM = {905: 0.007, 1550: 1.09}
"""Of water: 4 pi k / wavelength with k = 5.0e-7 and 1.35e-4 (Hale and Querry 1973; Kou, Labrie and Chylek 1993)."""

_MIRRORED_INSIDE = 0.472  # internal reflectance of a flat water surface for diffuse light, n = 1.33 (Saunderson 1942)


def drop_reflectance(diameter_mm: Float[np.ndarray, "*n"], wavelength_nm: int) -> Float64[np.ndarray, "*n"]:
    """Reflectance of a Lambertian disc of a drop's cross-section with the same backscatter: 0.005..0.025.

    Geometric optics of a sphere, axial rays: reflection at the front, F / 4, and at the back, (1 - F)^2 F (n / (2 -
    n))^2 / 4, attenuated by two passes through the water; F = ((n - 1) / (n + 1))^2. A disc of reflectance rho has the
    radar cross-section 4 rho A, a sphere's front reflection F A (van de Hulst 1957, chapter 12). At 1550 nm water
    absorbs so strongly that drops above a millimeter only reflect at the front. The glory is neglected: large drops are
    too flat and unsteady for it.
    """
    n = REFRACTIVE_INDEX[wavelength_nm]
    front = ((n - 1) / (n + 1)) ** 2
    back = (1 - front) ** 2 * front * (n / (2 - n)) ** 2
    passed = np.exp(-2 * ABSORPTION_PER_MM[wavelength_nm] * np.asarray(diameter_mm, np.float64))
    return (front + back * passed) / 4


def fresnel_reflectance(cosine: Float[np.ndarray, "*n"], index: float) -> Float64[np.ndarray, "*n"]:
    """Fresnel reflectance of a flat water surface for unpolarized light, by the cosine of incidence; 0..1."""
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
    """Ratio of a wet road's echo to that of the dry road, 0..1.

    With standing water, a beam crosses its surface twice, (1 - F)^2, spreads on leaving it, 1 / n^2, and is partly
    reflected back onto the road, 1 / (1 - 0.472 rho): a Lambertian ground under a flat film (Saunderson 1942, Lekner
    and Dorf 1988). The film absorbs along the slanted path down and up. Light reflected at its surface continues
    forward and is lost, so far returns at grazing angles vanish first. `cosine` of incidence, `reflectance` of the dry
    road; `wetness` is its covered share.
    """
    n = REFRACTIVE_INDEX[wavelength_nm]
    slant = np.sqrt(1 - (1 - np.asarray(cosine, np.float64) ** 2) / n**2)
    passed = np.exp(-2 * ABSORPTION_PER_MM[wavelength_nm] * film_mm / slant)
    under_film = (1 - fresnel_reflectance(cosine, n)) ** 2 * passed / (n**2 * (1 - _MIRRORED_INSIDE * reflectance))
    return 1 - wetness + wetness * under_film
