"""Echoes of drops outside the simulated field: as many, as far and as large as the spectrum says."""

import numpy as np
from jaxtyping import Float64
from scipy.stats import poisson

from gsrain_engine.rain.drop_sizes import CLASSES
from gsrain_engine.rain.rain import Box

from .beams import Beams
from .drop_echoes import DropEchoes, DropSignals

_MOST = 4
"""Drops of one beam that are drawn: there are seldom two."""

_Span = tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]


def far_echoes(
    beams: Beams, listened_m: Float64[np.ndarray, " n"], simulated: _Span, signals: DropSignals, seed: int
) -> DropEchoes:
    """Draw detected drops along each beam up to `listened_m`, but for the `simulated` span, from where to where (m).

    Numbers are Poisson of the integral of the detected spectrum over the beam's volume, ranges are spread as it grows,
    sizes are those of the detected part of the spectrum at that range. The same seed draws the same numbers at all
    intensities, so that more rain only adds.
    """
    draws = np.random.default_rng(seed).random((len(beams), 1 + 2 * _MOST))
    start, end = (np.minimum(each, listened_m) for each in simulated)
    left_out = signals.expected_up_to(start), signals.expected_up_to(end)
    mean = signals.expected_up_to(listened_m) - (left_out[1] - left_out[0])
    counts = np.minimum(poisson.ppf(draws[:, 0], np.maximum(mean, 0)), _MOST).astype(np.int64)
    beam = np.repeat(np.arange(len(beams)), counts)
    turn = np.arange(len(beam)) - np.repeat(np.cumsum(counts) - counts, counts)
    place, size = draws[beam, 1 + 2 * turn], draws[beam, 2 + 2 * turn]
    wanted = place * mean[beam]
    wanted += np.where(wanted > left_out[0][beam], (left_out[1] - left_out[0])[beam], 0)
    ranges = np.interp(wanted, signals.expected, signals.grid_m)
    smallest = np.minimum(signals.first_detected(ranges), CLASSES - 1)
    classes = smallest + np.floor(size * (CLASSES - smallest)).astype(np.int64)
    return DropEchoes(beam, ranges, signals.reflectances(ranges, classes))


def span_in_box(beams: Beams, box: Box, frame: Float64[np.ndarray, "4 4"]) -> _Span:
    """From where to where each beam is in a box of a frame, in metres; 0 and 0 where it misses it."""
    turn = frame[:3, :3]
    origin, directions = turn.T @ (beams.origin_m - frame[:3, 3]), beams.directions @ turn
    directions = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
    faces = np.stack([(np.array(face) - origin) / directions for face in (box.minimum_m, box.maximum_m)])
    enter, leave = faces.min(axis=0).max(axis=1), faces.max(axis=0).min(axis=1)
    met = leave > np.maximum(enter, 0)
    return np.where(met, np.maximum(enter, 0), 0), np.where(met, leave, 0)
