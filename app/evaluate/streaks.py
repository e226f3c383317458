"""`gsrain evaluate streaks`: comparison of rendered rain streaks with real ones."""

import logging
import math
import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

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

from ..console import Console, Table
from ..options import JsonFileOrScreen, check_writable, converted_options, table_stream, write_numbers
from ..progress import progress_bar

_OPTIONS = {"intensity_mm_h": "rain", "aperture_mm": "aperture", "rain_light": "light"}
_MIN_FRAMES, _MAX_FRAMES = 5, 200
_COLUMNS = 130
_log = logging.getLogger(__name__)


def streaks(
    real: Annotated[Path, Parameter(name="REAL_DIR", help="RainSense, or one or more of its sequences.")],
    /,
    *,
    rain: Annotated[
        float | None, Parameter(help="Intensity of ours in mm/h; default: what each sequence is labelled with.")
    ] = None,
    exposure: Annotated[str, Parameter(help="Shutter times of ours in seconds, with commas between.")] = "0.004,0.016",
    frames: Annotated[int, Parameter(help="Frames of each sequence that are measured, and rendered.")] = 16,
    window: Annotated[
        str | None, Parameter(help="LEFT,TOP,WIDTH,HEIGHT in pixels; default: all that is above the horizon.")
    ] = None,
    light: Annotated[
        Literal["linear", "display"], Parameter(help="Where light adds: in linear light, or in display values.")
    ] = "linear",
    streak_gain: Annotated[float, Parameter(help="Multiplies our streaks' opacity; 1 is physical.")] = 1.0,
    aperture: Annotated[
        float, Parameter(help="Our lens opening in mm; drops nearer than its focus, 10 m, blur with it. 0: all sharp.")
    ] = 0.0,
    seed: Annotated[int, Parameter(help="Same seed, same drops.")] = 0,
    json: JsonFileOrScreen = None,
) -> None:
    """Measure rain streaks in the frames of a static camera, and in our rain over the same background."""
    if not _MIN_FRAMES <= frames <= _MAX_FRAMES:
        raise ValueError(f"--frames {frames}: must be within {_MIN_FRAMES}..{_MAX_FRAMES}")
    check_writable(json)
    exposures = _exposures(exposure)
    part = _window(window) if window is not None else None
    sequences = _long_enough(real)
    knobs = {"rain_light": light, "streak_gain": streak_gain, "aperture_mm": aperture, "seed": seed}
    rows: list[RealRainComparison] = []
    with progress_bar("Measuring", len(sequences)) as advance:
        for sequence in sequences:
            labelled = sequence.intensity_mm_h
            ours = converted_options(
                {"intensity_mm_h": labelled if rain is None else rain, **knobs}, RainSettings, _OPTIONS
            )
            numbers = evenly_chosen(sequence, frames)
            rows.append(compare_with_real_rain(sequence, ours, exposures, numbers, part or above_horizon(sequence)))
            advance()
    report = _report(rows, frames=frames, **knobs)
    _print(rows, Console(file=table_stream(json), width=_COLUMNS))
    write_numbers(json, report)


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
    kept = [sequence for sequence in found if len(sequence) >= _MIN_FRAMES]
    if not kept:
        raise ValueError(f"{folder}: no sequence of {_MIN_FRAMES} frames or more, which a temporal median needs")
    return kept


def _report(rows: list[RealRainComparison], **settings: Any) -> dict[str, Any]:
    edges = {"length_edges_px": list(LENGTH_EDGES_PX), "angle_edges_deg": list(ANGLE_EDGES_DEG)}
    return _finite({**settings, **edges, "rows": [asdict(r) for r in rows]})


def _finite(value: Any) -> Any:
    """Replace NaN, which JSON lacks, with null."""
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def _print(rows: list[RealRainComparison], console: Console) -> None:
    table = Table("mm/h", "rain", "T ms", "std", "> 8", "< -8", "streaks", "a Mpx", box=None)
    for title in ("angle deg", "length px", "width px", "rise", "told T ms"):
        table.add_column(title)
    for row in rows:
        _add(table, f"{row.labelled_mm_h:g}", "real", row.real)
        for measured in row.ours:
            _add(table, f"{row.rendered_mm_h:g}", "ours", measured)
    console.print(table)
    console.print("Streaks before backgrounds of grey 32 to 64: medians, with what 10 and 90 % lie below.")


def _add(table: Table, intensity: str, whose: str, measured: FrameStatistics) -> None:
    residual, streak = measured.residual, measured.streak
    table.add_row(
        intensity,
        whose,
        "" if measured.exposure_s is None else f"{1e3 * measured.exposure_s:g}",
        f"{residual.std_levels:.2f}",
        f"{residual.share_above:.2%}",
        f"{residual.share_below:.2%}",
        f"{streak.streaks}",
        f"{streak.per_megapixel:.0f}",
        *(_range(each) for each in (streak.angle_deg, streak.length_px, streak.width_px, streak.rise_levels)),
        _range([1e3 * each for each in streak.exposure_s]),
    )


def _range(quantiles: list[float] | tuple[float, ...]) -> str:
    low, middle, high = quantiles
    return "" if math.isnan(middle) else f"{middle:.1f} ({low:.1f}..{high:.1f})"
