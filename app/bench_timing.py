"""Timing of frames, of reading and writing scenes, and of recoloring, behind `gsrain bench`."""

import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from statistics import correlation, linear_regression, median
from typing import Any, get_args

import msgspec
import numpy as np
from jaxtyping import Float32

from gsrain_engine.backends import open_renderer
from gsrain_engine.choices import Backend
from gsrain_engine.editor.viewport.camera import default_path
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.recolor.problem import RecolorSettings
from gsrain_engine.recolor.recolor import recolor_scene
from gsrain_engine.recolor.views import TargetView
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.opengl.context import NoOpenGLError
from gsrain_engine.render.renderer import Renderer, RenderStatistics
from gsrain_engine.render.sequence import FrameSequence
from gsrain_engine.render.sky_color import SkyColor
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.open import is_random_scene, load_scene, random_scene, random_scene_camera
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.scene import Scene

from .options import converted_options, split_list

_WARM_UP = 2  # untimed frames before the first timed one: kernels and shaders compile, buffers reach their size


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
            "sh_degree": sh_degree_of(scene),
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


def sh_degree_of(scene: Scene) -> int:
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


def simulation_of(intensity: str, settings: RainSettings) -> RainSimulation:
    if not re.fullmatch(r"\d+(\.\d*)?", intensity):
        raise ValueError(f"--rain {intensity}: expected intensities in mm/h such as 0,8.5")
    values = msgspec.to_builtins(settings) | {"intensity_mm_h": float(intensity)}
    return RainSimulation.start(converted_options(values, RainSettings))


def backends_of(text: str | None) -> list[Backend]:
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


# Scene files


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
        "sh_degree": sh_degree_of(back),
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


# Recoloring

_DARKER = np.array([0.5, 0.55, 0.62])
"""Share of light per channel that the target images have: roughly that of an overcast sky and wet ground."""

_HALF_HEIGHT, _WET_SHARE = 0.5, 0.6
"""Below this share of the height, images are darker still, like wet ground: no global color map explains that."""


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


def cameras_of(scene: Scene, count: int, width: int, height: int) -> list[tuple[float, Camera]]:
    """Return times (s) and cameras (world, meters)."""
    if is_random_scene(scene.name):
        return [(0.0, random_scene_camera(scene, width, height))] * count
    path = default_path(scene, width, height)
    times = np.linspace(path.start_s, path.end_s, count + 2)[1:-1].tolist()
    return [(time_s, path.camera(time_s, width, height)) for time_s in times]
