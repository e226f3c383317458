"""A lidar's turn in rain: weak echoes are lost, ranges get noisier, drops answer in place of things.

The lidar equation with rain as what weakens and as a target: Rasshofer, Spies and Spies 2011 (Advances in Radio Science
9); Goodin, Carruth, Doude and Hudson 2019 (Electronics 8:89); Kilic et al. 2021 (LISA); Hasirlioglu and Riener 2017.
Unlike theirs, drops, sizes and extinction are those of the rain that the cameras see.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int8, Int64

from gsrain_engine.datasets.capture import Sweep
from gsrain_engine.rain.rainfall import Rainfall, View
from gsrain_engine.rain.wetness import water_depth_mm
from gsrain_engine.scene.camera import Camera

from .beams import Beams
from .drop_echoes import DropEchoes, DropSignals
from .far_echoes import far_echoes, span_in_box
from .field_echoes import field_echoes
from .sensor import LidarSensor
from .water import wet_road_share

Answer = Literal["strongest", "first", "last"]


class Fate(IntEnum):
    """What became of a beam's clear echo."""

    NOTHING = 0
    """There was none."""
    KEPT = 1
    DROPPED = 2
    """Too weak in rain."""
    MASKED = 3
    """Detectable, but a drop answered in its place."""


@dataclass(frozen=True, slots=True, eq=False)
class SweepInRain:
    """What a sensor reports in rain, and what it would have in clear air."""

    sweep: Sweep
    """World, metres; intensities as in clear air where those are known."""
    beams: Int64[np.ndarray, " m"]
    """The beam of each point."""
    is_false: Bool[np.ndarray, " m"]
    """Which points are drops."""
    fates: Int8[np.ndarray, " n"]
    """A `Fate` for each beam."""
    signals: Float64[np.ndarray, " m"]
    """Power of each point in multiples of what is just detected; 0 for what rain leaves alone."""

    @property
    def false_ranges_m(self) -> Float64[np.ndarray, " k"]:
        return np.linalg.norm(self.sweep.points_m[self.is_false].astype(np.float64) - self.sweep.origin_m, axis=1)


class _Chosen(NamedTuple):
    """The drop that may answer in a beam."""

    beams: Int64[np.ndarray, " m"]
    ranges_m: Float64[np.ndarray, " m"]
    reflectances: Float64[np.ndarray, " m"]
    signals: Float64[np.ndarray, " m"]


def sweep_in_rain(
    beams: Beams,
    sensor: LidarSensor,
    rainfall: Rainfall,
    anchor_to_world: Float64[np.ndarray, "4 4"],
    *,
    answer: Answer = "strongest",
    wet_road: bool = True,
) -> SweepInRain:
    """Return what a sensor reports in rain, by its beams in clear air.

    Extinction is beta(R) of `RainState`, two ways. Drops are those of the rain's own field at the beams' time inside
    its streak region, which stands in the frame `anchor_to_world`, and Poisson ones beyond. Of a beam's echoes the
    strongest (over what is just detected there), the first or the last is reported. Range noise is what rain adds to
    that of clear air. The rain's seed fixes everything; without rain and wetness the points come back, to the bit.
    """
    rainfall = rainfall.moment(beams.time_s)
    state, seed = rainfall.state, rainfall.rain.seed
    ranges = np.where(beams.is_echo, beams.ranges_m, 1.0)
    faded = np.exp(-2 * state.extinction_per_m * ranges)
    if wet_road:
        faded *= _wet_road(beams, sensor, rainfall)
    clear = np.where(beams.is_echo, sensor.signal(ranges, beams.reflectances, 0.0), 0.0)
    signals = clear * faded
    chosen = _answering_drops(beams, sensor, rainfall, anchor_to_world, answer)
    # What was just detected stays detected where nothing fades: rounding must not lose it.
    heard = beams.is_echo & ((signals >= 1) | (faded == 1))
    by_drop = np.zeros(len(beams), bool)
    by_drop[chosen.beams] = _drop_answers(answer, chosen, heard, signals)
    fates = np.full(len(beams), Fate.NOTHING, np.int8)
    fates[beams.is_echo] = Fate.DROPPED
    fates[heard] = Fate.KEPT
    fates[heard & by_drop] = Fate.MASKED
    kept = np.flatnonzero((fates == Fate.KEPT) | beams.untouched)
    false = chosen.beams[by_drop[chosen.beams]]
    drop = _Chosen(*(column[by_drop[chosen.beams]] for column in chosen))
    noise = np.random.default_rng([seed, _moment(beams.time_s), 1]).standard_normal(len(beams))
    moved = noise * _added_sigma(sensor, clear, signals)
    moved[beams.untouched] = 0
    true_points = (beams.points_m + beams.directions * moved[:, None])[kept]
    spread = drop.ranges_m + noise[false] * sensor.range_sigma(drop.signals)
    false_points = beams.origin_m + beams.directions[false] * np.maximum(spread, sensor.blind_m)[:, None]
    order = np.argsort(np.concatenate([kept, false]), kind="stable")
    points = np.concatenate([true_points, false_points]).astype(np.float32)[order]
    intensities = _intensities(beams, faded, kept, drop, state.extinction_per_m)
    return SweepInRain(
        sweep=Sweep(beams.time_s, points, beams.origin_m, None if intensities is None else intensities[order]),
        beams=np.concatenate([kept, false])[order],
        is_false=(np.arange(len(order)) >= len(kept))[order],
        fates=fates,
        signals=np.concatenate([signals[kept], drop.signals])[order],
    )


def levelled_frame(
    forward: Sequence[float] | Float64[np.ndarray, "3"], origin_m: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "4 4"]:
    """Frame of the rain's regions: x along a heading, z up, without tilt."""
    length = float(np.hypot(forward[0], forward[1]))
    x, y = (forward[0] / length, forward[1] / length) if length > 1e-6 else (1.0, 0.0)
    frame = np.eye(4)
    frame[:2, :2] = [[x, -y], [y, x]]
    frame[:3, 3] = origin_m
    return frame


def _wet_road(beams: Beams, sensor: LidarSensor, rainfall: Rainfall) -> Float64[np.ndarray, " n"]:
    """Share of each echo that a wet road leaves; 1 for all but the road."""
    shares, wetness = np.ones(len(beams)), rainfall.wetness_at(beams.time_s)
    road = np.flatnonzero(beams.is_echo & (beams.road_cosines > 0))
    if wetness > 0 and len(road):
        cosines = beams.road_cosines[road]
        matt = np.clip(beams.reflectances[road] / cosines, 0, 1)
        film = water_depth_mm(rainfall.state.intensity_mm_h)
        shares[road] = wet_road_share(cosines, matt, wetness, film, sensor.wavelength_nm)
    return shares


def _answering_drops(
    beams: Beams, sensor: LidarSensor, rainfall: Rainfall, anchor_to_world: Float64[np.ndarray, "4 4"], answer: Answer
) -> _Chosen:
    """The one drop of each beam that would answer if the beam met nothing else."""
    if rainfall.state.intensity_mm_h == 0:
        return _Chosen(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0))
    signals = DropSignals(sensor, rainfall.state)
    listened = np.where(beams.untouched, 0, np.minimum(beams.ranges_m - sensor.pulse_m, signals.reach_m))
    listened = np.maximum(listened, 0)
    view = View(Camera.from_fov(1, 1, 45.0, np.eye(4)), anchor_to_world, np.zeros(3))
    field = rainfall.streak_field(beams.time_s, view)
    simulated = span_in_box(beams, rainfall.rain.streak_region, anchor_to_world)
    seed = np.random.default_rng([rainfall.rain.seed, _moment(beams.time_s), 2]).integers(2**63)
    found = DropEchoes.joined(
        field_echoes(field, beams, listened, signals), far_echoes(beams, listened, simulated, signals, int(seed))
    )
    strength = sensor.signal(found.ranges_m, found.reflectances, rainfall.state.extinction_per_m)
    first = {"strongest": -strength, "first": found.ranges_m, "last": -found.ranges_m}[answer]
    order = np.lexsort((first, found.beams))
    best = order[np.unique(found.beams[order], return_index=True)[1]]
    return _Chosen(found.beams[best], found.ranges_m[best], found.reflectances[best], strength[best])


def _drop_answers(
    answer: Answer, drops: _Chosen, heard: Bool[np.ndarray, " n"], signals: Float64[np.ndarray, " n"]
) -> Bool[np.ndarray, " m"]:
    """Whether each drop is reported: always where the thing behind it isn't heard."""
    if answer == "first":
        return np.ones(len(drops.beams), bool)
    wins = drops.signals > signals[drops.beams] if answer == "strongest" else np.zeros(len(drops.beams), bool)
    return ~heard[drops.beams] | wins


def _added_sigma(
    sensor: LidarSensor, clear: Float64[np.ndarray, " n"], rainy: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Standard deviation that rain adds to a range: the points of a clear sweep have their own noise already."""
    before, after = (sensor.range_sigma(np.maximum(each, 1)) ** 2 for each in (clear, rainy))
    return np.sqrt(np.maximum(after - before, 0))


def _intensities(
    beams: Beams,
    faded: Float64[np.ndarray, " n"],
    kept: Int64[np.ndarray, " k"],
    drops: _Chosen,
    extinction_per_m: float,
) -> Float32[np.ndarray, " m"] | None:
    """What the sensor takes the reflectance for: it knows the range, and nothing of the rain."""
    if beams.intensities is None:
        return None
    true = beams.intensities[kept] * np.where(beams.untouched, 1, faded)[kept]
    false = beams.full_intensity * drops.reflectances * np.exp(-2 * extinction_per_m * drops.ranges_m)
    return np.concatenate([true, false]).astype(np.float32)


def _moment(time_s: float) -> int:
    """A time as a whole number that seeds draws: microseconds."""
    return round(time_s * 1e6) % 2**32
