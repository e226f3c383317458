"""`gsrain bench render`: how fast this machine draws."""

import re
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict
from typing import Annotated, Any, get_args

import msgspec
from cyclopts import Parameter

from gsrain_engine.backends import Backend, device_of, open_renderer
from gsrain_engine.rain.presets import load_preset
from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.render.benchmark import FrameTimes, lines_over_gaussians, rain_costs, time_frames
from gsrain_engine.render.context import NoOpenGLError
from gsrain_engine.render.machine import machine
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.scene.open_scene import open_scene
from gsrain_engine.scene.random_scene import is_random_scene, random_scene, random_scene_camera
from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.view.home_camera import default_path

from ..console import Console, Table
from .arguments import JsonFileOrScreen, listed, parse_size, words_go_to, write_numbers
from .converted_options import RAIN_OPTIONS, converted_options
from .outputs import check_writable
from .progress import progress_bar

_SCENES = "random-50k,random-100k,random-200k,random-400k,random-800k,random-1m,random-3m,street"
_START_S = 1.0
_COLUMNS = 120  # of the table, also where output goes into a file


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
    """Time frames of fixed scenes: make the rain, draw, fetch the picture. Medians, by back end, size and rain."""
    check_writable(json)
    if not 1 <= frames <= 10_000:
        raise ValueError(f"--frames {frames}: must be within 1..10000")
    resolutions = [parse_size(each, "--sizes") for each in listed("--sizes", sizes)]
    rainfalls = [_rainfall(each) for each in listed("--rain", rain)]
    names = listed("--scenes", scenes)
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
    numbers = _report(rows) | {"machine": machine() | {"devices": devices}}
    _print(rows, numbers, Console(file=words_go_to(json), width=_COLUMNS))
    write_numbers(json, numbers)
    return numbers


def timed_scene(name: str) -> Scene:
    """Open a scene, or make a random one."""
    return random_scene(name) if is_random_scene(name) else open_scene(name)


def _rainfall(intensity: str) -> Rainfall:
    if not re.fullmatch(r"\d+(\.\d*)?", intensity):
        raise ValueError(f"--rain {intensity}: expected intensities in mm/h such as 0,8.5")
    values = msgspec.to_builtins(load_preset("paper")) | {"intensity_mm_h": float(intensity)}
    return Rainfall.start(converted_options(values, Rain, RAIN_OPTIONS))


def _backends(text: str | None) -> list[Backend]:
    """What was asked for, else what there is; auto becomes the one that it takes here."""
    known: dict[str, Backend] = {each: each for each in get_args(Backend)}
    wanted = listed("--backends", text) if text is not None else ["auto", "cpu", *_opengl()]
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
    scene: Scene, renderers: list[Renderer], resolutions: list[tuple[int, int]], rainfalls: list[Rainfall]
) -> Iterator[tuple[Renderer, list[FrameSequence]]]:
    """What takes turns: one scene, back end and size in all its rain."""
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
