"""`gsrain bench`: timing of rendering, scene files and recoloring on this machine."""

import re
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Annotated, Any, NamedTuple, get_args

import msgspec
import numpy as np
from cyclopts import Parameter
from jaxtyping import Float32

from gsrain_engine.backends import Backend, device_of, open_renderer
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.settings import RainSettings, load_preset
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.recolor.problem import RecolorSettings
from gsrain_engine.recolor.recolor import recolor_scene
from gsrain_engine.recolor.views import TargetView
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import rain_frame_of
from gsrain_engine.render.opengl.context import NoOpenGLError
from gsrain_engine.render.renderer import Color, Renderer, RenderStatistics, describe_machine
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.open import is_random_scene, load_scene, random_scene, random_scene_camera
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Scene

from .console import Console, Table
from .options import (
    RAIN_OPTIONS,
    JsonFileOrScreen,
    check_writable,
    converted_options,
    parse_size,
    split_list,
    table_stream,
    write_numbers,
)
from .progress import progress_bar

_WARM_UP = 2  # untimed frames before the first timed one: kernels and shaders compile, buffers reach their size


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTimes:
    """Timings of the frames of one sequence. Each frame creates its rain, renders, and reads the image back."""

    scene: str
    backend: str
    width: int
    height: int
    intensity_mm_h: float
    sh_degree: int
    """Highest of all layers and actors."""
    gaussians: int
    """Gaussians of the scene submitted for the last frame, without rain."""
    splats: int
    """Splats of scene and rain drawn in the last frame."""
    drops_drawn: int
    haze_drawn: int
    frames: int
    frame_ms_median: float
    frame_ms_min: float
    frame_ms_max: float
    ns_per_splat: float | None
    """Median frame time over splats drawn; None if nothing was drawn."""
    stages_ms: dict[str, float]
    """Median times: rain (created on the CPU), the renderer's own stages, and readback."""


def time_frames(renderer: Renderer, sequences: Sequence[FrameSequence], frames: int) -> list[FrameTimes]:
    """Render frames of several sequences and time each.

    The sequences alternate frame by frame, so that other load on the machine affects all of them alike.
    """
    runs = [_Run(renderer, sequence, sequence.sky(renderer).color) for sequence in sequences]
    for number in range(-_WARM_UP, frames):
        for run in runs:
            run.render(max(number, 0), counts=number >= 0)
    return [run.times() for run in runs]


@dataclass(slots=True)
class _Run:
    renderer: Renderer
    sequence: FrameSequence
    sky: Color
    frames_ms: list[float] = field(default_factory=list[float])
    stages_ms: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    last: RenderStatistics = field(default_factory=RenderStatistics)

    def render(self, number: int, *, counts: bool) -> None:
        sequence, shot = self.sequence, self.sequence.shot(number)
        parts = sequence.scene.parts(shot.time_s, wetness=sequence.rainfall.wetness_at(shot.time_s))
        start = time.perf_counter()
        falling = rain_frame_of(sequence.scene, sequence.rainfall, self.sky, shot)
        rained = time.perf_counter()
        self.renderer.draw(parts, shot.camera, falling)
        drawn = time.perf_counter()
        self.renderer.read()
        end = time.perf_counter()
        self.last = self.renderer.statistics
        if counts:
            self.frames_ms.append(1000 * (end - start))
            rain = {"rain": 1000 * (rained - start)} if falling is not None else {}
            for stage, took in (rain | self.last.stages_ms | {"read": 1000 * (end - drawn)}).items():
                self.stages_ms.setdefault(stage, []).append(took)

    def times(self) -> FrameTimes:
        sequence, scene = self.sequence, self.sequence.scene
        frames, splats = len(self.frames_ms), self.last.splats_drawn
        return FrameTimes(
            scene=scene.name,
            backend=self.renderer.name,
            width=sequence.width,
            height=sequence.height,
            intensity_mm_h=sequence.rainfall.state.intensity_mm_h,
            sh_degree=max((each.gaussians.sh_degree for each in scene.members), default=0),
            gaussians=sum(part.drawn_count for part in scene.parts(sequence.time_s(frames - 1))),
            splats=splats,
            drops_drawn=self.last.drops_drawn,
            haze_drawn=self.last.haze_drawn,
            frames=frames,
            frame_ms_median=median(self.frames_ms),
            frame_ms_min=min(self.frames_ms),
            frame_ms_max=max(self.frames_ms),
            ns_per_splat=1e6 * median(self.frames_ms) / splats if splats else None,
            stages_ms={stage: median(took) for stage, took in self.stages_ms.items()},
        )


class Line(NamedTuple):
    """Line through the median frame times of scenes that differ only in their number of Gaussians."""

    backend: str
    width: int
    height: int
    sh_degree: int
    scenes: int
    slope_ns_per_gaussian: float
    intercept_ms: float
    r2: float
    """Coefficient of determination, 0 to 1."""


def lines_over_gaussians(rows: Iterable[FrameTimes]) -> list[Line]:
    """Fit a line (least squares) to each back end, size and SH degree with three or more scenes."""
    lines: list[Line] = []
    for key, group in groupby(sorted(rows, key=_kind), _kind):
        alike = list(group)
        if len({row.gaussians for row in alike}) >= 3:
            lines.append(Line(*key, len(alike), *_fitted(alike)))
    return lines


def _kind(row: FrameTimes) -> tuple[str, int, int, int]:
    return row.backend, row.width, row.height, row.sh_degree


def _fitted(rows: Sequence[FrameTimes]) -> tuple[float, float, float]:
    """Slope in ns, intercept in ms, r2."""
    x = np.array([row.gaussians for row in rows], np.float64)
    y = np.array([row.frame_ms_median for row in rows])
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    spread = float(dy @ dy)
    r2 = float((dx @ dy) ** 2 / (dx @ dx) / spread) if spread > 0 else 1.0
    return 1e6 * slope, float(y.mean() - slope * x.mean()), min(r2, 1.0)


class RainCost(NamedTuple):
    """Cost of rain in a frame, as a share of the same frame without rain."""

    scene: str
    backend: str
    width: int
    height: int
    intensity_mm_h: float
    share: float


def rain_costs(rows: Sequence[FrameTimes]) -> list[RainCost]:
    """Compare each rainy row with the clear row of the same scene, back end and size, if there is one."""
    clear = {_same(row): row.frame_ms_median for row in rows if row.intensity_mm_h == 0}
    return [
        RainCost(*_same(row), row.intensity_mm_h, row.frame_ms_median / clear[_same(row)] - 1)
        for row in rows
        if row.intensity_mm_h > 0 and _same(row) in clear
    ]


def _same(row: FrameTimes) -> tuple[str, str, int, int]:
    return row.scene, row.backend, row.width, row.height


_SCENES = "random-50k,random-100k,random-200k,random-400k,random-800k,random-1m,random-3m,street"
_START_S = 1.0
_COLUMNS = 120  # table width, also if the output is a file


def render(
    *,
    scenes: Annotated[
        str,
        Parameter(help="Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files."),
    ] = _SCENES,
    backends: Annotated[
        str | None, Parameter(help="auto, cpu, opengl, cuda; default: what auto takes, then cpu and opengl if present.")
    ] = None,
    sizes: Annotated[str, Parameter(help="WIDTHxHEIGHT,... in pixels.")] = "960x640",
    rain: Annotated[str, Parameter(help="Intensities in mm/h of the preset paper; 0 is clear.")] = "0,8.5",
    frames: Annotated[int, Parameter(help="Frames that are timed, after two that are not.")] = 20,
    json: JsonFileOrScreen = None,
) -> dict[str, Any]:
    """Time frames of fixed scenes: create rain, render, read back. Medians by back end, size and rain."""
    check_writable(json)
    if not 1 <= frames <= 10_000:
        raise ValueError(f"--frames {frames}: must be within 1..10000")
    resolutions = [parse_size(each, "--sizes") for each in split_list("--sizes", sizes)]
    rainfalls = [_rainfall(each) for each in split_list("--rain", rain)]
    names = split_list("--scenes", scenes)
    rows: list[FrameTimes] = []
    with ExitStack() as stack:
        renderers = [stack.enter_context(open_renderer(each)) for each in _backends(backends)]
        devices = {renderer.name: device_of(renderer) for renderer in renderers}
        for name in names:
            scene = timed_scene(name)
            runs = list(_runs(scene, renderers, resolutions, rainfalls))
            with progress_bar(f"Timing {scene.name}", len(runs), draws=True) as advance:
                for renderer, sequences in runs:
                    rows += time_frames(renderer, sequences, frames)
                    advance()
    numbers = _report(rows) | {"machine": describe_machine() | {"devices": devices}}
    _print(rows, numbers, Console(file=table_stream(json), width=_COLUMNS))
    write_numbers(json, numbers)
    return numbers


def timed_scene(name: str) -> Scene:
    return random_scene(name) if is_random_scene(name) else load_scene(name)


def _rainfall(intensity: str) -> RainSimulation:
    if not re.fullmatch(r"\d+(\.\d*)?", intensity):
        raise ValueError(f"--rain {intensity}: expected intensities in mm/h such as 0,8.5")
    values = msgspec.to_builtins(load_preset("paper")) | {"intensity_mm_h": float(intensity)}
    return RainSimulation.start(converted_options(values, RainSettings, RAIN_OPTIONS))


def _backends(text: str | None) -> list[Backend]:
    """Return the chosen back ends, or all available ones; auto is replaced by the back end that it selects here."""
    known: dict[str, Backend] = {each: each for each in get_args(Backend)}
    wanted = split_list("--backends", text) if text is not None else ["auto", "cpu", *_opengl()]
    for name in wanted:
        if name not in known:
            raise ValueError(f"--backends {name}: expected {', '.join(known)}")
    return list(dict.fromkeys(_resolved(known[name]) for name in wanted))


def _resolved(backend: Backend) -> Backend:
    if backend != "auto":
        return backend
    with open_renderer() as renderer:
        return next(each for each in get_args(Backend) if each == renderer.name)


def _opengl() -> list[str]:
    try:
        with open_renderer("opengl"):
            return ["opengl"]
    except NoOpenGLError:
        return []


def _runs(
    scene: Scene, renderers: list[Renderer], resolutions: list[tuple[int, int]], rainfalls: list[RainSimulation]
) -> Iterator[tuple[Renderer, list[FrameSequence]]]:
    """Yield the sequences to alternate: one scene, back end and size in each rain."""
    for renderer in renderers:
        for width, height in resolutions:
            if is_random_scene(scene.name):
                view = random_scene_camera(scene, width, height)
            else:
                view = default_path(scene, width, height)
            yield (
                renderer,
                [FrameSequence(scene, rainfall, view, width, height, start_s=_START_S) for rainfall in rainfalls],
            )


def _report(rows: list[FrameTimes]) -> dict[str, Any]:
    alike = [row for row in rows if is_random_scene(row.scene) and row.intensity_mm_h == 0]
    return {
        "rows": [asdict(row) for row in rows],
        "fits": [line._asdict() for line in lines_over_gaussians(alike)],
        "rain_costs": [cost._asdict() for cost in rain_costs(rows)],
    }


def _print(rows: list[FrameTimes], numbers: dict[str, Any], console: Console) -> None:
    stages = list(dict.fromkeys(stage for row in rows for stage in row.stages_ms))
    table = Table("scene", "back end", "size", "mm/h", "splats", "ns/splat", "ms", *stages, box=None)
    for row in rows:
        table.add_row(
            row.scene,
            row.backend,
            f"{row.width}x{row.height}",
            f"{row.intensity_mm_h:g}",
            f"{row.splats:,}",
            "" if row.ns_per_splat is None else f"{row.ns_per_splat:.0f}",
            f"{row.frame_ms_median:.1f}",
            *(f"{row.stages_ms[stage]:.1f}" if stage in row.stages_ms else "" for stage in stages),
        )
    console.print(table)
    for fit in numbers["fits"]:
        console.print(
            f"{fit['backend']}, SH {fit['sh_degree']}, {fit['width']}x{fit['height']}: "
            f"{fit['intercept_ms']:.1f} ms + {fit['slope_ns_per_gaussian']:.0f} ns a Gaussian, R2 {fit['r2']:.4f}"
        )


# Scene files

WRITTEN = ("", ".ply", ".splat", ".spz")
"""Suffixes of writable scene formats; "" is a scene folder."""


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
        "sh_degree": max((member.gaussians.sh_degree for member in back.members), default=0),
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


_FOLDER = "folder"


def loading(
    *,
    scenes: Annotated[
        str,
        Parameter(help="Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files."),
    ] = "random-200k,random-1m",
    formats: Annotated[
        str, Parameter(help="With commas between: folder (a scene folder), .ply, .splat, .spz.")
    ] = "folder,.ply,.splat,.spz",
    repeats: Annotated[int, Parameter(help="Times that each is read.")] = 3,
    json: JsonFileOrScreen = None,
) -> dict[str, Any]:
    """Time writing and reading scenes, from the system's file cache. Medians, by scene and format."""
    check_writable(json)
    if not 1 <= repeats <= 1000:
        raise ValueError(f"--repeats {repeats}: must be within 1..1000")
    suffixes = [_suffix(each) for each in split_list("--formats", formats)]
    rows: list[dict[str, Any]] = []
    for name in split_list("--scenes", scenes):
        scene = timed_scene(name)
        with progress_bar(f"Timing {scene.name}", len(suffixes)) as advance:
            for suffix in suffixes:
                with tempfile.TemporaryDirectory(prefix="gsrain-bench-") as folder:
                    rows.append(time_loading(scene, suffix, Path(folder), repeats))
                advance()
    _print_loading(rows, Console(file=table_stream(json), width=100))
    numbers = {"rows": rows, "machine": describe_machine()}
    write_numbers(json, numbers)
    return numbers


def _suffix(word: str) -> str:
    suffix = "" if word == _FOLDER else word
    if suffix not in WRITTEN:
        raise ValueError(f"--formats {word}: expected {_FOLDER}, {', '.join(each for each in WRITTEN if each)}")
    return suffix


def _print_loading(rows: list[dict[str, Any]], console: Console) -> None:
    table = Table(
        "scene", "format", "Gaussians", "SH", "MB", "write ms", "read ms", "bytes ms", "ns/Gaussian", box=None
    )
    for row in rows:
        table.add_row(
            row["scene"],
            row["format"],
            f"{row['gaussians']:,}",
            str(row["sh_degree"]),
            f"{row['megabytes']:.1f}",
            f"{row['write_ms']:.0f}",
            f"{row['read_ms_median']:.1f}",
            f"{row['bytes_ms_min']:.1f}",
            f"{row['ns_per_gaussian']:.0f}",
        )
    console.print(table)


# Recoloring

_DARKER = np.array([0.5, 0.55, 0.62])
"""Share of light per channel that the target images keep: roughly that of an overcast sky and wet ground."""

_HALF_HEIGHT = 0.5
"""Below this share of the height, images are darker still, like wet ground: no global color map explains that."""

_WET_SHARE = 0.6


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


def recoloring(
    *,
    scenes: Annotated[
        str,
        Parameter(help="Names with commas between: random-200k (SH degree 0), random-3m (degree 3), street, or files."),
    ] = "random-200k,street",
    views: Annotated[int, Parameter(help="Pictures, evenly along the scene's drive or around its middle.")] = 8,
    size: Annotated[str, Parameter(help="WIDTHxHEIGHT of the pictures in pixels.")] = "480x320",
    iterations: Annotated[int, Parameter(help="Steps of conjugate gradients.")] = 12,
    json: JsonFileOrScreen = None,
) -> dict[str, Any]:
    """Time recoloring scenes to darkened images of themselves: setup, choosing, solving, measuring."""
    check_writable(json)
    if not 1 <= views <= 1000:
        raise ValueError(f"--views {views}: must be within 1..1000")
    width, height = parse_size(size)
    try:
        settings = msgspec.convert({"iterations": iterations}, RecolorSettings)
    except msgspec.ValidationError as error:
        raise ValueError(f"--iterations {iterations}: {error}") from None
    names = split_list("--scenes", scenes)
    rows: list[dict[str, Any]] = []
    with progress_bar("Recolouring", len(names)) as advance:
        for name in names:
            scene = timed_scene(name)
            rows.append(time_recoloring(scene, _cameras(scene, views, width, height), settings))
            advance()
    _print_recoloring(rows, Console(file=table_stream(json), width=120))
    numbers = {"rows": rows, "machine": describe_machine()}
    write_numbers(json, numbers)
    return numbers


def _cameras(scene: Scene, count: int, width: int, height: int) -> list[tuple[float, Camera]]:
    """Return times (s) and cameras (world, meters)."""
    if is_random_scene(scene.name):
        return [(0.0, random_scene_camera(scene, width, height))] * count
    path = default_path(scene, width, height)
    times = np.linspace(path.start_s, path.end_s, count + 2)[1:-1].tolist()
    return [(time_s, path.camera(time_s, width, height)) for time_s in times]


def _print_recoloring(rows: list[dict[str, Any]], console: Console) -> None:
    stages = list(dict.fromkeys(stage for row in rows for stage in row["stages_s"]))
    columns = (
        "scene",
        "Gaussians",
        "seen",
        "views",
        "size",
        *(f"{each} s" for each in stages),
        "ms/step",
        "dB",
        "dB then",
    )
    table = Table(*columns, box=None)
    for row in rows:
        table.add_row(
            row["scene"],
            f"{row['gaussians']:,}",
            f"{row['seen']:,}",
            str(row["views"]),
            f"{row['width']}x{row['height']}",
            *(f"{row['stages_s'][stage]:.2f}" for stage in stages),
            f"{row['iteration_ms']:.0f}",
            f"{row['psnr_before_db']:.1f}",
            f"{row['psnr_db']:.1f}",
        )
    console.print(table)
