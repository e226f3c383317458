"""Recoloring of a scene to images: solving, optional refinement, scores and report."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float32
from msgspec import Meta, Struct

from ..datasets.capture import Capture
from ..evaluation.image_metrics import psnr
from ..evaluation.report import ReportCurve, RunReport
from ..evaluation.report_charts import ImageComparison
from ..scene.gaussians import Gaussians
from ..scene.progress import Progress, subprogress
from ..scene.scene import Scene
from ..training.evaluation import validation_indices
from .problem import (
    ColorPrior,
    ColorProblem,
    ProblemView,
    RecolorSettings,
    Solution,
    choose_prior_weight,
    error_scale,
    fit_color_prior,
    irls_view_weights,
)
from .result import RecolorMember, scene_members
from .views import TargetView, ViewObservation, ground_height_m, observe_view, surface_shares, target_views, thumbnail

_SETUP_DONE, _CHOSEN_DONE, _SOLVED_DONE = 0.4, 0.55, 0.96
"""Shares of the total time, measured on the built-in street with 30 views."""


@dataclass(frozen=True, slots=True, eq=False)
class RecolorViewReport:
    """Scores of one view."""

    name: str
    is_held_out: bool
    trust: float
    """Agreement with the others, 0 to 1; 1 for held-out views."""
    psnr_clear_db: float
    """Of the original scene, against the image."""
    psnr_mapped_db: float
    """Of the clear colors after the best global map."""
    psnr_db: float


# Problem inputs


@dataclass(frozen=True, slots=True, eq=False)
class ProblemInputs:
    """A problem, with the data that turns its solution into a scene's colors."""

    problem: ColorProblem
    members: tuple[RecolorMember, ...]
    prior: dict[str, Float32[np.ndarray, "_ _ 3"]]
    """Mapped clear harmonics by member key."""

    def colors(self, sh: Float32[np.ndarray, "n k 3"]) -> dict[str, Float32[np.ndarray, "_ _ 3"]]:
        """Harmonics of every member: solved where a view shows the Gaussian, else the mapped clear ones."""
        result: dict[str, Float32[np.ndarray, "_ _ 3"]] = {}
        for member in self.members:
            first, last = np.searchsorted(self.problem.rows, [member.rows.start, member.rows.stop])
            own = self.prior[member.key].copy()
            own[self.problem.rows[first:last] - member.first] = sh[first:last, : own.shape[1]]
            result[member.key] = own
        return result


@dataclass(frozen=True, slots=True, eq=False)
class RecolorResult:
    """New colors of a scene and their scores."""

    views: tuple[RecolorViewReport, ...]
    setup: ProblemInputs
    solution: Solution
    seconds: dict[str, float]
    """By stage."""
    lengths: tuple[float, ...]
    """Norm of the preconditioned residual after each step, relative to the start of its round."""
    pull: float
    """Weight of the mapped clear colors, given or selected."""

    @property
    def colors(self) -> dict[str, Float32[np.ndarray, "_ _ 3"]]:
        return self.setup.colors(self.solution.sh)

    @property
    def weights_mb(self) -> float:
        problem = self.setup.problem
        return sum(view.seen.weights.nbytes for view in (*problem.views, *problem.held_out)) / 1e6

    def with_solution(self, solution: Solution) -> "RecolorResult":
        """Return a copy with other colors and new scores."""
        return replace(self, solution=solution, views=_reports(self.setup, solution))

    @property
    def measured(self) -> list[RecolorViewReport]:
        """The held-out views; all views if none was held out."""
        return [view for view in self.views if view.is_held_out] or list(self.views)


def recolor_scene(
    scene: Scene, targets: Sequence[TargetView], held_out: Sequence[TargetView], settings: RecolorSettings
) -> Generator[Progress, None, RecolorResult]:
    """Solve the colors of a scene for images; its geometry and clear colors are unchanged.

    It may be stopped at every step; nothing is written. Stored weights stay within `settings.memory_mb`; the images and
    five times the harmonics of the visible Gaussians need additional memory.

    Raises:
        ValueError: Without images, or if none shows anything of the scene.
    """
    started = perf_counter()
    setup = yield from subprogress(prepare_problem(scene, targets, held_out, settings), 0.0, _SETUP_DONE)
    ready = perf_counter()
    pull = settings.tikhonov if settings.tikhonov is not None else (yield from _chosen(setup, settings))
    settings = msgspec.structs.replace(settings, tikhonov=pull)
    chosen = perf_counter()
    solution, lengths = yield from _solved(setup, settings)
    solved = perf_counter()
    yield Progress(_SOLVED_DONE, "Measuring")
    reports = _reports(setup, solution)
    seconds = {
        "set-up": ready - started,
        "choosing": chosen - ready,
        "solving": solved - chosen,
        "measuring": perf_counter() - solved,
    }
    yield Progress(1.0, "Done")
    return RecolorResult(reports, setup, solution, seconds, lengths, pull)


def _chosen(setup: ProblemInputs, settings: RecolorSettings) -> Generator[Progress, None, float]:
    trials, done = choose_prior_weight(setup.problem, settings), 0
    while True:
        share = 1 - 0.9**done  # the number of trials is not known in advance
        yield Progress(_SETUP_DONE + (_CHOSEN_DONE - _SETUP_DONE) * share, "Choosing how far to trust the pictures")
        try:
            next(trials)
        except StopIteration as finished:
            return finished.value
        done += 1


def _solved(
    setup: ProblemInputs, settings: RecolorSettings
) -> Generator[Progress, None, tuple[Solution, tuple[float, ...]]]:
    problem, lengths = setup.problem, list[float]()
    solver = problem.solve(settings)
    yield Progress(_CHOSEN_DONE, f"Solving colours of {len(problem.rows):,} Gaussians")
    while True:
        try:
            step = next(solver)
        except StopIteration as finished:
            return finished.value, tuple(lengths)
        lengths.append(step.length)
        share = _CHOSEN_DONE + (_SOLVED_DONE - _CHOSEN_DONE) * len(lengths) / settings.iterations
        picture = problem.views[0].rendered(problem.prior + step.change)
        yield Progress(share, f"Solving colours, step {len(lengths)} of {settings.iterations}", thumbnail(picture))


def _reports(setup: ProblemInputs, solution: Solution) -> tuple[RecolorViewReport, ...]:
    problem = setup.problem
    taught = [(view, trust, False) for view, trust in zip(problem.views, solution.trust.tolist(), strict=True)]
    measured = [*taught, *((view, 1.0, True) for view in problem.held_out)]
    return tuple(
        _report(view, setup, solution, trust, is_held_out=is_held_out)
        for view, trust, is_held_out in measured
        if view.seen.counted.any()
    )


def _report(
    view: ProblemView, setup: ProblemInputs, solution: Solution, trust: float, *, is_held_out: bool
) -> RecolorViewReport:
    seen = view.seen
    clear = seen.alpha[..., None] * seen.clear + (1 - seen.alpha[..., None]) * seen.target.image
    pictures = (np.clip(clear, 0, 1), view.rendered(setup.problem.prior), view.rendered(solution.sh))
    figures = [psnr(picture, seen.target.image, seen.counted) for picture in pictures]
    return RecolorViewReport(seen.target.name, is_held_out, trust, *figures)


# Recoloring a scene to a capture

_READ_DONE = 0.05
_COMPARED = 6
_Result = TypeVar("_Result")


class RecolorOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of a recoloring besides those of the solver."""

    width_px: Annotated[int, Meta(ge=16, le=16384, title="Width of pictures", extra={"unit": "px"})] = 960
    """Wider images are downscaled; others are unchanged."""
    held_out: Annotated[int, Meta(ge=0, title="Held out")] = 8
    """Hold out every Nth view to measure the result; 0 for none."""
    polish: Annotated[int, Meta(ge=0, le=100_000, title="Polish steps")] = 0
    """Steps of L1 and D-SSIM after least squares, on colors alone."""
    refine: Annotated[int, Meta(ge=0, le=100_000, title="Refine steps")] = 0
    """Steps that train all parameters."""
    replace_clear: bool = False
    """Replace the clear colors instead of adding wet colors."""
    colors: RecolorSettings = msgspec.field(default_factory=RecolorSettings)


@dataclass(frozen=True, slots=True, eq=False)
class RecolorRun:
    """Result of a recoloring with its report."""

    scene: Scene
    recolored: RecolorResult
    report: RunReport
    numbers: dict[str, Any]
    """Content of the `--json` output."""


def recolor_to_capture(
    scene: Scene, capture: Capture, options: RecolorOptions
) -> Generator[Progress, None, RecolorRun]:
    """Recolor a scene to the images of a capture, whose cameras are in the scene's own units and axes.

    It may be stopped at every step without having written anything. Raises `CaptureError` for an unreadable image, and
    ValueError if the cameras are unknown or show nothing of the scene.
    """
    if not capture.has_poses:
        raise ValueError(f"{capture.name}: has pictures, but not where their cameras stood; name them with --capture")
    kept = set(validation_indices([view.name for view in capture], options.held_out))
    targets: list[TargetView] = []
    for target in target_views(scene, capture, options.width_px):
        yield Progress(_READ_DONE * len(targets) / len(capture), f"Reading {target.name}")
        targets.append(target)
    taught, held_out = ([t for i, t in enumerate(targets) if (i in kept) == out] for out in (False, True))
    later = (options.polish > 0) + (options.refine > 0)
    last = 1 / (1 + 2 * later)
    recolored = yield from subprogress(recolor_scene(scene, taught, held_out, options.colors), _READ_DONE, last)
    if options.polish:
        middle = last + (1 - last) / later
        recolored = yield from subprogress(_polished(recolored, options), last, middle)
        last = middle
    gaussians: dict[str, Gaussians] = {}
    if options.refine:
        gaussians = yield from subprogress(_refined(scene, recolored, options.refine), last, 1.0)
    result = _with_colors(scene, recolored.colors, gaussians, replace_clear=options.replace_clear)
    yield Progress(1.0, "Done")
    numbers = _numbers(scene, recolored)
    return RecolorRun(result, recolored, _run_report(scene, capture, recolored, options, numbers), numbers)


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


def _polished(recolored: RecolorResult, options: RecolorOptions) -> Generator[Progress, None, RecolorResult]:
    from .refine import photometric_refine  # torch is an extra

    steps, done = options.polish, 0
    solver = photometric_refine(recolored.setup.problem, recolored.solution, steps, options.colors.sh_degree)
    while True:
        yield Progress(done / steps, f"Polishing, step {done + 1} of {steps}")
        try:
            next(solver)
        except StopIteration as finished:
            return recolored.with_solution(replace(recolored.solution, sh=finished.value))
        done = min(done + 1, steps - 1)


def _refined(scene: Scene, recolored: RecolorResult, steps: int) -> Generator[Progress, None, dict[str, Gaussians]]:
    from .refine import refine  # torch is an extra

    members = {key: scene.member(key).gaussians.with_sh(sh) for key, sh in recolored.colors.items()}
    problem, solution = recolored.setup.problem, recolored.solution
    eyes = np.stack([view.seen.target.camera.position for view in problem.views])
    size_m = max(float(np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).max()) * 1.1, 1.0)
    return (yield from refine(members, problem.views, solution, steps, size_m))


def _numbers(scene: Scene, recolored: RecolorResult) -> dict[str, Any]:
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
    """Mean of the finite values, rounded; None without any."""
    finite = [figure for figure in figures if np.isfinite(figure)]
    return round(float(np.mean(finite)), 3) if finite else None


def _run_report(
    scene: Scene, capture: Capture, recolored: RecolorResult, options: RecolorOptions, numbers: dict[str, Any]
) -> RunReport:
    problem, solution = recolored.setup.problem, recolored.solution
    shown = (problem.held_out or problem.views)[:_COMPARED]
    steps = np.arange(1, len(recolored.lengths) + 1)
    plain = msgspec.to_builtins(options)
    settings = plain.pop("colors") | plain
    return RunReport(
        f"Recolouring of {scene.name} to {capture.name}",
        settings,
        (ReportCurve("residual", steps, np.array(recolored.lengths, np.float64), is_logarithmic=True),),
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


def _comparison(view: ProblemView, solution: Solution) -> ImageComparison:
    seen = view.seen
    return ImageComparison.measured(seen.target.name, view.rendered(solution.sh), seen.target.image, seen.counted)


_VIEWS_DONE = 0.6  # share of the set-up spent on rendering views, measured on the built-in street
_SPACING_PX = 3  # subsampling step; every third pixel in each direction suffices for maps of twelve numbers


def prepare_problem(
    scene: Scene, targets: Sequence[TargetView], held_out: Sequence[TargetView], settings: RecolorSettings
) -> Generator[Progress, None, ProblemInputs]:
    """Set up the recoloring of a scene to images; progress covers the set-up alone.

    Raises:
        ValueError: Without images, or if none shows anything of the scene.
    """
    if not targets:
        raise ValueError("recolouring needs at least one picture to recolour to")
    members, ground_m = scene_members(scene), ground_height_m(scene)
    views: list[ViewObservation] = []
    room = settings.memory_mb * 1e6
    for i, target in enumerate([*targets, *held_out]):
        yield Progress(_VIEWS_DONE * i / (len(targets) + len(held_out)), f"Looking at view {target.name}")
        views.append(observe_view(scene, members, target, ground_m, room))
        room -= views[-1].weights.nbytes
    used_mb = settings.memory_mb - room / 1e6
    yield Progress(_VIEWS_DONE, f"Mapping colours; weights of {len(views)} views take {used_mb:,.0f} MB")
    setup = prepare_observations(scene, members, views, len(targets), settings)
    yield Progress(1.0, "Set up")
    return setup


def prepare_observations(
    scene: Scene,
    members: Sequence[RecolorMember],
    views: Sequence[ViewObservation],
    taught: int,
    settings: RecolorSettings,
) -> ProblemInputs:
    """Set up a problem from observed views; those after the first `taught` are held out.

    Raises:
        ValueError: If none of the fitted views shows anything of the scene.
    """
    if not any(len(view.splats) and view.counted.any() for view in views[:taught]):
        raise ValueError(f"none of the {taught} cameras sees anything of the scene {scene.name!r}")
    change = _color_change(views[:taught], robust=settings.robust)
    prior: dict[str, Float32[np.ndarray, "_ _ 3"]] = {}
    shares = surface_shares(scene, members, views[:taught], ground_height_m(scene))
    for member, own in zip(members, shares, strict=True):
        prior[member.key] = change.of_sh(member.gaussians.sh, own)
    return ProblemInputs(_problem(members, prior, views, taught), tuple(members), prior)


def _color_change(views: Sequence[ViewObservation], *, robust: bool) -> ColorPrior:
    """Fit the color maps to all views, then refit with less weight on views with large errors."""
    some = [slice(None, None, _SPACING_PX)] * 2
    clear = [view.clear[*some].reshape(-1, 3) for view in views]
    wanted = [view.target.image[*some].reshape(-1, 3) for view in views]
    shares = [(view.surfaces * view.counted[..., None])[*some].reshape(-1, 3) for view in views]
    change = fit_color_prior(clear, wanted, shares)
    if not robust or len(views) < 3:
        return change
    errors = [(change.of_colors(x, w) - y)[None] for x, y, w in zip(clear, wanted, shares, strict=True)]
    trust = irls_view_weights(
        [error_scale(error, (w.sum(axis=1) > 0)[None]) for error, w in zip(errors, shares, strict=True)]
    )
    return fit_color_prior(clear, wanted, [np.float32(t) * w for t, w in zip(trust, shares, strict=True)])


def _problem(
    members: Sequence[RecolorMember],
    prior: dict[str, Float32[np.ndarray, "_ _ 3"]],
    views: Sequence[ViewObservation],
    taught: int,
) -> ColorProblem:
    k = max(member.gaussians.sh.shape[1] for member in members)
    is_seen = np.zeros(sum(len(member.gaussians) for member in members), np.bool_)
    for view in views:
        is_seen[view.rows] = True
    rows, numbers = np.flatnonzero(is_seen), np.cumsum(is_seen) - 1
    start = np.zeros((len(rows), k, 3), np.float32)
    for member in members:
        first, last = np.searchsorted(rows, [member.rows.start, member.rows.stop])
        own = prior[member.key]
        start[first:last, : own.shape[1]] = own[rows[first:last] - member.first]
    listed = tuple(ProblemView(view, numbers[view.rows], view.basis(k)) for view in views)
    return ColorProblem(rows, listed[:taught], listed[taught:], start, _one_view(listed[:taught], len(rows)))


def _one_view(views: Sequence[ProblemView], count: int) -> Float32[np.ndarray, " n"]:
    """Mean evidence of each Gaussian in one view, sum e^2 / sum e with e the sum of its squared weights in a view."""
    evidence = np.zeros((2, count), np.float32)
    for view in views:
        own = view.seen.weights.squared_sums(view.seen.counted.astype(np.float32))
        evidence[0, view.indices] += own
        evidence[1, view.indices] += own * own
    return evidence[1] / np.maximum(evidence[0], np.float32(1e-6))
