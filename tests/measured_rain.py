"""Spectra of drops drawn from a known law, as a Parsivel would count them."""

import numpy as np

from gsrain_engine.disdrometer.spectra import DropSpectra
from gsrain_engine.rain.properties import DropSizes

DIAMETER_EDGES_MM = np.concatenate(
    [[0], np.cumsum([0.125] * 10 + [0.25] * 5 + [0.5] * 5 + [1] * 5 + [2] * 5 + [3] * 2)]
)
VELOCITY_EDGES_M_S = np.concatenate(
    [[0], np.cumsum([0.1] * 10 + [0.2] * 5 + [0.4] * 5 + [0.8] * 5 + [1.6] * 5 + [3.2] * 2)]
)


def fall_speed(diameter_mm):
    return -0.342 * diameter_mm**2 + 3.379 * diameter_mm + 0.340


def measured_rain(density_m3, shape, scale_mm, *, minutes, seed, area_m2=0.0054, start="2024-05-01T10:00", scatter=0.0):
    """Records of 30 s. Each drop of the air is counted in proportion to its speed, at that speed."""
    rng = np.random.default_rng(seed)
    sizes, records = DropSizes(shape, scale_mm), 2 * minutes
    grid = sizes.quantile((np.arange(200_000) + 0.5) / 200_000)
    rate = density_m3 * area_m2 * 30 * np.mean(fall_speed(grid))
    counts = np.empty((records, len(DIAMETER_EDGES_MM) - 1, len(VELOCITY_EDGES_M_S) - 1))
    chance = fall_speed(grid) / fall_speed(grid).sum()
    reported = np.empty(records)
    for i in range(records):
        drops = rng.choice(grid, rng.poisson(rate), p=chance)
        speeds = fall_speed(drops) * (1 + scatter * rng.standard_normal(len(drops)))
        counts[i] = np.histogram2d(drops, speeds, [DIAMETER_EDGES_MM, VELOCITY_EDGES_M_S])[0]
        reported[i] = 3600 / 30 * np.pi / 6 * np.sum(drops**3) / (1e6 * area_m2)
    counts[:, :2] = 0  # as a Parsivel
    return DropSpectra(
        instrument="OTT Parsivel",
        times=np.datetime64(start, "ms") + np.arange(1, records + 1) * np.timedelta64(30, "s"),
        seconds=np.full(records, 30.0),
        diameter_edges_mm=DIAMETER_EDGES_MM,
        velocity_edges_m_s=VELOCITY_EDGES_M_S,
        counts=counts,
        area_m2=np.full(counts.shape[1], area_m2),
        reported_mm_h=reported,
    )
