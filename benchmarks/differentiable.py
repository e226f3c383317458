"""Time of differentiable rendering, forward and backward, by stage. Prints JSON: minimum and median of N runs."""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from gsrain_engine.malloc_tuning import tune_malloc
from gsrain_engine.render.autodiff.blend import BlendedImage, blend, blend_backward
from gsrain_engine.render.autodiff.differentiable import render_gaussians
from gsrain_engine.render.autodiff.project import TrainedGaussians, project_backward, project_trained, sh_backward
from gsrain_engine.render.cpu.compositing import color_operator_transpose
from gsrain_engine.render.cpu.splats import nearest_first
from gsrain_engine.render.cpu.tiles import bin_into_tiles
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.open import random_scene
from gsrain_engine.threads import usable_cores


def gaussians_of(scene: str) -> TrainedGaussians:
    """A random scene with harmonics of degree 3."""
    g = random_scene(scene).layers[0].gaussians
    sh = 0.1 * np.random.default_rng(0).standard_normal((len(g), 16, 3), np.float32)
    sh[:, 0] = g.sh[:, 0]
    return TrainedGaussians(g.means, g.scales, g.quaternions, g.opacities, sh, np.zeros((0, 3), np.float32))


def timed(work: Callable[[], object], repeats: int) -> dict[str, float]:
    work()
    seconds: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return {"least_ms": round(1000 * min(seconds), 1), "median_ms": round(1000 * statistics.median(seconds), 1)}


def whole(gaussians: TrainedGaussians, camera: Camera, repeats: int) -> dict[str, dict[str, float]]:
    """Times of the public function and of torch's backward pass through it."""
    values = [torch.from_numpy(each).requires_grad_() for each in gaussians[:5]]
    pose = torch.from_numpy(camera.world_to_camera.astype(np.float32)).requires_grad_()
    rows = {"forward": timed(lambda: render_gaussians(*values, camera, world_to_camera=pose), repeats)}
    weights = torch.randn((camera.height, camera.width, 3), generator=torch.Generator().manual_seed(0))
    for name, wanted in (("backward", values), ("backward_colors_only", values[4:])):
        for each in (*values, pose):
            each.requires_grad_(False)
        for each in wanted:
            each.requires_grad_()
        pose.requires_grad_(name == "backward")
        seconds: list[float] = []
        for _ in range(repeats + 1):
            r = render_gaussians(*values, camera, world_to_camera=pose)
            outputs, pulls = [r.color], [weights]
            if name == "backward":
                outputs, pulls = [*outputs, r.alpha, r.depth], [*pulls, weights[..., 0], weights[..., 1]]
            start = time.perf_counter()
            torch.autograd.backward(outputs, pulls)
            seconds.append(time.perf_counter() - start)
            for each in (*values, pose):
                each.grad = None
        rows[name] = {
            "least_ms": round(1000 * min(seconds[1:]), 1), "median_ms": round(1000 * statistics.median(seconds[1:]), 1),
        }  # fmt: skip
    return rows


def stages(gaussians: TrainedGaussians, camera: Camera, repeats: int) -> tuple[dict[str, dict[str, float]], int]:
    """Times of the kernels one by one, and how many splats touch how many tiles."""
    pose, size = camera.world_to_camera, (camera.height, camera.width)
    splats = project_trained(gaussians, camera, pose)
    order = nearest_first(splats.channels[:, 3])
    tiles = bin_into_tiles(splats.shapes, order, camera.width, camera.height)
    outputs = blend(splats.shapes, splats.channels, tiles)
    r = np.random.default_rng(0)
    pulls = BlendedImage(*(r.standard_normal(shape, np.float32) for shape in ((*size, 3), size, size)))
    sums = blend_backward(splats.shapes, splats.channels, tiles, outputs, pulls)
    color_sums = color_operator_transpose(splats.shapes, pulls[0], tiles, with_squares=False)
    work: dict[str, Callable[[], object]] = {
        "forward project": lambda: project_trained(gaussians, camera, pose),
        "forward sort": lambda: nearest_first(splats.channels[:, 3]),
        "forward bin": lambda: bin_into_tiles(splats.shapes, order, camera.width, camera.height),
        "forward blend": lambda: blend(splats.shapes, splats.channels, tiles),
        "backward blend": lambda: blend_backward(splats.shapes, splats.channels, tiles, outputs, pulls),
        "backward project": lambda: project_backward(gaussians, splats, sums, camera, pose),
        "colors only blend": lambda: color_operator_transpose(splats.shapes, pulls[0], tiles, with_squares=False),
        "colors only project": lambda: sh_backward(gaussians, splats, color_sums, pose),
    }
    return {name: timed(each, repeats) for name, each in work.items()}, len(tiles.members)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="random-200k", help="a random scene by name")
    parser.add_argument("--size", default="480x320")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--threads", type=int, default=usable_cores())
    arguments = parser.parse_args()
    os.environ["NUMBA_NUM_THREADS"] = str(arguments.threads)
    tune_malloc()
    gaussians = gaussians_of(arguments.scene)
    camera = Camera.from_fov(*map(int, arguments.size.split("x")), 60.0, np.eye(4))
    rows = whole(gaussians, camera, arguments.repeats)
    by_stage, pairs = stages(gaussians, camera, arguments.repeats)
    print(json.dumps({
        "scene": arguments.scene, "size": arguments.size, "threads": arguments.threads,
        "gaussians": len(gaussians.means), "splats_in_tiles": pairs, "whole": rows, "stages": by_stage,
    }, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
