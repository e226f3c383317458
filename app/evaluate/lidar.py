"""`gsrain evaluate lidar`: lidar returns in rain, by intensity and range."""

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from cyclopts import Parameter
from PIL import Image

from gsrain_engine.evaluation.input_fingerprint import input_fingerprint
from gsrain_engine.evaluation.lidar.results import RainRun, RainRunCounts, ReturnCounts, write_figure
from gsrain_engine.evaluation.lidar.results import rain_runs as lidar_runs
from gsrain_engine.evaluation.lidar.scan import Answer, LidarTurn, capture_turns, scene_turns, write_sweep
from gsrain_engine.evaluation.lidar.sensor import SENSORS, LidarSensor
from gsrain_engine.evaluation.report import ReportFigure, ReportTable, RunReport, write_report
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.safe_io.text_files import read_whole, yaml_values
from gsrain_engine.scene.files import file_word, whole_file
from gsrain_engine.scene.open import file_hash, scene_hash

from ..console import Console, Table
from ..options import (
    AllowOutside,
    JsonFileOrScreen,
    check_writable,
    let_names_lead_outside,
    lock_outputs,
    table_stream,
    write_numbers,
)
from ..progress import progress_bar
from ..scene_options import names_scene
from .run_facts import provenance_lines, run_provenance

_COLUMNS = 130
_MAX_SEEDS, _MAX_SWEEPS = 1000, 1000


def lidar(
    source: Annotated[
        str, Parameter(name="SCENE|CAPTURE", help="What is scanned, or has been; default: the street.")
    ] = "street",
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="Folder for figure, table and sweeps.")],
    rain: Annotated[str, Parameter(help="Intensities in mm/h, with commas between.")] = "0,1.2,8.5,12",
    seeds: Annotated[int, Parameter(help="Rains of each intensity: seeds 0, 1, ...")] = 5,
    sweeps: Annotated[int, Parameter(help="Turns of the lidar, evenly over the capture or the drive.")] = 1,
    sensor: Annotated[str, Parameter(help=f"{', '.join(SENSORS)} (beams, or nm), or a YAML file of a sensor.")] = "64",
    range_10: Annotated[
        float | None,
        Parameter(
            help="Range in m at which 10 % of reflectance is just detected; default: what a capture's sweeps tell."
        ),
    ] = None,
    least_reflectance: Annotated[
        float | None,
        Parameter(
            help="Least reflectance that is detected near by, 0..0.1: false returns hang on it; 0: constant gain."
        ),
    ] = None,
    answer: Annotated[Answer, Parameter(help="Which of a beam's echoes is reported.")] = "strongest",
    wet_road: Annotated[bool, Parameter(help="Water on the road mirrors grazing beams away.")] = True,
    full_intensity: Annotated[
        float | None,
        Parameter(help="A capture's intensity of what is white and matt; default: 1, or 100 where it goes beyond 1."),
    ] = None,
    reflectance: Annotated[float, Parameter(help="Near-infrared reflectance of all things in a scene.")] = 0.2,
    write_sweeps: Annotated[bool, Parameter(help="Write each sweep in rain (.npz).")] = True,
    allow_outside: AllowOutside = False,
    json: JsonFileOrScreen = None,
) -> None:
    """Rain on a lidar: returns kept, lost and made up, by range, over intensities and seeds.

    Rain attenuates light in both directions (beta(R) of the haze), nearby drops of the same field return echoes, and a
    wet road mirrors. A capture's own sweeps count as those of clear weather. In a scene a virtual sensor is on the
    ego's roof.
    """
    let_names_lead_outside(allow_outside)
    intensities = _intensities(rain)
    for name, count, most in (("--seeds", seeds, _MAX_SEEDS), ("--sweeps", sweeps, _MAX_SWEEPS)):
        if not 1 <= count <= most:
            raise ValueError(f"{name} {count}: must be within 1..{most}")
    for name, value, most in (("--reflectance", reflectance, 1.0), ("--full-intensity", full_intensity, 1e6)):
        if value is not None and not 0 < value <= most:
            raise ValueError(f"{name} {value:g}: must be within 0..{most:g}")
    check_writable(output / "lidar.png", output / "report.html", json, folders=[output])
    lock_outputs(output)
    chosen = _sensor(sensor, range_10, least_reflectance)
    count, turns = _turns(source, chosen, sweeps, reflectance, full_intensity, told_range=range_10 is None)
    by_intensity: dict[float, list[RainRunCounts]] = {}
    shown: RainRun | None = None
    with progress_bar("Raining", count * len(intensities) * seeds) as advance:
        for turn in turns:
            for run in lidar_runs(turn, intensities, range(seeds), answer=answer, wet_road=wet_road):
                if write_sweeps:
                    write_sweep(output / "sweeps" / _name(run), run.rainy)
                if shown is None or run.state.intensity_mm_h > shown.state.intensity_mm_h:
                    shown = run
                by_intensity.setdefault(run.state.intensity_mm_h, []).append(run.without_points)
                advance()
    if shown is None:
        raise ValueError(f"{source}: no turn of a lidar came of it")
    write_figure(output / "lidar.png", shown, by_intensity)
    facts = run_provenance(_inputs(source, sensor), ("numba",))
    asked = {"source": source, "seeds": list(range(seeds)), "answer": answer, "wet_road": wet_road}
    report = lidar_report(by_intensity, shown.turn.sensor, **asked, **facts)
    write_lidar_table(output / "lidar.csv", report["rows"])
    write_numbers(output / "lidar.json", report)
    write_lidar_page(output / "report.html", output / "lidar.png", by_intensity, report)
    console = Console(file=table_stream(json), width=_COLUMNS, highlight=False)
    print_lidar(by_intensity, shown.turn.sensor, console)
    what = "lidar.png, lidar.csv, lidar.json, report.html" + (", sweeps/" if write_sweeps else "")
    console.print(f"wrote {output}: {what}", soft_wrap=True)
    write_numbers(json, report)


def _inputs(source: str, sensor: str) -> dict[str, str]:
    """Return hashes of a scene's bytes, or of a capture's names, sizes and times, and of a sensor's file."""
    found = {source: scene_hash(source) if names_scene(source) else input_fingerprint(Path(source))}
    return found if sensor in SENSORS else found | {sensor: file_hash(Path(sensor))}


def _turns(
    source: str, sensor: LidarSensor, count: int, reflectance: float, full: float | None, told_range: bool
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
    found = capture_turns(capture, sensor, count, full=full, told_range=told_range)
    return min(count, len(capture.sweeps)), found


def _name(run: RainRun) -> str:
    return f"{file_word(run.turn.name)}_rain{run.state.intensity_mm_h:g}_seed{run.seed}.npz"


def _intensities(text: str) -> list[float]:
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"\d*\.?\d+", word) and float(word) <= 100 for word in words):
        raise ValueError(f"--rain {text}: expected intensities within 0..100 mm/h such as 0,1.2,8.5,12")
    return sorted({float(word) for word in words})


def _sensor(name: str, range_10: float | None, least_reflectance: float | None) -> LidarSensor:
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
    if range_10 is not None:
        if not 1 <= range_10 <= 1000:
            raise ValueError(f"--range-10 {range_10:g}: must be within 1..1000 m")
        sensor = msgspec.structs.replace(sensor, range_m=range_10, farthest_m=max(sensor.farthest_m, range_10))
    if least_reflectance is not None:
        if not 0 <= least_reflectance <= 0.1:
            raise ValueError(f"--least-reflectance {least_reflectance:g}: must be within 0..0.1")
        sensor = msgspec.structs.replace(sensor, least_reflectance=least_reflectance)
    return sensor


# Numbers on the screen, as JSON and as CSV

_FEWEST = 20
_COUNTED = ("clear", "kept", "dropped", "masked", "false")


def lidar_report(
    by_intensity: Mapping[float, Sequence[RainRunCounts]], sensor: LidarSensor, **settings: Any
) -> dict[str, Any]:
    """Return all results as plain values: a row for each turn, intensity and seed."""
    rows = [_row(run) for runs in by_intensity.values() for run in runs]
    return {**settings, "sensor": msgspec.to_builtins(sensor), "rows": rows}


def _row(run: RainRunCounts) -> dict[str, Any]:
    tally = run.tally
    return {
        "intensity_mm_h": run.state.intensity_mm_h,
        "seed": run.seed,
        "turn": run.turn,
        "extinction_per_m": run.state.extinction_per_m,
        "wetness": run.wetness,
        "range_10_m": run.range_m,
        **{name: int(getattr(tally, name).sum()) for name in _COUNTED},
        "untouched": tally.untouched,
        "at_threshold": run.at_threshold,
        "range_rmse_m": None if math.isnan(tally.range_rmse_m) else tally.range_rmse_m,
        "by_range": _by_range(tally),
    }


def _by_range(tally: ReturnCounts) -> list[dict[str, Any]]:
    ends = zip(tally.edges_m[:-1].tolist(), tally.edges_m[1:].tolist(), strict=True)
    return [
        {"from_m": start, "to_m": None if math.isinf(end) else end}
        | {name: int(getattr(tally, name)[k]) for name in _COUNTED}
        for k, (start, end) in enumerate(ends)
    ]


def write_lidar_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a CSV line for each run and range bin; the last bin has no end."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["intensity_mm_h", "seed", "turn", "from_m", "to_m", *_COUNTED])
    for row in rows:
        for part in row["by_range"]:
            writer.writerow([row["intensity_mm_h"], row["seed"], row["turn"], *part.values()])
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        beside.write_text(text.getvalue(), encoding="utf-8")


def print_lidar(by_intensity: Mapping[float, Sequence[RainRunCounts]], sensor: LidarSensor, console: Console) -> None:
    """Print means over seeds and turns, and the shares of kept returns by range."""
    table = Table("mm/h", "beta 1/km", "wetness", "clear", "kept", "too weak", "behind a drop", "drops", box=None)
    table.add_column("noise mm")
    for intensity, runs in by_intensity.items():
        tallies = [run.tally for run in runs]
        clear, kept = (int(np.sum([getattr(each, name) for each in tallies])) for name in ("clear", "kept"))
        table.add_row(
            f"{intensity:g}",
            f"{1e3 * runs[0].state.extinction_per_m:.2f}",
            f"{runs[0].wetness:.2f}",
            f"{clear / len(runs):,.0f}",
            f"{kept / max(clear, 1):.2%}",
            *(_spread([int(getattr(each, name).sum()) for each in tallies]) for name in ("dropped", "masked", "false")),
            f"{1e3 * np.mean([each.range_rmse_m for each in tallies]):.1f}",
        )
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


def _return_share_by_range(by_intensity: Mapping[float, Sequence[RainRunCounts]]) -> Table:
    """Return the shares of the clear returns; bins with few returns are omitted."""
    sums = {
        intensity: [np.sum([getattr(run.tally, name) for run in runs], axis=0) for name in ("kept", "clear")]
        for intensity, runs in by_intensity.items()
    }
    first = next(iter(by_intensity.values()))
    edges, clear = first[0].tally.edges_m.tolist(), next(iter(sums.values()))[1]
    shown = [k for k in range(len(clear)) if clear[k] >= _FEWEST * len(first)]
    ends = [f"{edges[k]:g}-{edges[k + 1]:g} m" if math.isfinite(edges[k + 1]) else f"> {edges[k]:g} m" for k in shown]
    table = Table("mm/h", *ends, box=None)
    for intensity, (kept, clear) in sums.items():
        table.add_row(f"{intensity:g}", *(f"{kept[k] / clear[k]:.1%}" for k in shown))
    return table


def _spread(counts: Sequence[int]) -> str:
    mean = sum(counts) / len(counts)
    return f"{mean:,.0f}" if min(counts) == max(counts) else f"{mean:,.0f} ({min(counts):,}..{max(counts):,})"


# HTML page

_NOTES = (
    "False returns hang on the sensor's least reflectance near by, which makers don't state.",
    "Spreads are those of the drops: they say nothing of other places.",
)


def write_lidar_page(
    file: Path, figure: Path, by_intensity: Mapping[float, Sequence[RainRunCounts]], report: Mapping[str, Any]
) -> None:
    """Write the page; `report` comes from `lidar_report`, `figure` is the first image."""
    with Image.open(figure) as opened:
        pixels = np.asarray(opened.convert("RGB"))
    told = provenance_lines(report)
    settings = {name: value for name, value in report.items() if name not in ("sensor", "rows", "versions", "inputs")}
    settings |= told
    runs = len(next(iter(by_intensity.values())))
    write_report(
        file,
        RunReport(
            title=f"Lidar in rain: {report['source']}",
            settings=settings | {f"sensor: {name}": value for name, value in report["sensor"].items()},
            figures=(ReportFigure("From above, and by range", pixels),),
            tables=(_totals(by_intensity), _page_by_range(by_intensity)),
            headlines={"runs of each intensity": str(runs)},
            notes=_NOTES,
        ),
    )


def _totals(by_intensity: Mapping[float, Sequence[RainRunCounts]]) -> ReportTable:
    rows: list[tuple[str | float | None, ...]] = []
    for intensity, runs in by_intensity.items():
        clear, kept, dropped, masked, false = (
            np.array([getattr(run.tally, name).sum() for run in runs], np.float64)
            for name in ("clear", "kept", "dropped", "masked", "false")
        )
        share = float(100 * kept.sum() / max(clear.sum(), 1))
        beta = 1e3 * runs[0].state.extinction_per_m
        rows.append(
            (f"{intensity:g}", beta, runs[0].wetness, float(clear.mean()), share, float(dropped.mean()),
             float(masked.mean()), float(false.mean()), float(false.min()), float(false.max()))
        )  # fmt: skip
    columns = (
        "mm/h", "beta 1/km", "wetness", "clear", "kept %", "too weak", "behind a drop", "drops", "least", "most"
    )  # fmt: skip
    return ReportTable("Returns", columns, tuple(rows), decimals=2, caption="Means of the runs of each intensity.")


def _page_by_range(by_intensity: Mapping[float, Sequence[RainRunCounts]]) -> ReportTable:
    edges = next(iter(by_intensity.values()))[0].tally.edges_m.tolist()
    ends = [f"{a:g}-{b:g} m" if math.isfinite(b) else f"> {a:g} m" for a, b in pairwise(edges)]
    rows: list[tuple[str | float | None, ...]] = []
    for intensity, runs in by_intensity.items():
        kept, clear = (np.sum([getattr(run.tally, name) for run in runs], axis=0) for name in ("kept", "clear"))
        rows.append((f"{intensity:g}", *(float(100 * k / c) if c else None for k, c in zip(kept, clear, strict=True))))
    caption = "Per cent of the returns in clear weather."
    return ReportTable("Kept, by range", ("mm/h", *ends), tuple(rows), decimals=1, caption=caption)
