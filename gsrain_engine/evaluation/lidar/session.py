"""An evaluation of a lidar in rain, from its source to its report: turns, rains, counts, tables, figure."""

import math
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from PIL import Image

from ...datasets.capture import Capture, LidarSweep
from ...rain.calibration import load_calibration
from ...rain.properties import extinction_note
from ...rain.settings import RainSettings
from ...render.images import write_image
from ...report.interval import Interval
from ...report.numbers import finite_numbers, provenance_lines, run_provenance, write_json
from ...report.page import ReportFigure, RunReport, write_report
from ...report.table import Cell, Table, columns
from ...safe_io.errors import convert_checked
from ...safe_io.file_names import file_word
from ...safe_io.text_files import read_whole, yaml_values
from ...scene.progress import Progress
from ...scene.scene import Scene
from .results import RainRun, RainRunCounts, lidar_figure, rain_runs
from .scan import LidarTurn, capture_turns, scene_turns, write_sweep
from .sensor import SENSORS, LidarSensor
from .settings import LidarSettings

LidarDetector = Callable[[LidarSweep], Mapping[str, float]]
"""Takes a sweep in the world (meters, z up) and returns the confidence (0..1) of each object that it finds, by name."""


def evaluate_lidar(
    source: Scene | Capture,
    sensor: LidarSensor,
    rain: RainSettings,
    settings: LidarSettings,
    *,
    estimates_range: bool = True,
    inputs: Mapping[str, str] | None = None,
    sweeps: Path | None = None,
    detector: LidarDetector | None = None,
) -> Generator[Progress, None, "LidarReport"]:
    """Scan a source in rains of several intensities and seeds.

    Args:
        source: A scene, in which a virtual sensor is on the roof of the ego vehicle, or a capture with lidar, whose own
            sweeps count as those of clear weather.
        sensor: The sensor; of a capture, for its limits of detection.
        rain: Fog, calibration and spray; its intensity and seed are those of the settings.
        settings: Intensities, seeds, turns.
        estimates_range: Take the range of a capture's sensor from its sweeps instead of the sensor's.
        inputs: Hashes of what was read, for the report.
        sweeps: Folder to write each sweep in rain to (.npz).
        detector: Function that finds objects in sweeps.

    Raises:
        ValueError: For a source without lidar or drive, and an unknown calibration.
    """
    load_calibration(rain.calibration)  # before anything is simulated
    if not settings.wet_road:
        rain = msgspec.structs.replace(rain, spray=False)
    intensities = tuple(sorted(set(settings.intensities_mm_h)))
    turns_there, turns = _turns(source, sensor, settings, estimates_range)
    count, number = turns_there * len(intensities) * settings.seeds, 0
    by_intensity: dict[float, list[RainRunCounts]] = {}
    strongest: RainRun | None = None
    found: list[tuple[float, int, str, Mapping[str, float]]] = []
    for turn in turns:
        runs = rain_runs(
            turn, rain, intensities, range(settings.seeds), answer=settings.answer, wet_road=settings.wet_road
        )
        for run in runs:
            intensity = run.counts.state.intensity_mm_h
            if detector is not None:
                found.append((intensity, run.counts.seed, run.turn.name, detector(run.rainy.sweep)))
            if sweeps is not None:
                name = f"{file_word(run.turn.name)}_rain{intensity:g}_seed{run.counts.seed}.npz"
                write_sweep(sweeps / name, run.rainy)
            if strongest is None or intensity > strongest.counts.state.intensity_mm_h:
                strongest = run
            by_intensity.setdefault(intensity, []).append(run.counts)
            number += 1
            yield Progress(number / count, f"Turn in rain {number} of {count}")
    if strongest is None:
        raise ValueError(f"{source.name}: no turn of a lidar came of it")
    note = extinction_note(msgspec.structs.replace(rain, intensity_mm_h=each) for each in intensities)
    facts = {
        "source": source.name,
        "seeds": list(range(settings.seeds)),
        "answer": settings.answer,
        "wet_road": settings.wet_road,
        "visibility_m": rain.visibility_m,
        "calibration": rain.calibration,
        "spray": rain.spray,
        "extinction": note,
        **run_provenance(inputs or {}, ("numba",)),
    }
    return LidarReport(by_intensity, strongest, facts, found)


def _turns(
    source: Scene | Capture, sensor: LidarSensor, settings: LidarSettings, estimates_range: bool
) -> tuple[int, Iterator[LidarTurn]]:
    """Return the number of turns, and the turns."""
    count = settings.sweeps
    if isinstance(source, Scene):
        if source.ego is None or not len(source.ego.times):
            raise ValueError(f"{source.name}: has no ego vehicle whose roof a lidar could stand on")
        first, last = float(source.ego.times[0]), float(source.ego.times[-1])
        times = [first + (last - first) * k / count for k in range(count)]
        return count, scene_turns(source, sensor, times, matt=settings.reflectance)
    found = capture_turns(source, sensor, count, full=settings.full_intensity, estimates_range=estimates_range)
    return min(count, len(source.sweeps)), found


def open_sensor(name: str, limits: Mapping[str, float] | None = None) -> LidarSensor:
    """Return a sensor by name or from a YAML file, with other limits of detection.

    Raises ValueError, which begins with `sensor` for an unknown name, and with the file for wrong values.
    """
    sensor, limits = SENSORS.get(name), limits or {}
    if sensor is None:
        path = Path(name)
        if not path.exists():
            raise ValueError(f"sensor {name}: expected {', '.join(SENSORS)}, or a YAML file of a sensor")
        data = read_whole(path)
        try:
            sensor = convert_checked(yaml_values(data), LidarSensor)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    farthest_m = max(sensor.farthest_m, limits.get("range_m", 0.0))
    return convert_checked({**msgspec.to_builtins(sensor), **limits, "farthest_m": farthest_m}, LidarSensor)


# Report

_FALSE_RETURNS = "False returns depend on the sensor's minimum reflectance at close range, which makers don't state."


@dataclass(frozen=True, slots=True, eq=False)
class LidarReport:
    """Results of an evaluation: returns that are kept, lost and made up, by intensity and range."""

    by_intensity: Mapping[float, Sequence[RainRunCounts]]
    """Counts of all seeds and turns, by intensity in mm/h."""
    strongest: RainRun
    """The first turn in the heaviest rain, with its points."""
    facts: Mapping[str, Any] = field(repr=False)
    """Settings and provenance."""
    found: Sequence[tuple[float, int, str, Mapping[str, float]]] = ()
    """Intensity, seed and turn of each sweep, with what a detector has found in it."""

    @property
    def table(self) -> Table:
        """All returns, by intensity."""
        return totals_table(self.by_intensity)

    @property
    def tables(self) -> tuple[Table, ...]:
        """All returns, the shares that are kept by range, and the confidence of objects if a detector has looked."""
        objects = [objects_table(self.found)] if self.found else []
        return self.table, range_table(self.by_intensity), *objects

    @property
    def figure(self) -> Image.Image:
        """The turn from above, clear and in the heaviest rain, and counts by range."""
        return Image.fromarray(lidar_figure(self.strongest, self.by_intensity))

    @property
    def notes(self) -> list[str]:
        first = next(iter(self.by_intensity.values()))
        just = sum(run.at_threshold for run in first)
        faint = (
            f"{just / len(first):,.0f} clear returns are fainter than what is just detected: they are taken to be at "
            "that limit, and any rain loses them."
        )
        return [*([faint] if just else []), self.facts["extinction"]]

    @property
    def plain(self) -> dict[str, Any]:
        """Values for JSON."""
        sensor = msgspec.to_builtins(self.strongest.turn.sensor)
        objects = [
            {"intensity_mm_h": intensity, "seed": seed, "turn": turn, "confidences": dict(own)}
            for intensity, seed, turn, own in self.found
        ]
        found = {"objects": objects} if objects else {}
        return {**self.facts, "sensor": sensor, "rows": [_row(run) for run in self._runs], **found}

    @property
    def _runs(self) -> list[RainRunCounts]:
        return [run for runs in self.by_intensity.values() for run in runs]

    def save(self, folder: Path | str) -> list[str]:
        """Write figure, table, numbers and page into a folder; returns the names of the files."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        report, figure = self.plain, self.figure
        write_image(folder / "lidar.png", figure)
        lidar_rows(report["rows"]).write_csv(folder / "lidar.csv")
        write_json(folder / "lidar.json", report)
        settings = {name: value for name, value in self.facts.items() if name not in ("versions", "inputs")}
        settings |= provenance_lines(self.facts)
        page = RunReport(
            title=f"Lidar in rain: {self.facts['source']}",
            settings=settings | {f"sensor: {name}": value for name, value in report["sensor"].items()},
            figures=(ReportFigure("From above, and by range", np.asarray(figure)),),
            tables=self.tables,
            headlines={"runs of each intensity": str(len(next(iter(self.by_intensity.values()))))},
            notes=(
                "False returns depend on the sensor's minimum reflectance at close range, which makers don't state.",
            ),
        )
        write_report(folder / "report.html", page)
        return ["lidar.png", "lidar.csv", "lidar.json", "report.html"]


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


def lidar_rows(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return a row for each run and range bin; the last bin has no end."""
    run = "intensity_mm_h", "seed", "turn"
    own = [[*(row[name] for name in run), *part.values()] for row in rows for part in row["by_range"]]
    return Table("Runs", columns((*run, "from_m", "to_m", *_COUNTED)), own)


def totals_table(by_intensity: Mapping[float, Sequence[RainRunCounts]]) -> Table:
    """Return the table of all returns, by intensity."""
    titled = {
        "mm/h": "g", "beta 1/km": ".2f", "wetness": ".2f", "clear": ",.0f", "kept": ".2%", "too weak": ",.0f",
        "behind a drop": ",.0f", "drops": ",.0f", "noise mm": ".1f",
    }  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for intensity, runs in by_intensity.items():
        clear, kept, *counts = [np.array([getattr(run.tally, name).sum() for run in runs]) for name in _COUNTED]
        rows.append((
            intensity, 1e3 * runs[0].state.extinction_per_m, runs[0].wetness, float(clear.mean()),
            float(kept.sum() / max(clear.sum(), 1)), *(Interval.spread(each, "runs") for each in counts),
            1e3 * float(np.mean([run.tally.range_rmse_m for run in runs])),
        ))  # fmt: skip
    caption = "Means of the runs of each intensity. Spreads are those of the drops, not of other places."
    return Table("Returns", columns(titled), rows, caption)


def range_table(by_intensity: Mapping[float, Sequence[RainRunCounts]]) -> Table:
    """Return the shares of the clear returns that are kept, by range."""
    edges = next(iter(by_intensity.values()))[0].tally.edges_m.tolist()
    ends = [f"{a:g}-{b:g} m" if math.isfinite(b) else f"> {a:g} m" for a, b in pairwise(edges)]
    rows: list[tuple[Cell, ...]] = []
    for intensity, runs in by_intensity.items():
        kept, clear = (np.sum([getattr(run.tally, name) for run in runs], axis=0) for name in ("kept", "clear"))
        rows.append((intensity, *(float(a / b) if b else None for a, b in zip(kept, clear, strict=True))))
    return Table("Kept returns, by range", columns({"mm/h": "g"} | dict.fromkeys(ends, ".1%")), rows)


def objects_table(found: Sequence[tuple[float, int, str, Mapping[str, float]]]) -> Table:
    """Return the confidence of each object by intensity, over seeds and turns; missed ones count as 0."""
    names = list(dict.fromkeys(name for *_, own in found for name in own))
    rows: list[tuple[Cell, ...]] = []
    for intensity in dict.fromkeys(each[0] for each in found):
        sweeps = [own for other, _, _, own in found if other == intensity]
        rows += [(intensity, name, Interval.spread([own.get(name, 0.0) for own in sweeps], "runs")) for name in names]
    caption = "Confidence of a detector, misses as 0; means of the runs of each intensity."
    return Table("Objects", columns({"mm/h": "g", "object": "", "confidence": ".3f"}), rows, caption)
