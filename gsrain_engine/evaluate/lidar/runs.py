"""Turns of a lidar under several intensities and seeds: the same drops' numbers at every intensity of a seed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rain_state import RainState
from gsrain_engine.rain.rainfall import Rainfall

from .drop_echoes import DropSignals
from .sweep_in_rain import Answer, SweepInRain, sweep_in_rain
from .tally import Tally
from .turns import Turn

NEAR_STEP_M = 0.5
"""Width of the bins in which drops near the sensor are counted."""
_NEAR_M = 2.0
_JUST = 1 + 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class RunCounts:
    """What came of one turn in one rain, without the points."""

    turn: str
    """Its name."""
    range_m: float
    """Of the sensor, at 10 %."""
    state: RainState
    seed: int
    wetness: float
    """Of the road; 0 where that is left out."""
    at_threshold: int
    """Clear returns of which no more is known than that they were detected: any rain loses them."""
    tally: Tally
    near: Tally


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One turn in one rain."""

    turn: Turn
    state: RainState
    seed: int
    wetness: float
    rainy: SweepInRain
    tally: Tally
    near: Tally
    """In fine bins, as far as drops are detected."""

    @property
    def without_points(self) -> "RunCounts":
        """What is worth keeping of many runs."""
        sensor, beams = self.turn.sensor, self.turn.beams
        signals = sensor.signal(beams.ranges_m[beams.is_echo], beams.reflectances[beams.is_echo], 0.0)
        return RunCounts(
            turn=self.turn.name,
            range_m=sensor.range_m,
            state=self.state,
            seed=self.seed,
            wetness=self.wetness,
            at_threshold=int(np.sum(signals < _JUST)),
            tally=self.tally,
            near=self.near,
        )


def runs(
    turn: Turn, intensities_mm_h: Sequence[float], seeds: Sequence[int], *, answer: Answer, wet_road: bool
) -> Iterator[Run]:
    """Rain on a turn: all seeds of the first intensity, then of the next."""
    rains = [Rain(intensity_mm_h=intensity) for intensity in intensities_mm_h]
    reach = max(DropSignals(turn.sensor, Rainfall.start(rain).state).reach_m for rain in rains)
    edges = near_edges(reach)
    for intensity in intensities_mm_h:
        for seed in seeds:
            rainfall = Rainfall.start(Rain(intensity_mm_h=intensity, seed=seed))
            rainy = sweep_in_rain(
                turn.beams, turn.sensor, rainfall, turn.anchor_to_world, answer=answer, wet_road=wet_road
            )
            yield Run(
                turn=turn,
                state=rainfall.state,
                seed=seed,
                wetness=rainfall.wetness_at(turn.beams.time_s) if wet_road else 0.0,
                rainy=rainy,
                tally=Tally.of(turn.beams, rainy),
                near=Tally.of(turn.beams, rainy, edges),
            )


def near_edges(reach_m: float) -> tuple[float, ...]:
    """Edges of fine bins up to a range, 2 m at least."""
    return tuple(float(NEAR_STEP_M * k) for k in range(int(np.ceil(max(reach_m, _NEAR_M) / NEAR_STEP_M)) + 1))
