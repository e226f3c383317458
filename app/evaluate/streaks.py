"""`gsrain evaluate streaks`: comparison of rendered rain streaks with real ones."""

import logging
import math
import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from gsrain_engine.datasets.rainsense import RainSequence, find_rain_sequences
from gsrain_engine.evaluation.streaks import (
    ANGLE_EDGES_DEG,
    LENGTH_EDGES_PX,
    FrameStatistics,
    RealRainComparison,
    Window,
    above_horizon,
    compare_with_real_rain,
    evenly_chosen,
)
from gsrain_engine.rain.settings import RainSettings

from ..console import Console, Table, progress_bar, table_of
from ..options import JsonFileOrScreen, check_within, option, options_of, setting
from ..outputs import check_writable, finite_numbers, table_stream, write_numbers

RenderedOptions = options_of(
    RainSettings, "evaluate streaks", defaults={"intensity_mm_h": "that of each sequence", "sensor": "pinhole"}
)
_MIN_FRAMES, _MAX_FRAMES = 5, 200
_COLUMNS = 130
_log = logging.getLogger(__name__)


def streaks(
    real: Annotated[Path, option("RainSense, or one or more of its sequences.", "REAL_DIR")],
    /,
    *,
    rain: RenderedOptions | None = None,
    exposure: Annotated[str, setting(RainSettings, "exposure_s", "Several with commas.")] = "0.004,0.016",
    frames: Annotated[int, option("Number of frames of each sequence to measure, and to render.")] = 16,
    window: Annotated[str | None, option("LEFT,TOP,WIDTH,HEIGHT in pixels; default: above the horizon.")] = None,
    json: JsonFileOrScreen = None,
) -> None:
    """Measure rain streaks in the frames of a static camera, and in our rain over the same background."""
    check_within("--frames", frames, _MIN_FRAMES, _MAX_FRAMES)
    check_writable(json)
    exposures = _exposures(exposure)
    part = _window(window) if window is not None else None
    sequences = _long_enough(real)
    options = rain or RenderedOptions()
    plain = options.settings(RainSettings(sensor="pinhole"))
    knobs = {name: getattr(plain, name) for name in ("rain_light", "streak_gain", "sensor", "aperture_mm", "seed")}
    rows: list[RealRainComparison] = []
    with progress_bar("Measuring", len(sequences)) as advance:
        for sequence in sequences:
            ours = options.settings(RainSettings(intensity_mm_h=sequence.intensity_mm_h, sensor="pinhole"))
            numbers = evenly_chosen(sequence, frames)
            rows.append(compare_with_real_rain(sequence, ours, exposures, numbers, part or above_horizon(sequence)))
            advance()
    _print(rows, Console(file=table_stream(json), width=_COLUMNS))
    edges = {"length_edges_px": list(LENGTH_EDGES_PX), "angle_edges_deg": list(ANGLE_EDGES_DEG)}
    write_numbers(json, finite_numbers({"frames": frames, **knobs, **edges, "rows": [asdict(row) for row in rows]}))


def _exposures(text: str) -> list[float]:
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"\d*\.?\d+(e-?\d+)?", word) and 1e-5 <= float(word) <= 1 for word in words):
        raise ValueError(f"--exposure {text}: expected seconds within 0.00001..1 such as 0.004,0.016")
    return [float(word) for word in dict.fromkeys(words)]


def _window(text: str) -> Window:
    match = re.fullmatch(r"(\d+),(\d+),(\d+),(\d+)", text)
    if match is None:
        raise ValueError(f"--window {text}: expected LEFT,TOP,WIDTH,HEIGHT in pixels such as 0,0,1920,540")
    left, top, width, height = (int(word) for word in match.groups())
    return left, top, width, height


def _long_enough(folder: Path) -> list[RainSequence]:
    found = find_rain_sequences(folder)
    for sequence in found:
        if len(sequence) < _MIN_FRAMES:
            _log.warning("%s: %d frames, left out", sequence.name, len(sequence))
    long_enough = [sequence for sequence in found if len(sequence) >= _MIN_FRAMES]
    if not long_enough:
        raise ValueError(f"{folder}: no sequence of {_MIN_FRAMES} frames or more, which a temporal median needs")
    return long_enough


def _print(rows: list[RealRainComparison], console: Console) -> None:
    titles = "mm/h,rain,T ms,std,> 8,< -8,streaks,a Mpx,angle deg,length px,width px,rise,told T ms"
    table = table_of(titles, wraps=True)
    for row in rows:
        _add(table, f"{row.labelled_mm_h:g}", "real", row.real)
        for measured in row.ours:
            _add(table, f"{row.rendered_mm_h:g}", "ours", measured)
    console.print(table)
    console.print("Streaks before backgrounds of gray 32 to 64: medians, with what 10 and 90 % lie below.")


def _add(table: Table, intensity: str, whose: str, measured: FrameStatistics) -> None:
    residual, streak = measured.residual, measured.streak
    exposure = "" if measured.exposure_s is None else f"{1e3 * measured.exposure_s:g}"
    shares = f"{residual.share_above:.2%}", f"{residual.share_below:.2%}"
    counts = f"{streak.streaks}", f"{streak.per_megapixel:.0f}"
    ranges = streak.angle_deg, streak.length_px, streak.width_px, streak.rise_levels
    exposures = _range([1e3 * each for each in streak.exposure_s])
    table.add_row(
        intensity, whose, exposure, f"{residual.std_levels:.2f}", *shares, *counts, *map(_range, ranges), exposures
    )


def _range(quantiles: list[float] | tuple[float, ...]) -> str:
    low, middle, high = quantiles
    return "" if math.isnan(middle) else f"{middle:.1f} ({low:.1f}..{high:.1f})"
