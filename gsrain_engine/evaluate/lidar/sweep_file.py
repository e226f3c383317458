"""Writes a sweep in rain as an NPZ file, the same bytes for the same sweep."""

from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.scene.atomic_files import whole_file

from .sweep_in_rain import SweepInRain


def write_sweep(path: Path, rainy: SweepInRain) -> None:
    """Write `points_m` (world), `origin_m`, `time_s`, `is_false`, `beams`, `fates` and `signals`, and `intensities`.

    `beams` says which beam (of a capture: which row of the clear sweep) each point comes from, `fates` what became of
    each beam's clear echo: 0 there was none, 1 kept, 2 dropped, 3 masked. The file appears whole or not at all.
    """
    columns: dict[str, Any] = {
        "points_m": rainy.sweep.points_m,
        "origin_m": rainy.sweep.origin_m,
        "time_s": np.float64(rainy.sweep.time_s),
        "is_false": rainy.is_false,
        "beams": rainy.beams,
        "fates": rainy.fates,
        "signals": rainy.signals.astype(np.float32),
    }
    if rainy.sweep.intensities is not None:
        columns["intensities"] = rainy.sweep.intensities
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside, beside.open("wb") as file:
        np.savez_compressed(file, **columns)
