"""`gsrain bench recoloring`: how fast this machine gives scenes the colours of pictures."""

from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from cyclopts import Parameter
from jaxtyping import Float32

from gsrain_engine.raster.cpu_renderer import CpuRenderer
from gsrain_engine.reconstruct.recoloring.recolor_scene import recolor_scene
from gsrain_engine.reconstruct.recoloring.settings import RecolorSettings
from gsrain_engine.reconstruct.recoloring.views import TargetView
from gsrain_engine.render.machine import machine
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.progress import finished
from gsrain_engine.scene.random_scene import is_random_scene, random_scene_camera
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.srgb import linear_to_srgb, srgb_to_linear
from gsrain_engine.session.view.home_camera import default_path

from ..console import Console, Table
from .arguments import JsonFileOrScreen, listed, parse_size, words_go_to, write_numbers
from .bench import timed_scene
from .outputs import check_writable
from .progress import progress_bar

_DARKER = np.array([0.5, 0.55, 0.62])
"""Share of light that the pictures keep, by channel: about what an overcast sky and wet ground leave."""
_HALF_HEIGHT = 0.5
"""From here down pictures are darker still, as wet ground is: no map of all colours alike explains them."""
_WET_SHARE = 0.6


def time_recoloring(scene: Scene, cameras: Sequence[tuple[float, Camera]], settings: RecolorSettings) -> dict[str, Any]:
    """Recolour a scene to darkened pictures of itself; cameras are in the world (metres), each with its moment in s.

    Stages are setup (looking from every view), choosing (how far to trust), solving and measuring. An iteration is one
    forward and one transposed pass over all views; PSNR is the mean over the views against the pictures.

    Raises ValueError where no camera sees anything of the scene.
    """
    renderer, targets = CpuRenderer(), list[TargetView]()
    for number, (time_s, camera) in enumerate(cameras):
        renderer.draw(scene.parts(time_s), camera)
        targets.append(TargetView(f"view {number}", camera, time_s, darkened(renderer.read().rgba[..., :3])))
    recolored = finished(recolor_scene(scene, targets, (), settings))
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
    """Return a picture (display colour) with less light, and still less in its lower half."""
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
    rows: list[dict[str, Any]] = []
    with progress_bar("Recolouring", len(names)) as advance:
        for name in names:
            scene = timed_scene(name)
            rows.append(time_recoloring(scene, _cameras(scene, views, width, height), settings))
            advance()
    _print(rows, Console(file=words_go_to(json), width=120))
    numbers = {"rows": rows, "machine": machine()}
    write_numbers(json, numbers)
    return numbers


def _cameras(scene: Scene, count: int, width: int, height: int) -> list[tuple[float, Camera]]:
    """Moments (s) and cameras (world, metres)."""
    if is_random_scene(scene.name):
        return [(0.0, random_scene_camera(scene, width, height))] * count
    path = default_path(scene, width, height)
    times = np.linspace(path.start_s, path.end_s, count + 2)[1:-1].tolist()
    return [(time_s, path.camera(time_s, width, height)) for time_s in times]


def _print(rows: list[dict[str, Any]], console: Console) -> None:
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
