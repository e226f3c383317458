"""Echoes of the very drops that the cameras see: those of the simulated field around the car."""

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from gsrain_engine.rain.streak_field import StreakField

from .beams import Beams
from .drop_echoes import DropEchoes, DropSignals


def field_echoes(
    field: StreakField, beams: Beams, listened_m: Float64[np.ndarray, " n"], signals: DropSignals
) -> DropEchoes:
    """Find the drops of the field that stand in beams at one moment and are detected, each nearer than `listened_m`.

    A drop is in every beam whose axis passes its centre within half the beam's width.
    """
    drops = field.region_drops()
    away = field.positions(drops) - beams.origin_m
    ranges = np.linalg.norm(away, axis=1)
    seen = np.flatnonzero(drops.class_index >= signals.first_detected(ranges))
    listening = np.flatnonzero(listened_m > 0)
    if not len(seen) or not len(listening):
        return DropEchoes(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    ranges, directions = ranges[seen], away[seen] / ranges[seen, None]
    half_angles = np.arcsin(np.minimum(signals.sensor.beam_width_m(ranges) / 2 / ranges, 1))
    tree = KDTree(beams.directions[listening])
    met = tree.query_ball_point(directions, 2 * np.sin(half_angles / 2), return_sorted=True)
    counts = np.array([len(each) for each in met])
    drop = np.repeat(np.arange(len(seen)), counts)
    beam = listening[np.fromiter((index for each in met for index in each), np.int64, int(counts.sum()))]
    nearer = ranges[drop] < listened_m[beam]
    drop, beam = drop[nearer], beam[nearer]
    return DropEchoes(beam, ranges[drop], signals.reflectances(ranges[drop], drops.class_index[seen[drop]]))
