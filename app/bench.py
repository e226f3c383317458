"""`gsrain bench`: timing of rendering, scene files and recoloring on this machine."""

import re
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import groupby, product
from operator import itemgetter
from pathlib import Path
from statistics import correlation, linear_regression, median
from typing import Annotated, Any, TextIO, get_args

import msgspec
import numpy as np
from jaxtyping import Float32

from gsrain_engine.backends import device_of, open_renderer
from gsrain_engine.choices import Backend
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.recolor.problem import RecolorSettings
from gsrain_engine.recolor.recolor import recolor_scene
from gsrain_engine.recolor.views import TargetView
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.opengl.context import NoOpenGLError
from gsrain_engine.render.renderer import Renderer, RenderStatistics, describe_machine
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.sky_color import SkyColor
from gsrain_engine.report.table import Column, Table
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.open import is_random_scene, load_scene, random_scene, random_scene_camera
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Scene

from .console import print, print_lines, progress_bar
from .options import (
    JsonFileOrScreen,
    check_within,
    converted_options,
    option,
    options_of,
    parse_size,
    setting,
    split_list,
    takes_set,
)
from .outputs import check_writable, table_stream, write_numbers

Scenes = Annotated[
    str, option("Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files.")
]

_WARM_UP = 2  # untimed frames before the first timed one: kernels and shaders compile, buffers reach their size
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
    check_writable(json)
    check_within("--frames", frames, 1, 10_000)
    resolutions = [parse_size(each, "--sizes") for each in split_list("--sizes", sizes)]
    settings = RainSettings() if preset == "default" else load_preset(preset)
    simulations = [_simulation(each, settings) for each in split_list("--rain", rain)]
    names = split_list("--scenes", scenes)
    rows: list[dict[str, Any]] = []
    with ExitStack() as stack:
        renderers = {each: stack.enter_context(open_renderer(each)) for each in _backends(backends)}
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


def time_frames(renderer: Renderer, sequences: Sequence[FrameSequence], frames: int) -> list[dict[str, Any]]:
    """Render frames of several sequences and time each: creating rain, rendering, and reading the image back.

    The sequences alternate frame by frame, so that other load on the machine affects all of them alike.
    """
    runs = [_Run(renderer, sequence, sequence.sky(renderer)) for sequence in sequences]
    for number in range(-_WARM_UP, frames):
        for run in runs:
            run.render(max(number, 0), counts=number >= 0)
    return [run.times() for run in runs]


@dataclass(slots=True)
class _Run:
    renderer: Renderer
    sequence: FrameSequence
    sky: SkyColor
    frames_ms: list[float] = field(default_factory=list[float])
    processor_ms: list[float] = field(default_factory=list[float])
    stages_ms: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    last: RenderStatistics = field(default_factory=RenderStatistics)

    def render(self, number: int, *, counts: bool) -> None:
        frame = self.sequence.frame_input(self.sequence.shot(number), self.sky)
        start, used = time.perf_counter(), time.process_time()
        picture = draw(self.renderer, frame)
        picture.frame()
        end = time.perf_counter()
        self.last = self.renderer.statistics
        if counts:
            self.frames_ms.append(1000 * (end - start))
            self.processor_ms.append(1000 * (time.process_time() - used))
            for stage, took_ms in picture.rows_ms.items():
                self.stages_ms.setdefault(stage, []).append(took_ms)

    def times(self) -> dict[str, Any]:
        """Return the row of the results; counts are those of the last frame, stages have median times."""
        sequence, scene = self.sequence, self.sequence.scene
        frames, splats = len(self.frames_ms), self.last.splats_drawn
        return {
            "scene": scene.name,
            "backend": self.renderer.name,
            "width": sequence.width,
            "height": sequence.height,
            "intensity_mm_h": sequence.rainfall.state.intensity_mm_h,
            "extinction_per_m": sequence.rainfall.state.extinction_per_m,
            "sh_degree": _sh_degree(scene),
            "gaussians": sum(part.drawn_count for part in scene.parts(sequence.time_s(frames - 1))),
            "splats": splats,
            "drops_drawn": self.last.drops_drawn,
            "haze_drawn": self.last.haze_drawn,
            "frames": frames,
            "frame_ms_median": median(self.frames_ms),
            "frame_ms_min": min(self.frames_ms),
            "frame_ms_max": max(self.frames_ms),
            "processor_ms_min": min(self.processor_ms),
            "ns_per_splat": 1e6 * median(self.frames_ms) / splats if splats else None,
            "stages_ms": {stage: median(took_ms) for stage, took_ms in self.stages_ms.items()},
        }


def _sh_degree(scene: Scene) -> int:
    return max((member.gaussians.sh_degree for member in scene.members), default=0)


def lines_over_gaussians(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Fit a line (least squares) to the median times of each back end, size and SH degree with three or more scenes."""
    lines: list[dict[str, Any]] = []
    kind = itemgetter("backend", "width", "height", "sh_degree")
    for key, group in groupby(sorted(rows, key=kind), kind):
        alike = list(group)
        if len({row["gaussians"] for row in alike}) >= 3:
            found = zip(("backend", "width", "height", "sh_degree"), key, strict=True)
            lines.append(dict(found) | {"scenes": len(alike)} | _fitted(alike))
    return lines


def _fitted(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    gaussians, times_ms = ([row[name] for row in rows] for name in ("gaussians", "frame_ms_median"))
    slope, intercept_ms = linear_regression(gaussians, times_ms)
    r2 = correlation(gaussians, times_ms) ** 2 if len(set(times_ms)) > 1 else 1.0
    return {"slope_ns_per_gaussian": 1e6 * slope, "intercept_ms": intercept_ms, "r2": r2}


def rain_costs(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the cost of rain in each rainy row, as a share of the clear row of the same scene, back end and size."""
    names = ("scene", "backend", "width", "height")
    same = itemgetter(*names)
    clear = {same(row): row["frame_ms_median"] for row in rows if row["intensity_mm_h"] == 0}
    return [
        {name: row[name] for name in (*names, "intensity_mm_h")}
        | {"share": row["frame_ms_median"] / clear[same(row)] - 1}
        for row in rows
        if row["intensity_mm_h"] > 0 and same(row) in clear
    ]


def timed_scene(name: str) -> Scene:
    return random_scene(name) if is_random_scene(name) else load_scene(name)


def _simulation(intensity: str, settings: RainSettings) -> RainSimulation:
    if not re.fullmatch(r"\d+(\.\d*)?", intensity):
        raise ValueError(f"--rain {intensity}: expected intensities in mm/h such as 0,8.5")
    values = msgspec.to_builtins(settings) | {"intensity_mm_h": float(intensity)}
    return RainSimulation.start(converted_options(values, RainSettings))


def _backends(text: str | None) -> list[Backend]:
    """Return the chosen back ends, or all available ones; auto is replaced by the back end that it selects here."""
    known: dict[str, Backend] = {each: each for each in get_args(Backend)}
    chosen = split_list("--backends", text) if text is not None else ["auto", "cpu", *_opengl()]
    for name in chosen:
        if name not in known:
            raise ValueError(f"--backends {name}: expected {', '.join(known)}")
    if "auto" in chosen:
        with open_renderer() as renderer:
            chosen = [renderer.name if name == "auto" else name for name in chosen]
    return list(dict.fromkeys(known[name] for name in chosen))


def _opengl() -> list[str]:
    try:
        with open_renderer("opengl"):
            return ["opengl"]
    except NoOpenGLError:
        return []


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


def _table(shown: Mapping[str, str], rows: Sequence[Mapping[str, Any]], stages: str = "") -> Table:
    """Return a table of rows by title, from keys with formats; those of a row's stages begin with "stage "."""
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


def time_loading(scene: Scene, suffix: str, folder: Path, repeats: int) -> dict[str, Any]:
    """Write a scene into an empty folder once, and read it several times from the system's file cache.

    `bytes_ms_min` is the time for reading the raw bytes from the same cache, the lower bound for any reader.
    Raises `SceneFormatError` for a suffix that can't be written.
    """
    path = folder / f"scene{suffix}"
    write_ms = _ms(lambda: write_scene(scene, path))
    files = [file for file in folder.rglob("*") if file.is_file()]
    back = read_scene(path)  # loads the kernels and fills the file cache
    reads = [_ms(lambda: read_scene(path)) for _ in range(repeats)]
    return {
        "scene": scene.name,
        "format": suffix or "folder",
        "gaussians": back.gaussian_count,
        "sh_degree": _sh_degree(back),
        "megabytes": sum(file.stat().st_size for file in files) / 1e6,
        "write_ms": write_ms,
        "read_ms_median": median(reads),
        "read_ms_min": min(reads),
        "bytes_ms_min": min(_ms(lambda: [file.read_bytes() for file in files]) for _ in range(repeats)),
        "ns_per_gaussian": 1e6 * median(reads) / max(back.gaussian_count, 1),
    }


def _ms(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return 1000 * (time.perf_counter() - start)


def _finish(table: Table, rows: list[dict[str, Any]], json: Path | None) -> dict[str, Any]:
    print_lines(table.text, file=table_stream(json))
    numbers = {"rows": rows, "machine": describe_machine()}
    write_numbers(json, numbers)
    return numbers


# Recoloring

_DARKER = np.array([0.5, 0.55, 0.62])
"""Share of light per channel that the target images have: roughly that of an overcast sky and wet ground."""

_HALF_HEIGHT, _WET_SHARE = 0.5, 0.6
"""Below this share of the height, images are darker still, like wet ground: no global color map explains that."""


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
    check_writable(json)
    check_within("--views", views, 1, 1000)
    width, height = parse_size(size)
    settings = (solver or SolverOptions()).settings()
    names = split_list("--scenes", scenes)
    rows: list[dict[str, Any]] = []
    with progress_bar("Recoloring", len(names)) as advance:
        for name in names:
            scene = timed_scene(name)
            rows.append(time_recoloring(scene, _cameras(scene, views, width, height), settings))
            advance()
    shown = {"scene": "scene", "Gaussians": "gaussians:,", "seen": "seen:,", "views": "views", "size": "size"}
    shown |= {f"{stage} s": f"stage {stage}:.2f" for row in rows for stage in row["stages_s"]}
    shown |= {"ms/step": "iteration_ms:.0f", "dB": "psnr_before_db:.1f", "dB then": "psnr_db:.1f"}
    return _finish(_table(shown, rows, "stages_s"), rows, json)


def time_recoloring(scene: Scene, cameras: Sequence[tuple[float, Camera]], settings: RecolorSettings) -> dict[str, Any]:
    """Recolor a scene to darkened images of itself; cameras are in the world (meters), each with its time in s.

    Stages are setup (rendering every view), choosing (view trust), solving and measuring. An iteration is one forward
    and one transposed pass over all views; PSNR is the mean over the views against the target images.
    Raises ValueError if no camera sees any of the scene.
    """
    renderer, targets = CpuRenderer(), list[TargetView]()
    for number, (time_s, camera) in enumerate(cameras):
        renderer.draw(scene.parts(time_s), camera)
        targets.append(TargetView(f"view {number}", camera, time_s, darkened(renderer.read().rgba[..., :3])))
    recolored = run_to_end(recolor_scene(scene, targets, (), settings))
    return {
        "scene": scene.name,
        "gaussians": scene.gaussian_count,
        "seen": len(recolored.setup.problem.rows),
        "views": len(targets),
        "width": targets[0].camera.width,
        "height": targets[0].camera.height,
        "iterations": len(recolored.lengths),
        "seconds": sum(recolored.seconds.values()),
        "stages_s": dict(recolored.seconds),
        "iteration_ms": 1000 * recolored.seconds["solving"] / max(len(recolored.lengths), 1),
        "weights_mb": recolored.weights_mb,
        "psnr_before_db": float(np.mean([view.psnr_clear_db for view in recolored.views])),
        "psnr_db": float(np.mean([view.psnr_db for view in recolored.views])),
    }


def darkened(picture: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """Return an image (display values) with less light, and even less in its lower half."""
    light = _DARKER * srgb_to_linear(np.clip(picture, 0, 1).astype(np.float64))
    light[int(_HALF_HEIGHT * len(light)) :] *= _WET_SHARE
    return np.clip(linear_to_srgb(light), 0, 1).astype(np.float32)


def _cameras(scene: Scene, count: int, width: int, height: int) -> list[tuple[float, Camera]]:
    """Return times (s) and cameras (world, meters)."""
    if is_random_scene(scene.name):
        return [(0.0, random_scene_camera(scene, width, height))] * count
    path = default_path(scene, width, height)
    times = np.linspace(path.start_s, path.end_s, count + 2)[1:-1].tolist()
    return [(time_s, path.camera(time_s, width, height)) for time_s in times]
