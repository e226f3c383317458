"""`gsrain bench recoloring`: how fast this machine gives scenes the colours of pictures."""

from dataclasses import asdict
from typing import Annotated, Any

import msgspec
import numpy as np
from cyclopts import Parameter

from gsrain_engine.reconstruct.recoloring.recoloring_times import RecoloringTimes, time_recoloring
from gsrain_engine.reconstruct.recoloring.settings import RecolorSettings
from gsrain_engine.render.machine import machine
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.random_scene import is_random_scene, random_scene_camera
from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.view.home_camera import default_path

from ..console import Console, Table
from .arguments import JsonFileOrScreen, listed, parse_size, words_go_to, write_numbers
from .bench import timed_scene
from .outputs import check_writable
from .progress import progress_bar


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
    """Time recolouring scenes to darkened pictures of themselves: looking, choosing, solving, measuring."""
    check_writable(json)
    if not 1 <= views <= 1000:
        raise ValueError(f"--views {views}: must be within 1..1000")
    width, height = parse_size(size)
    try:
        settings = msgspec.convert({"iterations": iterations}, RecolorSettings)
    except msgspec.ValidationError as error:
        raise ValueError(f"--iterations {iterations}: {error}") from None
    names = listed("--scenes", scenes)
    rows: list[RecoloringTimes] = []
    with progress_bar("Recolouring", len(names)) as advance:
        for name in names:
            scene = timed_scene(name)
            rows.append(time_recoloring(scene, _cameras(scene, views, width, height), settings))
            advance()
    _print(rows, Console(file=words_go_to(json), width=120))
    numbers = {"rows": [asdict(row) for row in rows], "machine": machine()}
    write_numbers(json, numbers)
    return numbers


def _cameras(scene: Scene, count: int, width: int, height: int) -> list[tuple[float, Camera]]:
    """Moments (s) and cameras (world, metres)."""
    if is_random_scene(scene.name):
        return [(0.0, random_scene_camera(scene, width, height))] * count
    path = default_path(scene, width, height)
    times = np.linspace(path.start_s, path.end_s, count + 2)[1:-1].tolist()
    return [(time_s, path.camera(time_s, width, height)) for time_s in times]


def _print(rows: list[RecoloringTimes], console: Console) -> None:
    stages = list(dict.fromkeys(stage for row in rows for stage in row.stages_s))
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
            row.scene,
            f"{row.gaussians:,}",
            f"{row.seen:,}",
            str(row.views),
            f"{row.width}x{row.height}",
            *(f"{row.stages_s[stage]:.2f}" for stage in stages),
            f"{row.iteration_ms:.0f}",
            f"{row.psnr_before_db:.1f}",
            f"{row.psnr_db:.1f}",
        )
    console.print(table)
