"""`gsrain bench`: timing of rendering, scene files and recoloring on this machine."""

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.recolor.settings import RecolorSettings

from .console import print, print_lines, progress_bar
from .options import (
    JsonFileOrScreen,
    check_within,
    option,
    options_of,
    parse_size,
    setting,
    split_list,
    takes_set,
)
from .outputs import check_writable, table_stream, write_numbers

if TYPE_CHECKING:
    from gsrain_engine.report.table import Table


Scenes = Annotated[
    str, option("Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files.")
]

_SCENES = "random-50k,random-100k,random-200k,random-400k,random-800k,random-1m,random-3m,street"
_START_S = 1.0


def render(
    *,
    scenes: Scenes = _SCENES,
    backends: Annotated[str | None, option("auto, cpu, opengl, with commas; default: all.")] = None,
    sizes: Annotated[str, option("WIDTHxHEIGHT,... in pixels.")] = "960x640",
    rain: Annotated[
        str, setting(RainSettings, "intensity_mm_h", "Several with commas; the rest is the preset's.")
    ] = "0,8.5",
    preset: Annotated[
        str, option("Rain preset (paper, 8.5, ...), a preset file, or default for the defaults.")
    ] = "paper",
    frames: Annotated[int, option("Timed frames, after two untimed ones.")] = 20,
    json: JsonFileOrScreen = None,
) -> dict[str, Any]:
    """Time frames of fixed scenes: create rain, render, read back. Medians by back end, size and rain."""
    from gsrain_engine.backends import device_of, open_renderer
    from gsrain_engine.editor.viewport.camera import default_path
    from gsrain_engine.render.renderer import describe_machine
    from gsrain_engine.render.sequence import FrameSequence
    from gsrain_engine.scene.open import is_random_scene, random_scene_camera

    from .bench_timing import backends_of, lines_over_gaussians, rain_costs, simulation_of, time_frames, timed_scene

    check_writable(json)
    check_within("--frames", frames, 1, 10_000)
    resolutions = [parse_size(each, "--sizes") for each in split_list("--sizes", sizes)]
    settings = RainSettings() if preset == "default" else load_preset(preset)
    simulations = [simulation_of(each, settings) for each in split_list("--rain", rain)]
    names = split_list("--scenes", scenes)
    rows: list[dict[str, Any]] = []
    with ExitStack() as stack:
        renderers = {each: stack.enter_context(open_renderer(each)) for each in backends_of(backends)}
        devices = {name: device_of(renderer) for name, renderer in renderers.items()}
        for name in names:
            scene = timed_scene(name)
            with progress_bar(f"Timing {scene.name}", len(renderers) * len(resolutions)) as advance:
                for (backend, renderer), (width, height) in product(renderers.items(), resolutions):
                    view = (random_scene_camera if is_random_scene(scene.name) else default_path)(scene, width, height)
                    sequences = [
                        FrameSequence(scene, simulation, view, width, height, start_s=_START_S)
                        for simulation in simulations
                    ]
                    rows += [{**row, "backend": backend} for row in time_frames(renderer, sequences, frames)]
                    advance()
    random_rows = [row for row in rows if is_random_scene(row["scene"]) and row["intensity_mm_h"] == 0]
    numbers: dict[str, Any] = {
        "preset": preset,
        "rows": rows,
        "fits": lines_over_gaussians(random_rows),
        "rain_costs": rain_costs(rows),
    }
    numbers["machine"] = describe_machine() | {"devices": devices}
    _print(rows, numbers, table_stream(json))
    write_numbers(json, numbers)
    return numbers


_SHOWN = 4
"""Number of effects whose times are printed, those with the largest share; the file of numbers has them all."""


def _print(rows: list[dict[str, Any]], numbers: dict[str, Any], file: TextIO) -> None:
    shown = {
        "scene": "scene", "back end": "backend", "size": "size", "mm/h": "intensity_mm_h:g", "splats": "splats:,",
        "ns/splat": "ns_per_splat:.0f", "ms": "frame_ms_median:.1f",
    }  # fmt: skip
    shares = {
        stage: max(each["stages_ms"].get(stage, 0.0) / each["frame_ms_median"] for each in rows)
        for row in rows
        for stage in row["stages_ms"]
    }
    largest = sorted(shares, key=lambda stage: shares[stage])[-_SHOWN:]
    shown |= {f"{stage} ms": f"stage {stage}:.1f" for stage in shares if stage in largest}
    print_lines(_table(shown, rows, "stages_ms").text, file=file)
    for fit in numbers["fits"]:
        print(
            f"{fit['backend']}, SH {fit['sh_degree']}, {fit['width']}x{fit['height']}: "
            f"{fit['intercept_ms']:.1f} ms + {fit['slope_ns_per_gaussian']:.0f} ns a Gaussian, R2 {fit['r2']:.4f}",
            file=file,
        )


def _table(shown: Mapping[str, str], rows: Sequence[Mapping[str, Any]], stages: str = "") -> "Table":
    """Return a table of rows by title, from keys with formats; those of a row's stages begin with "stage "."""
    from gsrain_engine.report.table import Column, Table

    keys = [each.partition(":")[::2] for each in shown.values()]
    flat = [
        {"size": f"{row.get('width')}x{row.get('height')}", **row}
        | {f"stage {name}": value for name, value in row.get(stages, {}).items()}
        for row in rows
    ]
    titled = tuple(Column(title, form) for title, (_, form) in zip(shown, keys, strict=True))
    return Table("Times", titled, [[row.get(key) for key, _ in keys] for row in flat])


# Scene files

_SUFFIXES = {"folder": "", ".ply": ".ply", ".splat": ".splat", ".spz": ".spz"}
"""Suffixes of writable scene formats, by name."""


def loading(
    *,
    scenes: Scenes = "random-200k,random-1m",
    formats: Annotated[
        str, option("With commas between: folder (a scene folder), .ply, .splat, .spz.")
    ] = "folder,.ply,.splat,.spz",
    repeats: Annotated[int, option("Number of times that each is read.")] = 3,
    json: JsonFileOrScreen = None,
) -> dict[str, Any]:
    """Time writing and reading scenes, from the system's file cache. Medians, by scene and format."""
    from .bench_timing import time_loading, timed_scene

    check_writable(json)
    check_within("--repeats", repeats, 1, 1000)
    chosen = split_list("--formats", formats)
    if unknown := [name for name in chosen if name not in _SUFFIXES]:
        raise ValueError(f"--formats {unknown[0]}: expected {', '.join(_SUFFIXES)}")
    rows: list[dict[str, Any]] = []
    for name in split_list("--scenes", scenes):
        scene = timed_scene(name)
        with progress_bar(f"Timing {scene.name}", len(chosen)) as advance:
            for form in chosen:
                with tempfile.TemporaryDirectory(prefix="gsrain-bench-") as folder:
                    rows.append(time_loading(scene, _SUFFIXES[form], Path(folder), repeats))
                advance()
    shown = {
        "scene": "scene", "format": "format", "Gaussians": "gaussians:,", "SH": "sh_degree", "MB": "megabytes:.1f",
        "write ms": "write_ms:.0f", "read ms": "read_ms_median:.1f", "bytes ms": "bytes_ms_min:.1f",
        "ns/Gaussian": "ns_per_gaussian:.0f",
    }  # fmt: skip
    return _finish(_table(shown, rows), rows, json)


def _finish(table: "Table", rows: list[dict[str, Any]], json: Path | None) -> dict[str, Any]:
    from gsrain_engine.render.renderer import describe_machine

    print_lines(table.text, file=table_stream(json))
    numbers = {"rows": rows, "machine": describe_machine()}
    write_numbers(json, numbers)
    return numbers


# Recoloring

SolverOptions = options_of(RecolorSettings, "bench recoloring", topic="Options")


@takes_set
def recoloring(
    *,
    scenes: Scenes = "random-200k,street",
    views: Annotated[int, option("Number of images, along the scene's drive or around its middle.")] = 8,
    size: Annotated[str, option("WIDTHxHEIGHT of the images in pixels.")] = "480x320",
    solver: SolverOptions | None = None,
    json: JsonFileOrScreen = None,
) -> dict[str, Any]:
    """Time recoloring scenes to darkened images of themselves: setup, choosing, solving, measuring."""
    from .bench_timing import cameras_of, time_recoloring, timed_scene

    check_writable(json)
    check_within("--views", views, 1, 1000)
    width, height = parse_size(size)
    settings = (solver or SolverOptions()).settings()
    names = split_list("--scenes", scenes)
    rows: list[dict[str, Any]] = []
    with progress_bar("Recoloring", len(names)) as advance:
        for name in names:
            scene = timed_scene(name)
            rows.append(time_recoloring(scene, cameras_of(scene, views, width, height), settings))
            advance()
    shown = {"scene": "scene", "Gaussians": "gaussians:,", "seen": "seen:,", "views": "views", "size": "size"}
    shown |= {f"{stage} s": f"stage {stage}:.2f" for row in rows for stage in row["stages_s"]}
    shown |= {"ms/step": "iteration_ms:.0f", "dB": "psnr_before_db:.1f", "dB then": "psnr_db:.1f"}
    return _finish(_table(shown, rows, "stages_s"), rows, json)
