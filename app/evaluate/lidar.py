"""`gsrain evaluate lidar`: lidar returns in rain, by intensity and range."""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from jaxtyping import Int64
from PIL import Image

from gsrain_engine.evaluation.lidar.results import RainRun, RainRunCounts, write_figure
from gsrain_engine.evaluation.lidar.results import rain_runs as lidar_runs
from gsrain_engine.evaluation.lidar.scan import Answer, LidarTurn, capture_turns, scene_turns, write_sweep
from gsrain_engine.evaluation.lidar.sensor import SENSORS, LidarSensor
from gsrain_engine.evaluation.report import ReportFigure, ReportTable, RunReport, input_fingerprint, write_report
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.properties import extinction_note
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.safe_io.file_names import file_word
from gsrain_engine.safe_io.text_files import read_whole, yaml_values
from gsrain_engine.scene.open import file_hash, scene_hash

from ..console import Console, Table, progress_bar, table_of
from ..options import (
    AllowOutside,
    JsonFileOrScreen,
    check_within,
    converted_options,
    let_names_lead_outside,
    option,
    options_of,
    parse_intensities,
    setting,
)
from ..outputs import (
    claim_outputs,
    finite_numbers,
    provenance_lines,
    run_provenance,
    table_stream,
    write_numbers,
    write_text,
)
from ..scene import names_scene

_COLUMNS = 130
DetectionOptions = options_of(
    LidarSensor,
    "evaluate lidar",
    defaults={"range_m": "the sensor's; of a capture, estimated", "least_reflectance": "the sensor's"},
)

_Runs = Mapping[float, Sequence[RainRunCounts]]
"""Runs by intensity in mm/h."""


def lidar(
    source: Annotated[str, option("Scene, or capture with lidar; default: the street.", "SCENE|CAPTURE")] = "street",
    /,
    *,
    output: Annotated[Path, option("Folder for figure, table and sweeps.", "--output", "-o")],
    rain: Annotated[str, setting(RainSettings, "intensity_mm_h", "Several with commas.")] = "0,1.2,8.5,12",
    visibility: Annotated[float | None, setting(RainSettings, "visibility_m")] = None,
    calibration: Annotated[str, setting(RainSettings, "calibration")] = "published",
    spray: Annotated[bool, setting(RainSettings, "spray")] = True,
    seeds: Annotated[int, option("Number of rains of each intensity: seeds 0, 1, ...")] = 5,
    sweeps: Annotated[int, option("Number of lidar turns, evenly over the capture or the drive.")] = 1,
    sensor: Annotated[str, option(f"{', '.join(SENSORS)} (beams, or nm), or a YAML file of a sensor.")] = "64",
    detection: DetectionOptions | None = None,
    answer: Annotated[Answer, option("Reported echo of a beam.")] = "strongest",
    wet_road: Annotated[bool, option("Water on the road reflects grazing beams away.")] = True,
    full_intensity: Annotated[
        float | None, option("A capture's intensity of white; default: 1, or 100 if values exceed 1.")
    ] = None,
    reflectance: Annotated[float, option("Near-infrared reflectance of all surfaces of a scene.")] = 0.2,
    write_sweeps: Annotated[bool, option("Write each sweep in rain (.npz).")] = True,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Rain on a lidar: returns kept, lost and made up, by range, over intensities and seeds.

    Rain and fog attenuate light in both directions (the same beta as haze in images), nearby drops of the same field
    return echoes, as does the spray of fast vehicles in a scene, and a wet road mirrors. A capture's own sweeps count
    as those of clear weather. In a scene a virtual sensor is on the ego's roof.
    """
    let_names_lead_outside(allow_outside)
    intensities = parse_intensities(rain)
    settings = converted_options(
        {"visibility_m": visibility, "calibration": calibration, "spray": spray and wet_road}, RainSettings
    )
    load_calibration(calibration)  # before anything is simulated
    check_within("--seeds", seeds, 1, 1000)
    check_within("--sweeps", sweeps, 1, 1000)
    check_within("--reflectance", reflectance, 0, 1, is_open=True)
    check_within("--full-intensity", full_intensity, 0, 1e6, is_open=True)
    claim_outputs(output / "lidar.png", output / "report.html", json, folders=[output])
    limits = (detection or DetectionOptions()).changes()
    chosen = read_sensor(sensor, limits)
    count, turns = _turns(source, chosen, sweeps, reflectance, full_intensity, estimates_range="range_m" not in limits)
    by_intensity: dict[float, list[RainRunCounts]] = {}
    strongest: RainRun | None = None
    with progress_bar("Raining", count * len(intensities) * seeds) as advance:
        for turn in turns:
            for run in lidar_runs(turn, settings, intensities, range(seeds), answer=answer, wet_road=wet_road):
                intensity = run.counts.state.intensity_mm_h
                if write_sweeps:
                    name = f"{file_word(run.turn.name)}_rain{intensity:g}_seed{run.counts.seed}.npz"
                    write_sweep(output / "sweeps" / name, run.rainy)
                if strongest is None or intensity > strongest.counts.state.intensity_mm_h:
                    strongest = run
                by_intensity.setdefault(intensity, []).append(run.counts)
                advance()
    if strongest is None:
        raise ValueError(f"{source}: no turn of a lidar came of it")
    write_figure(output / "lidar.png", strongest, by_intensity)
    inputs = {source: scene_hash(source) if names_scene(source) else input_fingerprint(Path(source))}
    if sensor not in SENSORS:
        inputs[sensor] = file_hash(Path(sensor))
    report = {
        "source": source,
        "seeds": list(range(seeds)),
        "answer": answer,
        "wet_road": wet_road,
        "visibility_m": visibility,
        "calibration": calibration,
        "spray": spray,
        "extinction": extinction_note(msgspec.structs.replace(settings, intensity_mm_h=each) for each in intensities),
        **run_provenance(inputs, ("numba",)),
        "sensor": msgspec.to_builtins(strongest.turn.sensor),
        "rows": [_row(run) for runs in by_intensity.values() for run in runs],
    }
    write_lidar_table(output / "lidar.csv", report["rows"])
    write_numbers(output / "lidar.json", report)
    write_lidar_page(output / "report.html", output / "lidar.png", by_intensity, report)
    console = Console(file=table_stream(json), width=_COLUMNS, highlight=False)
    print_lidar(by_intensity, strongest.turn.sensor, console)
    console.print(report["extinction"], soft_wrap=True)
    what = "lidar.png, lidar.csv, lidar.json, report.html" + (", sweeps/" if write_sweeps else "")
    console.print(f"wrote {output}: {what}", soft_wrap=True)
    write_numbers(json, report)


def _turns(
    source: str, sensor: LidarSensor, count: int, reflectance: float, full: float | None, estimates_range: bool
) -> tuple[int, Iterator[LidarTurn]]:
    """Return the number of turns, and the turns."""
    if names_scene(source):
        from gsrain_engine.scene.open import load_scene

        scene = load_scene(source)
        if scene.ego is None or not len(scene.ego.times):
            raise ValueError(f"{source}: has no ego vehicle whose roof a lidar could stand on")
        first, last = float(scene.ego.times[0]), float(scene.ego.times[-1])
        times = [first + (last - first) * k / count for k in range(count)]
        return count, scene_turns(scene, sensor, times, matt=reflectance)
    from gsrain_engine.datasets.open_capture import open_capture

    capture = open_capture(source)
    found = capture_turns(capture, sensor, count, full=full, estimates_range=estimates_range)
    return min(count, len(capture.sweeps)), found


def read_sensor(name: str, limits: Mapping[str, float]) -> LidarSensor:
    """Return a sensor by name or from a file, with other limits of detection."""
    sensor = SENSORS.get(name)
    if sensor is None:
        path = Path(name)
        if not path.exists():
            raise ValueError(f"--sensor {name}: expected {', '.join(SENSORS)}, or a YAML file of a sensor")
        data = read_whole(path)
        try:
            sensor = convert_checked(yaml_values(data), LidarSensor)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    farthest_m = max(sensor.farthest_m, limits.get("range_m", 0.0))
    return converted_options(msgspec.to_builtins(sensor) | limits | {"farthest_m": farthest_m}, LidarSensor)


# Numbers on the screen, as JSON and as CSV

_FEWEST = 20
_COUNTED = ("clear", "kept", "dropped", "masked", "false")


def _row(run: RainRunCounts) -> dict[str, Any]:
    tally = run.tally
    return finite_numbers({
        "intensity_mm_h": run.state.intensity_mm_h,
        "seed": run.seed,
        "turn": run.turn,
        "extinction_per_m": run.state.extinction_per_m,
        "marshall_palmer_extinction_per_m": run.state.marshall_palmer_extinction_per_m,
        "wetness": run.wetness,
        "range_10_m": run.range_m,
        **{name: int(getattr(tally, name).sum()) for name in _COUNTED},
        "untouched": tally.untouched,
        "at_threshold": run.at_threshold,
        "range_rmse_m": tally.range_rmse_m,
        "by_range": [
            {"from_m": start, "to_m": end}
            | {name: int(getattr(tally, name)[k]) for name in _COUNTED}
            for k, (start, end) in enumerate(pairwise(tally.edges_m.tolist()))
        ],
    })  # fmt: skip


def write_lidar_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a CSV line for each run and range bin; the last bin has no end."""
    text, run = io.StringIO(), ("intensity_mm_h", "seed", "turn")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*run, "from_m", "to_m", *_COUNTED])
    writer.writerows([*(row[name] for name in run), *part.values()] for row in rows for part in row["by_range"])
    write_text(path, text.getvalue())


def print_lidar(by_intensity: _Runs, sensor: LidarSensor, console: Console) -> None:
    """Print means over seeds and turns, and the shares of kept returns by range."""
    table = table_of("mm/h,beta 1/km,wetness,clear,kept,too weak,behind a drop,drops,noise mm", wraps=True)
    for intensity, runs in by_intensity.items():
        clear, kept, *counts = _counted(runs)
        table.add_row(
            f"{intensity:g}", f"{1e3 * runs[0].state.extinction_per_m:.2f}", f"{runs[0].wetness:.2f}",
            f"{clear.mean():,.0f}", f"{kept.sum() / max(clear.sum(), 1):.2%}", *map(_spread, counts),
            f"{1e3 * np.mean([run.tally.range_rmse_m for run in runs]):.1f}",
        )  # fmt: skip
    console.print(f"{sensor.name}; 10 % is detected up to {sensor.range_m:.0f} m")
    console.print(table)
    first = next(iter(by_intensity.values()))
    runs_each, just = len(first), sum(run.at_threshold for run in first)
    console.print(f"Means of {runs_each} runs each, with the least and the most of them. Kept returns by range:")
    console.print(_return_share_by_range(by_intensity))
    if just:
        console.print(
            f"{just / runs_each:,.0f} clear returns are fainter than what is just detected: they are taken to be at "
            "that limit, and any rain loses them.",
            soft_wrap=True,
        )


def _counted(runs: Sequence[RainRunCounts]) -> list[Int64[np.ndarray, " runs"]]:
    """Return the numbers of beams of each run, by outcome as in `_COUNTED`."""
    return [np.array([getattr(run.tally, name).sum() for run in runs], np.int64) for name in _COUNTED]


def _return_share_by_range(by_intensity: _Runs) -> Table:
    """Return the shares of the clear returns; bins with few returns are omitted."""
    first = next(iter(by_intensity.values()))
    ends, clear = _ends(first), np.sum([run.tally.clear for run in first], axis=0)
    shown = [k for k in range(len(clear)) if clear[k] >= _FEWEST * len(first)]
    table = Table("mm/h", *(ends[k] for k in shown), box=None)
    for intensity, runs in by_intensity.items():
        kept, clear = _returned_and_clear(runs)
        table.add_row(f"{intensity:g}", *(f"{kept[k] / clear[k]:.1%}" for k in shown))
    return table


def _ends(runs: Sequence[RainRunCounts]) -> list[str]:
    edges = runs[0].tally.edges_m.tolist()
    return [f"{a:g}-{b:g} m" if math.isfinite(b) else f"> {a:g} m" for a, b in pairwise(edges)]


def _returned_and_clear(runs: Sequence[RainRunCounts]) -> list[Int64[np.ndarray, " bins"]]:
    return [np.sum([getattr(run.tally, name) for run in runs], axis=0) for name in ("kept", "clear")]


def _spread(counts: Int64[np.ndarray, " runs"]) -> str:
    low, high, mean = counts.min(), counts.max(), f"{counts.mean():,.0f}"
    return mean if low == high else f"{mean} ({low:,}..{high:,})"


# HTML page


def write_lidar_page(file: Path, figure: Path, by_intensity: _Runs, report: Mapping[str, Any]) -> None:
    """Write the page; `report` are the numbers of `--json`, `figure` is the first image."""
    with Image.open(figure) as opened:
        pixels = np.asarray(opened.convert("RGB"))
    settings = {name: value for name, value in report.items() if name not in ("sensor", "rows", "versions", "inputs")}
    settings |= provenance_lines(report)
    page = RunReport(
        title=f"Lidar in rain: {report['source']}",
        settings=settings | {f"sensor: {name}": value for name, value in report["sensor"].items()},
        figures=(ReportFigure("From above, and by range", pixels),),
        tables=(_totals(by_intensity), _page_by_range(by_intensity)),
        headlines={"runs of each intensity": str(len(next(iter(by_intensity.values()))))},
        notes=(
            "False returns depend on the sensor's minimum reflectance at close range, which makers don't state.",
            "Spreads are those of the drops, not of other places.",
        ),
    )
    write_report(file, page)


def _totals(by_intensity: _Runs) -> ReportTable:
    rows: list[tuple[str | float | None, ...]] = []
    for intensity, runs in by_intensity.items():
        clear, kept, *lost, false = _counted(runs)
        share = float(100 * kept.sum() / max(clear.sum(), 1))
        means = (float(each.mean()) for each in (*lost, false))
        about = f"{intensity:g}", 1e3 * runs[0].state.extinction_per_m, runs[0].wetness, float(clear.mean()), share
        rows.append((*about, *means, float(false.min()), float(false.max())))
    columns = "mm/h,beta 1/km,wetness,clear,kept %,too weak,behind a drop,drops,least,most"
    caption = "Means of the runs of each intensity."
    return ReportTable("Returns", tuple(columns.split(",")), tuple(rows), decimals=2, caption=caption)


def _page_by_range(by_intensity: _Runs) -> ReportTable:
    rows: list[tuple[str | float | None, ...]] = []
    for intensity, runs in by_intensity.items():
        pairs = zip(*_returned_and_clear(runs), strict=True)
        rows.append((f"{intensity:g}", *(float(100 * kept / clear) if clear else None for kept, clear in pairs)))
    columns = ("mm/h", *_ends(next(iter(by_intensity.values()))))
    caption = "Per cent of the returns in clear weather."
    return ReportTable("Kept, by range", columns, tuple(rows), decimals=1, caption=caption)
