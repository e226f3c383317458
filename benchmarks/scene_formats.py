"""Sizes, times and losses of scene formats, and of those of splat-transform (PlayCanvas) in one run. Prints JSON."""

import argparse
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gsrain_engine.backends import open_renderer
from gsrain_engine.editor.viewport.camera import home_camera
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.sky_color import sky_color
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.registry import read_gaussians, write_gaussians
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.scene.transforms import FILE_UP

WRITTEN_BY_OTHERS = (".compressed.ply", ".spz", ".sog", ".glb")
SIZE_PX = 960, 640


LONG_S = 20.0
SPLAT_TRANSFORM = Path(__file__).parents[1] / "tests/npm/node_modules/@playcanvas/splat-transform/bin/cli.mjs"


def shortest_s(work: Callable[[], object], repeats: int) -> float:
    """Least time of a number of repeats, of fewer if they take longer than `LONG_S`."""
    times: list[float] = []
    while len(times) < repeats and sum(times) < LONG_S:
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return round(min(times), 3)


def picture(renderer: Renderer, gaussians: Gaussians, camera: Camera) -> "np.ndarray[Any, Any]":
    scene = Scene("scene", layers=(Layer("scene", gaussians),), up=FILE_UP)
    sky = sky_color(renderer, scene, camera).at(0.0)
    draw(renderer, FrameInput.of(scene, None, sky, RenderView(camera)))
    return np.array(renderer.read_uint8(), np.float64)


def psnr_db(first: "np.ndarray[Any, Any]", second: "np.ndarray[Any, Any]") -> float | None:
    error = float(np.mean((first - second) ** 2))
    return None if error == 0 else round(10 * np.log10(255**2 / error), 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, help="a .ply")
    parser.add_argument("--formats", default=".compressed.ply,.splat,.spz,.sog,.glb,.usdz")
    found = str(SPLAT_TRANSFORM) if SPLAT_TRANSFORM.exists() else shutil.which("splat-transform")
    parser.add_argument("--splat-transform", default=found, help="its program; `make npm` installs it")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    before = read_gaussians(arguments.scene)
    scene = Scene("scene", layers=(Layer("scene", before),), up=FILE_UP)
    camera = home_camera(scene, *SIZE_PX)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name, open_renderer("cpu") as renderer:
        folder = Path(name)
        original = picture(renderer, before, camera)
        write_gaussians(before, folder / "scene.ply")
        for suffix in arguments.formats.split(","):
            ours, theirs = folder / f"ours{suffix}", folder / f"theirs{suffix}"
            writers: dict[str, tuple[Path, Callable[[], object]]] = {
                "ours": (ours, lambda ours=ours: write_gaussians(read_gaussians(folder / "scene.ply"), ours))
            }
            if arguments.splat_transform and suffix in WRITTEN_BY_OTHERS:
                command = ["node", arguments.splat_transform, "-q", "-w", "-g", "cpu"]
                line = [*command, str(folder / "scene.ply"), str(theirs)]
                writers["splat-transform"] = theirs, partial(subprocess.run, line, check=True, capture_output=True)
            for writer, (path, write) in writers.items():
                seconds = shortest_s(write, arguments.repeats)
                after = read_gaussians(path)
                rows.append(
                    {
                        "format": suffix,
                        "writer": writer,
                        "megabytes": round(path.stat().st_size / 1e6, 3),
                        "read_ply_and_write_s": seconds,
                        "read_here_s": shortest_s(lambda path=path: read_gaussians(path), arguments.repeats),
                        "picture_psnr_db": psnr_db(picture(renderer, after, camera), original),
                    }
                )
    print(json.dumps({"gaussians": len(before), "sh_degree": before.sh_degree, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
