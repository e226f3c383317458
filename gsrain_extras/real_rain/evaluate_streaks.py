"""`gsrain evaluate streaks`: streaks of real rain, and of ours over the same background."""

import logging
import math
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from app.console import print_lines, progress_bar
from app.options import JsonFileOrScreen, StructOptions, check_within, option, options_of, setting, takes_set
from app.outputs import check_ending, check_writable, table_stream, write_numbers
from gsrain_engine.rain.settings import RainSettings

if TYPE_CHECKING:
    from gsrain_engine.datasets.rainsense import RainSequence
    from gsrain_engine.report.table import Cell, Table
    from gsrain_engine.scene.sensor import Sensor

    from .comparison import FrameStatistics, RealRainComparison
    from .pairs import RainyPlace
    from .photograph import Window


_AIR = ("wind_speed_m_s", "wind_from_deg", "gust_m_s", "turbulence_m_s")
if TYPE_CHECKING:
    RenderedOptions = StructOptions
else:
    RenderedOptions = options_of(
        RainSettings,
        defaults={"intensity_mm_h": "that of each sequence", "sensor": "rainsense"}
        | dict.fromkeys((*_AIR, "calibration"), "that of --conditions"),
        topic="Rain",
        names=("intensity_mm_h", "seed", *_AIR, "calibration", "model", "streak_gain", "sensor", "aperture_mm"),
        fixed={"exposure_s": "--exposure"},
    )
_MIN_FRAMES, _MAX_FRAMES = 5, 200
_log = logging.getLogger(__name__)


@takes_set
def streaks(
    real: Annotated[Path, option("RainSense, or one or more of its sequences.", "REAL_DIR")],
    /,
    *,
    rain: RenderedOptions | None = None,
    exposure: Annotated[
        str | None, setting(RainSettings, "exposure_s", "Several with commas. Default: that of --conditions.", "Rain")
    ] = None,
    conditions: Annotated[
        str, option("Shutter and air of each sequence: rainsense, or a file as of gsrain schema real_rain.")
    ] = "rainsense",
    frames: Annotated[int, option("Number of frames of each sequence to measure, and to render.")] = 20,
    window: Annotated[str | None, option("LEFT,TOP,WIDTH,HEIGHT in pixels; default: above the horizon.")] = None,
    report: Annotated[
        Path | None, option("Write one table, real beside ours, with intervals, to this file (.md).")
    ] = None,
    pairs: Annotated[
        Path | None,
        option("Write 40 unlabeled pairs of pictures, real beside ours, to this folder; the key goes next to it."),
    ] = None,
    fit_sensor: Annotated[
        Path | None,
        option("Only fit noise and signal processing of --sensor to the frames without rain; write it to this file."),
    ] = None,
    json: JsonFileOrScreen = None,
) -> None:
    """Compare rendered rain streaks with real ones."""
    from gsrain_engine.report.numbers import finite_numbers, write_text
    from gsrain_engine.scene.camera import DEFAULT_EXPOSURE_S
    from gsrain_engine.scene.sensor import DEFAULT_SENSOR, load_sensor

    from .comparison import (
        RealRainComparison,
        above_horizon,
        compare_with_real_rain,
        evenly_chosen,
        load_conditions,
    )
    from .pairs import RainyPlace
    from .report import markdown
    from .streaks import ANGLE_EDGES_DEG, LENGTH_EDGES_PX

    check_within("--frames", frames, _MIN_FRAMES, _MAX_FRAMES)
    check_ending("--report", report, (".md",))
    key = None if pairs is None else pairs.with_name(f"{pairs.name}_key.json")
    check_ending("--fit-sensor", fit_sensor, (".yaml", ".yml"))
    check_writable(report, key, json, fit_sensor, folders=[pairs])
    exposures = _exposures(exposure) if exposure is not None else None
    part = _window(window) if window is not None else None
    known = load_conditions(conditions)
    sequences = _long_enough(real)
    options = rain or RenderedOptions()
    plain = options.settings(RainSettings(sensor="rainsense"))
    if fit_sensor is not None:
        _fit(sequences, load_sensor(plain.sensor or DEFAULT_SENSOR), frames, part, fit_sensor)
        return
    knobs = {name: getattr(plain, name) for name in ("model", "streak_gain", "sensor", "aperture_mm", "seed")}
    rows: list[RealRainComparison] = []
    places: list[RainyPlace] = []
    with progress_bar("Measuring", len(sequences)) as advance:
        for sequence in sequences:
            day = known.of(sequence.intensity_mm_h)
            ours = options.settings(day.rain("rainsense"))
            shutter = day.shutter_s or load_sensor(ours.sensor or DEFAULT_SENSOR).shutter_s or DEFAULT_EXPOSURE_S
            numbers = evenly_chosen(sequence, frames, day.middle_frame)
            shutters = exposures or [shutter]
            place = part or above_horizon(sequence)
            rows.append(compare_with_real_rain(sequence, ours, shutters, numbers, place))
            places.append(RainyPlace(sequence, ours, shutters[0], place, day.middle_frame))
            advance()
    print_lines(streaks_table(rows).text, file=table_stream(json))
    edges = {"length_edges_px": list(LENGTH_EDGES_PX), "angle_edges_deg": list(ANGLE_EDGES_DEG)}
    plain_rows = [_plain(row) for row in rows]
    write_numbers(json, finite_numbers({"frames": frames, **knobs, **edges, "rows": plain_rows}))
    if report is not None:
        write_text(report, markdown(rows))
    if pairs is not None and key is not None:
        _write_pairs(places, pairs, key)


def _plain(row: "RealRainComparison") -> dict[str, Any]:
    names = ("sequence", "labelled_mm_h", "rendered_mm_h", "window", "numbers", "sky_levels")
    measured = {"real": asdict(row.real.statistics), "ours": [asdict(each.statistics) for each in row.ours]}
    return {name: getattr(row, name) for name in names} | measured


def _write_pairs(places: "list[RainyPlace]", folder: Path, key: Path) -> None:
    """Write pairs as PNG, and which side is real to another file."""
    from gsrain_engine.render.images import write_png

    from .pairs import PAIRS, unlabeled_pairs

    folder.mkdir(parents=True, exist_ok=True)
    found: list[dict[str, Any]] = []
    for number, pair in enumerate(unlabeled_pairs(places, PAIRS), start=1):
        name = f"pair_{number:02}.png"
        write_png(folder / name, pair.picture)
        found.append({"picture": name, "real": pair.real_side, "sequence": pair.sequence, "frame": pair.frame})
    write_numbers(key, {"pairs": found})


def _fit(sequences: "list[RainSequence]", sensor: "Sensor", frames: int, part: "Window | None", file: Path) -> None:
    """Write a sensor whose noise is that of the first sequence, if it is one without rain."""
    import msgspec

    from gsrain_engine.report.numbers import write_text

    from .camera_noise import FIT_TRIALS, CameraNoise, fitted_sensor
    from .comparison import above_horizon, evenly_chosen

    sequence = sequences[0]
    if sequence.intensity_mm_h > 0:
        raise ValueError(f"--fit-sensor {file}: takes a sequence without rain, {sequence.name} has rain")
    x, y, width, height = part or above_horizon(sequence)
    rows, columns = slice(y, y + height), slice(x, x + width)
    colors = [sequence.picture(k)[rows, columns] for k in evenly_chosen(sequence, frames)]
    noise = CameraNoise.of(colors)
    with progress_bar("Fitting", FIT_TRIALS) as advance:
        fitted = fitted_sensor(noise, sensor, sequence.camera.height, advance, FIT_TRIALS)
    write_text(file, msgspec.yaml.encode(fitted).decode())


def _exposures(text: str) -> list[float]:
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"\d*\.?\d+(e-?\d+)?", word) and 1e-5 <= float(word) <= 1 for word in words):
        raise ValueError(f"--exposure {text}: expected seconds within 0.00001..1 such as 0.004,0.016")
    return [float(word) for word in dict.fromkeys(words)]


def _window(text: str) -> "Window":
    match = re.fullmatch(r"(\d+),(\d+),(\d+),(\d+)", text)
    if match is None:
        raise ValueError(f"--window {text}: expected LEFT,TOP,WIDTH,HEIGHT in pixels such as 0,0,1920,540")
    left, top, width, height = (int(word) for word in match.groups())
    return left, top, width, height


def _long_enough(folder: Path) -> "list[RainSequence]":
    from gsrain_engine.datasets.rainsense import find_rain_sequences

    found = find_rain_sequences(folder)
    for sequence in found:
        if len(sequence) < _MIN_FRAMES:
            _log.warning("%s: %d frames, left out", sequence.name, len(sequence))
    long_enough = [sequence for sequence in found if len(sequence) >= _MIN_FRAMES]
    if not long_enough:
        raise ValueError(f"{folder}: no sequence of {_MIN_FRAMES} frames or more, which a temporal median needs")
    return long_enough


_STREAKS = {
    "mm/h": "g", "rain": "", "T ms": "g", "std": ".2f", "> 8": ".2%", "< -8": ".2%", "streaks": "", "a Mpx": ".0f",
    "angle deg": "", "length px": "", "width px": "", "rise": "", "told T ms": "",
}  # fmt: skip


_STREAKS_CAPTION = "Streaks before backgrounds of gray 32 to 64: medians, with what 10 and 90 % lie below."


def streaks_table(rows: "Sequence[RealRainComparison]") -> "Table":
    """Return the table of the streaks, ours below the real ones."""
    from gsrain_engine.report.table import Table, columns

    own = [
        each
        for row in rows
        for each in (
            _cells(row.labelled_mm_h, "real", row.real.statistics),
            *(_cells(row.rendered_mm_h, "ours", measured.statistics) for measured in row.ours),
        )
    ]
    return Table("Streaks", columns(_STREAKS), own, _STREAKS_CAPTION)


def _cells(intensity: float, whose: str, measured: "FrameStatistics") -> "tuple[Cell, ...]":
    residual, streak = measured.residual, measured.streak
    exposure = None if measured.exposure_s is None else 1e3 * measured.exposure_s
    ranges = streak.angle_deg, streak.length_px, streak.width_px, streak.rise_levels
    return (
        intensity, whose, exposure, residual.std_levels, residual.share_above, residual.share_below,
        streak.streaks, streak.per_megapixel,
        *map(_range, (*ranges, [1e3 * each for each in streak.exposure_s])),
    )  # fmt: skip


def _range(quantiles: Sequence[float]) -> str | None:
    low, middle, high = quantiles
    return None if math.isnan(middle) else f"{middle:.1f} ({low:.1f}..{high:.1f})"
