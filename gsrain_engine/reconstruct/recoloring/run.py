"""A whole recolouring: a scene and a capture in, the scene with wet colours out, with the figures and the report."""

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float32
from msgspec import Meta, Struct

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.evaluate.report.comparison import Comparison
from gsrain_engine.evaluate.report.run_report import Curve, RunReport
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.progress import Progress, part_of
from gsrain_engine.scene.scene import Scene

from ..training.held_out import held_out_indices
from .problem import ProblemView, Solution
from .recolor_scene import Recolored, recolor_scene
from .settings import RecolorSettings
from .views import TargetView, target_views

_READ_DONE = 0.05
_COMPARED = 6
"""Views that the report shows, at most."""

_Result = TypeVar("_Result")


class RecolorOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What to do beside solving."""

    width_px: Annotated[int, Meta(ge=16, le=16384, title="Width of pictures", extra={"unit": "px"})] = 960
    """Wider pictures are made smaller; others stay as they are."""
    held_out: Annotated[int, Meta(ge=0, title="Held out")] = 8
    """Every so-many-th view has no say and measures the result; 0 for none."""
    polish: Annotated[int, Meta(ge=0, le=100_000, title="Polish steps")] = 0
    """Steps of absolute differences and D-SSIM after least squares, on colours alone."""
    refine: Annotated[int, Meta(ge=0, le=100_000, title="Refine steps")] = 0
    """Steps in which all parameters move."""
    replace_clear: bool = False
    """Whether the new colours take the place of the clear ones, instead of standing beside them as wet ones."""
    colors: RecolorSettings = msgspec.field(default_factory=RecolorSettings)


@dataclass(frozen=True, slots=True, eq=False)
class RecolorRun:
    """What came of it."""

    scene: Scene
    recolored: Recolored
    report: RunReport
    numbers: dict[str, Any]
    """What `--json` holds."""


def recolor_to_capture(
    scene: Scene, capture: Capture, options: RecolorOptions
) -> Generator[Progress, None, RecolorRun]:
    """Recolour a scene to the pictures of a capture, whose cameras are in the scene's own units and axes.

    It can be stopped at every step, and has written nothing then. Raises `CaptureError` for a picture that can't be
    read, and ValueError where the cameras are not known or see nothing of the scene.
    """
    if not capture.has_poses:
        raise ValueError(f"{capture.name}: has pictures, but not where their cameras stood; name them with --capture")
    kept = set(held_out_indices([view.name for view in capture], options.held_out))
    targets: list[TargetView] = []
    for target in target_views(scene, capture, options.width_px):
        yield Progress(_READ_DONE * len(targets) / len(capture), f"Reading {target.name}")
        targets.append(target)
    taught, held_out = ([t for i, t in enumerate(targets) if (i in kept) == out] for out in (False, True))
    later = (options.polish > 0) + (options.refine > 0)
    last = 1 / (1 + 2 * later)
    recolored = yield from part_of(recolor_scene(scene, taught, held_out, options.colors), _READ_DONE, last)
    if options.polish:
        middle = last + (1 - last) / later
        recolored = yield from part_of(_polished(recolored, options), last, middle)
        last = middle
    gaussians: dict[str, Gaussians] = {}
    if options.refine:
        gaussians = yield from part_of(_refined(scene, recolored, options.refine), last, 1.0)
    result = _with_colors(scene, recolored.colors, gaussians, replace_clear=options.replace_clear)
    yield Progress(1.0, "Done")
    numbers = _numbers(scene, recolored)
    return RecolorRun(result, recolored, _report(scene, capture, recolored, options, numbers), numbers)


def _with_colors(
    scene: Scene, colors: dict[str, Float32[np.ndarray, "_ _ 3"]], refined: dict[str, Gaussians], *, replace_clear: bool
) -> Scene:
    for key, sh in colors.items():
        clear = scene.member(key).gaussians
        new = refined.get(key, clear.with_sh(sh))
        if replace_clear:
            scene = scene.with_member(key, gaussians=new, wet_sh=None)
        else:
            scene = scene.with_member(key, gaussians=new.with_sh(clear.sh), wet_sh=new.sh)
    return scene


def _polished(recolored: Recolored, options: RecolorOptions) -> Generator[Progress, None, Recolored]:
    from .polish import polish  # torch is an extra

    steps, done = options.polish, 0
    solver = polish(recolored.setup.problem, recolored.solution, steps, options.colors.sh_degree)
    while True:
        yield Progress(done / steps, f"Polishing, step {done + 1} of {steps}")
        try:
            next(solver)
        except StopIteration as finished:
            return recolored.with_solution(replace(recolored.solution, sh=finished.value))
        done = min(done + 1, steps - 1)


def _refined(scene: Scene, recolored: Recolored, steps: int) -> Generator[Progress, None, dict[str, Gaussians]]:
    from .refine import refine  # torch is an extra

    members = {key: scene.member(key).gaussians.with_sh(sh) for key, sh in recolored.colors.items()}
    problem, solution = recolored.setup.problem, recolored.solution
    eyes = np.stack([view.seen.target.camera.position for view in problem.views])
    size_m = max(float(np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).max()) * 1.1, 1.0)
    return (yield from refine(members, problem.views, solution, steps, size_m))


def _numbers(scene: Scene, recolored: Recolored) -> dict[str, Any]:
    held_out = [view for view in recolored.views if view.is_held_out]
    taught = [view for view in recolored.views if not view.is_held_out]
    return {
        "seconds": round(sum(recolored.seconds.values()), 3),
        "gaussians": scene.gaussian_count,
        "views": len(taught),
        "views_held_out": len(held_out),
        "width_px": max(view.seen.target.camera.width for view in recolored.setup.problem.views),
        "psnr_before_db": _mean([view.psnr_clear_db for view in recolored.measured]),
        "psnr_mapped_db": _mean([view.psnr_mapped_db for view in recolored.measured]),
        "psnr_held_out_db": _mean([view.psnr_db for view in held_out]),
        "psnr_db": _mean([view.psnr_db for view in taught]),
        "trust": {view.name: round(view.trust, 4) for view in taught},
        "seconds_by_stage": {name: round(seconds, 3) for name, seconds in recolored.seconds.items()},
        "weights_mb": round(recolored.weights_mb, 1),
        "pull": recolored.pull,
    }


def _mean(figures: list[float]) -> float | None:
    """Mean of what is finite, rounded; None where nothing is."""
    finite = [figure for figure in figures if np.isfinite(figure)]
    return round(float(np.mean(finite)), 3) if finite else None


def _report(
    scene: Scene, capture: Capture, recolored: Recolored, options: RecolorOptions, numbers: dict[str, Any]
) -> RunReport:
    problem, solution = recolored.setup.problem, recolored.solution
    shown = (problem.held_out or problem.views)[:_COMPARED]
    steps = np.arange(1, len(recolored.lengths) + 1)
    plain = msgspec.to_builtins(options)
    settings = plain.pop("colors") | plain
    return RunReport(
        f"Recolouring of {scene.name} to {capture.name}",
        settings,
        (Curve("residual", steps, np.array(recolored.lengths, np.float64), is_logarithmic=True),),
        tuple(_comparison(view, solution) for view in shown if view.seen.counted.any()),
        recolored.seconds,
        {
            "Gaussians": f"{numbers['gaussians']:,}",
            "Clear scene": f"{numbers['psnr_before_db']} dB",
            "After the colour map": f"{numbers['psnr_mapped_db']} dB",
            "Held-out views" if problem.held_out else "Views": f"{_mean([v.psnr_db for v in recolored.measured])} dB",
        },
        capture.problems + tuple(
            f"{view.name} disagrees with the other views: it counts {view.trust:.0%}"
            for view in recolored.views if view.trust < 0.5
        ),
    )  # fmt: skip


def _comparison(view: ProblemView, solution: Solution) -> Comparison:
    seen = view.seen
    return Comparison.measured(seen.target.name, view.shown(solution.sh), seen.target.image, seen.counted)
