"""`gsrain evaluate lidar`: what a lidar measures in the rain that the cameras see."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter

from gsrain_engine.evaluate.comparison.stamp import stamp
from gsrain_engine.evaluate.lidar.figure import write_figure
from gsrain_engine.evaluate.lidar.runs import Run, RunCounts, runs
from gsrain_engine.evaluate.lidar.sensor import SENSORS, LidarSensor
from gsrain_engine.evaluate.lidar.sweep_file import write_sweep
from gsrain_engine.evaluate.lidar.sweep_in_rain import Answer
from gsrain_engine.evaluate.lidar.turns import Turn, capture_turns, scene_turns
from gsrain_engine.scene.content_hash import file_hash, scene_hash
from gsrain_engine.scene.file_names import file_word
from gsrain_engine.untrusted.explained_errors import converted
from gsrain_engine.untrusted.plain_values import read_whole, yaml_values

from ...console import Console
from ..arguments import AllowOutside, JsonFileOrScreen, let_names_lead_outside, words_go_to, write_numbers
from ..outputs import check_writable, hold
from ..progress import progress_bar
from ..sources import names_scene
from .lidar_numbers import lidar_report, print_lidar, write_lidar_table
from .lidar_page import write_lidar_page
from .run_facts import run_facts

_COLUMNS = 130
_MOST_SEEDS, _MOST_SWEEPS = 1000, 1000


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

    Rain takes light on both ways (beta(R) of the haze), drops of the same field answer near the car, wet road mirrors.
    A capture's own sweeps are taken as those of clear weather. In a scene a virtual sensor stands on the ego's roof.
    """
    let_names_lead_outside(allow_outside)
    intensities = _intensities(rain)
    for name, count, most in (("--seeds", seeds, _MOST_SEEDS), ("--sweeps", sweeps, _MOST_SWEEPS)):
        if not 1 <= count <= most:
            raise ValueError(f"{name} {count}: must be within 1..{most}")
    for name, value, most in (("--reflectance", reflectance, 1.0), ("--full-intensity", full_intensity, 1e6)):
        if value is not None and not 0 < value <= most:
            raise ValueError(f"{name} {value:g}: must be within 0..{most:g}")
    check_writable(output / "lidar.png", output / "report.html", json, folders=[output])
    hold(output)
    chosen = _sensor(sensor, range_10, least_reflectance)
    count, turns = _turns(source, chosen, sweeps, reflectance, full_intensity, told_range=range_10 is None)
    by_intensity: dict[float, list[RunCounts]] = {}
    shown: Run | None = None
    with progress_bar("Raining", count * len(intensities) * seeds) as advance:
        for turn in turns:
            for run in runs(turn, intensities, range(seeds), answer=answer, wet_road=wet_road):
                if write_sweeps:
                    write_sweep(output / "sweeps" / _name(run), run.rainy)
                if shown is None or run.state.intensity_mm_h > shown.state.intensity_mm_h:
                    shown = run
                by_intensity.setdefault(run.state.intensity_mm_h, []).append(run.without_points)
                advance()
    if shown is None:
        raise ValueError(f"{source}: no turn of a lidar came of it")
    write_figure(output / "lidar.png", shown, by_intensity)
    facts = run_facts(_inputs(source, sensor), ("numba",))
    asked = {"source": source, "seeds": list(range(seeds)), "answer": answer, "wet_road": wet_road}
    report = lidar_report(by_intensity, shown.turn.sensor, **asked, **facts)
    write_lidar_table(output / "lidar.csv", report["rows"])
    write_numbers(output / "lidar.json", report)
    write_lidar_page(output / "report.html", output / "lidar.png", by_intensity, report)
    console = Console(file=words_go_to(json), width=_COLUMNS, highlight=False)
    print_lidar(by_intensity, shown.turn.sensor, console)
    what = "lidar.png, lidar.csv, lidar.json, report.html" + (", sweeps/" if write_sweeps else "")
    console.print(f"wrote {output}: {what}", soft_wrap=True)
    write_numbers(json, report)


def _inputs(source: str, sensor: str) -> dict[str, str]:
    """Hashes of a scene's bytes, or over names, sizes and times of a capture; of a file of a sensor."""
    found = {source: scene_hash(source) if names_scene(source) else stamp(Path(source))}
    return found if sensor in SENSORS else found | {sensor: file_hash(Path(sensor))}


def _turns(
    source: str, sensor: LidarSensor, count: int, reflectance: float, full: float | None, told_range: bool
) -> tuple[int, Iterator[Turn]]:
    """How many turns there are, and the turns."""
    if names_scene(source):
        from gsrain_engine.scene.open_scene import open_scene

        scene = open_scene(source)
        if scene.ego is None or not len(scene.ego.times):
            raise ValueError(f"{source}: has no ego vehicle whose roof a lidar could stand on")
        first, last = float(scene.ego.times[0]), float(scene.ego.times[-1])
        times = [first + (last - first) * k / count for k in range(count)]
        return count, scene_turns(scene, sensor, times, matt=reflectance)
    from gsrain_engine.datasets.open_capture import open_capture

    capture = open_capture(source)
    found = capture_turns(capture, sensor, count, full=full, told_range=told_range)
    return min(count, len(capture.sweeps)), found


def _name(run: Run) -> str:
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
            sensor = converted(yaml_values(data), LidarSensor)
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
