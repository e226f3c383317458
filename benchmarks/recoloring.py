"""Convergence of recoloring compared with Adam. Prints JSON, and draws a figure."""

import argparse
import json
import os
import time
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from matplotlib.figure import Figure

from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.evaluation.image_metrics import psnr
from gsrain_engine.recolor.problem import ColorProblem, RecolorSettings, choose_prior_weight
from gsrain_engine.recolor.recolor import ProblemInputs, prepare_problem
from gsrain_engine.recolor.views import TargetView
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import linear_to_srgb, srgb_to_linear
from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import Scene

MOMENTS, HELD_OUT_MOMENTS, RIG, SIZE = 10, 3, "waymo_front3", (480, 320)
PLAIN = RecolorSettings(exposure=False, robust=False, rounds=1, tikhonov=0.3)
"""Conjugate gradients alone; by default the prior's weight is chosen, and exposures and outliers are estimated."""

RATES = (0.01, 0.02, 0.06)
"""Adam's learning rates of degree 0; the higher harmonics' is a twentieth, as in 3DGS."""

Result = TypeVar("Result")
Curve = list[tuple[float, float]]
"""Seconds, and mean held-out PSNR in dB."""


def known_change(picture: np.ndarray, view: CaptureFrame) -> np.ndarray:
    """Make a picture of the street look otherwise in a known way: darker tones, a dark road, light from a low sun."""
    light = srgb_to_linear(np.clip(picture, 0, 1).astype(np.float64))
    normals = view.normals
    assert view.sky is not None and normals is not None
    sky = view.sky[..., None]
    grey = light.mean(axis=2, keepdims=True)
    toned = 0.55 * np.array([0.9, 1.0, 1.12]) * (grey + 0.7 * (light - grey)) ** 1.15
    road = (view.labels == Label.ROAD)[..., None]
    toned = np.where(road, 0.45 * toned, toned)
    v, u = np.mgrid[: view.camera.height, : view.camera.width] + 0.5
    rays = np.dstack([(u - view.camera.cx) / view.camera.fx, (v - view.camera.cy) / view.camera.fy, np.ones_like(u)])
    rays = rays @ view.camera.world_to_camera[:3, :3]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    mirrored = rays - 2 * np.sum(rays * normals, axis=2, keepdims=True) * normals
    sun = np.array([0.8, 0.3, 0.52])
    gloss = np.maximum(mirrored @ (sun / np.linalg.norm(sun)), 0)[..., None] ** 8
    shown = np.where(sky, 0.6 * grey**0.5 * np.array([0.95, 1.0, 1.05]), toned + 0.12 * gloss)
    return np.clip(linear_to_srgb(np.clip(shown, 0, 1)), 0, 1).astype(np.float32)


def street_views(scene: Scene, times_s: list[float], *, mesh: bool = False) -> Iterator[TargetView]:
    """Render the street, and change how it looks by what its mesh says about each pixel."""
    from gsrain_extras.street.build import street_surfaces
    from gsrain_extras.street.ground_truth import StreetViews

    photographer = StreetViews(street_surfaces(), with_lead=False)
    for time_s in times_s:
        for mounted in scene.rigs[RIG]:
            camera = rig_camera(scene, RIG, mounted.name, time_s).resized(*SIZE)
            view = photographer.view(camera, time_s, f"{mounted.name} {time_s:.1f} s")
            picture = _drawn(scene, time_s, camera) if not mesh else view.image / 255
            yield TargetView(view.name, camera, time_s, known_change(picture, view))


def _drawn(scene: Scene, time_s: float, camera: Camera) -> np.ndarray:
    renderer = CpuRenderer()
    renderer.draw(scene.parts(time_s), camera)
    return renderer.read().rgba[..., :3]


def street(*, mesh: bool = False) -> tuple[Scene, list[TargetView], list[TargetView]]:
    """Return the street without cars that move, thirty views of it, and nine from between those."""
    from gsrain_engine.scene.open import load_built_in

    scene = replace(load_built_in(), actors=())
    times = np.linspace(0.5, 11.5, MOMENTS)
    between = (times[1:] + times[:-1])[:: (MOMENTS - 1) // HELD_OUT_MOMENTS][:HELD_OUT_MOMENTS] / 2
    taught, held_out = (list(street_views(scene, each.tolist(), mesh=mesh)) for each in (times, between))
    return scene, taught, held_out


def transferred(scene_path: Path, capture_path: Path) -> tuple[Scene, list[TargetView], list[TargetView]]:
    """Return a reconstructed scene and its photographs in the wet look; every seventh is kept apart."""
    from gsrain_engine.appearance.scene_views import PlacedCamera, scene_view
    from gsrain_engine.appearance.wet_look.environment import SceneEnvironment
    from gsrain_engine.appearance.wet_look.settings import WetSettings
    from gsrain_engine.appearance.wet_look.translator import WetTransfer
    from gsrain_engine.datasets.open_capture import open_capture
    from gsrain_engine.recolor.views import target_views
    from gsrain_engine.scene.formats.scene_files import read_scene

    scene = replace(read_scene(scene_path), actors=())
    targets = list(target_views(scene, open_capture(capture_path), SIZE[0]))
    placed = [PlacedCamera(target.name, target.camera, target.time_s) for target in targets]
    clear = [replace(scene_view(scene, p), image=target.image) for p, target in zip(placed, targets, strict=True)]
    rainy = WetTransfer(WetSettings(), SceneEnvironment(scene)).transferred(clear)
    views = [replace(target, image=each.image) for target, each in zip(targets, rainy, strict=True)]
    kept = set(range(3, len(views), 7))
    taught, held_out = ([view for i, view in enumerate(views) if (i in kept) == out] for out in (False, True))
    return scene, taught, held_out


def held_out_psnr(problem: ColorProblem, sh: np.ndarray) -> float:
    """Mean over held-out views, as renderers show them."""
    return float(np.mean([psnr(v.rendered(sh), v.observed.target.image, v.observed.counted) for v in problem.held_out]))


def finished_with(steps: Generator[Any, None, Result]) -> Result:
    """Run a generator to its end, and return what it returns."""
    while True:
        try:
            next(steps)
        except StopIteration as finished:
            return finished.value


def solved(
    scene: Scene, targets: list[TargetView], held_out: list[TargetView], settings: RecolorSettings
) -> tuple[Curve, ProblemInputs]:
    """Recolor; the clock stands while held-out views are measured."""
    started = time.process_time()
    setup = finished_with(prepare_problem(scene, targets, held_out, settings))
    problem = setup.problem
    if settings.tikhonov is None:
        settings = msgspec.structs.replace(settings, tikhonov=finished_with(choose_prior_weight(problem, settings)))
    curve: Curve = [(time.process_time() - started, held_out_psnr(problem, problem.prior))]
    paused = time.process_time() - started - curve[0][0]
    for step in problem.solve(settings):
        now = time.process_time()
        curve.append((now - started - paused, held_out_psnr(problem, problem.prior + step.change)))
        paused += time.process_time() - now
    return curve, setup


def adam(scene: Scene, setup: ProblemInputs, rate: float, steps: int, *, mapped: bool = False) -> Curve:
    """Optimize the same harmonics by Adam, one view a step, each rasterized anew.

    Squared error; the rate falls to a tenth. Starts at the clear colors, or at the mapped ones as the solver does.
    """
    import torch

    from gsrain_engine.render.autodiff.differentiable import render_gaussians

    started = time.process_time()
    g = Gaussians.concatenate([layer.gaussians for layer in scene.layers])
    k = g.sh.shape[1]
    degree_k = np.concatenate([np.full(len(each.gaussians), each.gaussians.sh.shape[1]) for each in scene.layers])
    free = torch.from_numpy((np.arange(k)[None, :, None] < degree_k[:, None, None]).astype(np.float32))
    start = g.sh
    if mapped:
        parts = [setup.prior[layer.key] for layer in scene.layers]
        start = np.concatenate([np.pad(each, ((0, 0), (0, k - each.shape[1]), (0, 0))) for each in parts])
    dc, rest = (torch.from_numpy(each.copy()).requires_grad_() for each in (start[:, :1], start[:, 1:]))
    optimizer = torch.optim.Adam([{"params": [dc], "lr": rate}, {"params": [rest], "lr": rate / 20}], fused=True)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.1 ** (1 / steps))
    means, scales, quaternions, opacities = map(torch.from_numpy, (g.means, g.scales, g.quaternions, g.opacities))
    views, order = setup.problem.views, np.random.default_rng(0)
    images = [torch.from_numpy(view.observed.target.image) for view in views]
    turns = np.concatenate([order.permutation(len(views)) for _ in range(-(-steps // len(views)))])
    curve: Curve = []
    paused = 0.0
    for step, chosen in enumerate(turns[:steps].tolist()):
        sh = torch.cat([dc, rest], dim=1) * free
        rendered = render_gaussians(means, scales, quaternions, opacities, sh, views[chosen].observed.target.camera)
        shown = torch.from_numpy(views[chosen].observed.counted)[..., None]  # not what is masked
        wanted = images[chosen] * rendered.alpha.detach()[..., None]
        optimizer.zero_grad()
        ((rendered.color - wanted) ** 2 * shown).mean().backward()
        optimizer.step()
        schedule.step()
        if step % 50 == 49 or step in (0, 4, 9, 24):
            now = time.process_time()
            sh = (torch.cat([dc, rest], dim=1) * free).detach().numpy()
            curve.append((now - started - paused, held_out_psnr(setup.problem, sh[setup.problem.rows])))
            paused += time.process_time() - now
    return curve


def draw(file: Path, curves: dict[str, Curve]) -> None:
    """Draw held-out PSNR against time."""
    figure = Figure(figsize=(7.2, 4), dpi=110, layout="constrained")
    axes = figure.subplots()
    for name, curve in curves.items():
        seconds, psnr_db = zip(*curve, strict=True)
        axes.plot(seconds, psnr_db, label=name, linewidth=1.2 if name.startswith("Adam") else 2.2)
    axes.set_xscale("log")
    axes.set_xlabel("processor seconds on one thread, set-up included")
    axes.set_ylabel("held-out views: PSNR in dB")
    axes.grid(alpha=0.3, which="both")
    axes.legend(loc="lower right", fontsize=8)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)


def reached(curve: Curve, figure: float) -> float | None:
    """Seconds after which a curve has come to a figure; None where it never does."""
    return next((seconds for seconds, psnr_db in curve if psnr_db >= figure), None)


def main() -> None:
    """Compare, on one thread: processor seconds of two programs then say the same on a machine with company."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1000, help="of Adam")
    parser.add_argument("--rates", default=",".join(str(rate) for rate in RATES), help="of Adam, with commas between")
    parser.add_argument("--mesh", action="store_true", help="photographs of the mesh instead of renders")
    parser.add_argument("--scene", type=Path, help="a reconstructed scene in place of the street")
    parser.add_argument("--capture", type=Path, help="what that was made from; its pictures get a plain wet look")
    parser.add_argument("--figure", type=Path, help="PNG to draw")
    arguments = parser.parse_args()
    import torch

    os.environ["NUMBA_NUM_THREADS"] = "1"
    torch.set_num_threads(1)
    if arguments.scene is not None and arguments.capture is not None:
        scene, targets, held_out = transferred(arguments.scene, arguments.capture)
    else:
        scene, targets, held_out = street(mesh=arguments.mesh)
    for settings in (RecolorSettings(), PLAIN):
        solved(scene, targets[:2], held_out[:1], settings)  # kernels compile
    curves: dict[str, Curve] = {}
    curves["conjugate gradients"], setup = solved(scene, targets, held_out, PLAIN)
    curves["as `gsrain recolor` does"], _ = solved(scene, targets, held_out, RecolorSettings())
    adam(scene, setup, 0.01, 3)
    for rate in map(float, arguments.rates.split(",")):
        curves[f"Adam, rate {rate:g}"] = adam(scene, setup, rate, arguments.steps)
    best_s, best = max((curve[-1] for name, curve in curves.items() if name.startswith("Adam")), key=lambda end: end[1])
    took = {name: reached(curves[name], best) for name in ("conjugate gradients", "as `gsrain recolor` does")}
    if arguments.figure is not None:
        draw(arguments.figure, curves)
    numbers = {
        "gaussians": sum(len(each.gaussians) for each in scene.layers), "unknowns": len(setup.problem.rows),
        "views": len(targets), "held_out": len(held_out),
        "weights_mb": round(sum(v.observed.weights.nbytes for v in setup.problem.views) / 1e6, 1),
        "adam_psnr_db": best, "adam_s": best_s, "reached_after_s": took,
        "share_of_adam": {name: None if s is None else round(s / best_s, 3) for name, s in took.items()},
        "curves": curves,
    }  # fmt: skip
    print(json.dumps(numbers, indent=1))


if __name__ == "__main__":
    main()
