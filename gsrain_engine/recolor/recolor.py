"""Recoloring of a scene to images: solving, optional refinement, scores and report; and wet colors by a transfer."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float32

from ..appearance.base import ClearView, Transfer
from ..appearance.wet_look.settings import WetSettings
from ..datasets.capture import Capture
from ..evaluation.image_metrics import compare_images, psnr
from ..report.charts import comparison_sheet
from ..report.page import ReportCurve, RunReport
from ..report.result import RunResult
from ..report.table import Table, columns
from ..scene.progress import Progress, subprogress
from ..scene.scene import Scene
from ..training.evaluation import validation_indices
from .problem import ColorProblem, ProblemView, Solution, choose_prior_weight, color_prior_of
from .result import RecolorMember, scene_members, with_colors
from .settings import RecolorOptions, RecolorSettings
from .solver import Harmonics, SolverStep
from .views import TargetView, ViewObservation, ground_height_m, observe_view, surface_shares, target_views, thumbnail

_SETUP_DONE, _CHOSEN_DONE, _SOLVED_DONE = 0.4, 0.55, 0.96
"""Shares of the total time, measured on the built-in street with 30 views."""

_Result = TypeVar("_Result")
Colors = dict[str, Float32[np.ndarray, "_ _ 3"]]  # harmonics by member key


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
    prior: Colors
    """Mapped clear harmonics."""

    def colors(self, sh: Harmonics) -> Colors:
        """Harmonics of every member: solved where a view shows the Gaussian, else the mapped clear ones."""
        result: Colors = {}
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
    lengths: tuple[float, ...]
    """Norm of the preconditioned residual after each step, relative to the start of its round."""
    prior_weight: float
    """Weight of the mapped clear colors, given or selected."""

    @property
    def colors(self) -> Colors:
        return self.setup.colors(self.solution.sh)

    @property
    def weights_mb(self) -> float:
        problem = self.setup.problem
        return sum(view.observed.weights.nbytes for view in (*problem.views, *problem.held_out)) / 1e6

    @property
    def measured(self) -> list[RecolorViewReport]:
        """The held-out views; all views if none was held out."""
        return [view for view in self.views if view.is_held_out] or list(self.views)


def recolor_scene(
    scene: Scene, targets: Sequence[TargetView], held_out: Sequence[TargetView], settings: RecolorSettings
) -> Generator[Progress, None, RecolorResult]:
    """Solve the colors of a scene for images; its geometry and clear colors are unchanged.

    It may be stopped at every step; nothing is written. Stored weights stay within `settings.memory_mb`; the images and
    five times the harmonics of the visible Gaussians need additional memory. Raises ValueError without images, or if
    none shows anything of the scene.
    """
    started = perf_counter()
    setup = yield from subprogress(prepare_problem(scene, targets, held_out, settings), 0.0, _SETUP_DONE)
    ready = perf_counter()
    problem, prior_weight = setup.problem, settings.tikhonov
    if prior_weight is None:
        prior_weight = yield from _followed(choose_prior_weight(problem, settings), _choosing)
    settings = msgspec.structs.replace(settings, tikhonov=prior_weight)
    chosen = perf_counter()
    lengths: list[float] = []

    def solving(done: int, step: SolverStep | None) -> Progress:
        share = _CHOSEN_DONE + (_SOLVED_DONE - _CHOSEN_DONE) * done / settings.iterations
        if step is None:
            return Progress(share, f"Solving colors of {len(problem.rows):,} Gaussians")
        lengths.append(step.length)
        picture = problem.views[0].rendered(problem.prior + step.change)
        metrics = {"step": done, "residual": step.length}
        return Progress(share, f"Solving colors, step {done} of {settings.iterations}", thumbnail(picture), metrics)

    solution = yield from _followed(problem.solve(settings), solving)
    solved = perf_counter()
    yield Progress(_SOLVED_DONE, "Measuring")
    reports = _view_reports(setup, solution)
    seconds = {
        "set-up": ready - started,
        "choosing": chosen - ready,
        "solving": solved - chosen,
        "measuring": perf_counter() - solved,
    }
    yield Progress(1.0, "Done")
    return RecolorResult(reports, setup, solution, seconds, tuple(lengths), prior_weight)


def _followed(
    steps: Generator[SolverStep, None, _Result], progress: Callable[[int, SolverStep | None], Progress]
) -> Generator[Progress, None, _Result]:
    """Yield the progress before the first step and after each one; returns the result of the steps."""
    done, step = 0, None
    while True:
        yield progress(done, step)
        try:
            step = next(steps)
        except StopIteration as finished:
            return finished.value
        done += 1


def _choosing(done: int, _: SolverStep | None) -> Progress:
    share = 1 - 0.9**done  # the number of trials is not known in advance
    return Progress(_SETUP_DONE + (_CHOSEN_DONE - _SETUP_DONE) * share, "Choosing how far to trust the pictures")


def _view_reports(setup: ProblemInputs, solution: Solution) -> tuple[RecolorViewReport, ...]:
    problem = setup.problem
    fitted = [(view, trust, False) for view, trust in zip(problem.views, solution.trust.tolist(), strict=True)]
    reports: list[RecolorViewReport] = []
    for view, trust, is_held_out in [*fitted, *((view, 1.0, True) for view in problem.held_out)]:
        observed = view.observed
        if observed.counted.any():
            clear = observed.alpha[..., None] * observed.clear + (1 - observed.alpha[..., None]) * observed.target.image
            pictures = (np.clip(clear, 0, 1), view.rendered(problem.prior), view.rendered(solution.sh))
            figures = [psnr(picture, observed.target.image, observed.counted) for picture in pictures]
            reports.append(RecolorViewReport(observed.target.name, is_held_out, trust, *figures))
    return tuple(reports)


# Recoloring a scene to a capture

_READ_DONE = 0.05
_COMPARED = 6


@dataclass(frozen=True, slots=True, eq=False)
class RecolorRun:
    """Result of a recoloring with its report."""

    scene: Scene
    recolored: RecolorResult
    report: RunReport
    numbers: dict[str, Any]
    problems: tuple[str, ...] = ()
    """Of the capture."""

    @property
    def result(self) -> RunResult[Scene]:
        """The scene with its numbers; the figure compares views, rendered on the left."""
        titled = {"view": "", "clear dB": ".2f", "mapped dB": ".2f", "recolored dB": ".2f", "trust": ""}
        rows = [
            (
                view.name, view.psnr_clear_db, view.psnr_mapped_db, view.psnr_db,
                "held out" if view.is_held_out else f"{view.trust:.2f}",
            )
            for view in self.recolored.views
        ]  # fmt: skip
        line = "No view was held out: how well it shows new views is not known."
        if self.numbers["psnr_held_out_db"] is not None:
            line = (
                "Held-out views: {psnr_held_out_db:.2f} dB ({psnr_before_db:.2f} dB clear, {psnr_mapped_db:.2f} dB "
                "after the color map), in {seconds:.1f} s"
            ).format(**self.numbers)
        table, page = Table("Views", columns(titled), rows), self.report
        return RunResult(
            made=self.scene, table=table, numbers=self.numbers, lines=(*self.problems, line), page=page,
            draw=lambda: comparison_sheet(page.comparisons),
        )  # fmt: skip


def recolor_to_capture(
    scene: Scene, capture: Capture, options: RecolorOptions
) -> Generator[Progress, None, RecolorRun]:
    """Recolor a scene to the images of a capture, whose cameras are in the scene's own units and axes.

    It may be stopped at every step without having written anything. Raises `CaptureError` for an unreadable image, and
    ValueError if the cameras are unknown or show nothing of the scene.
    """
    if not capture.has_poses:
        raise ValueError(f"{capture.name}: has pictures, but not where their cameras stood; name them with --capture")
    spared = set(validation_indices([view.name for view in capture], options.held_out))
    targets: list[TargetView] = []
    for target in target_views(scene, capture, options.width_px):
        yield Progress(_READ_DONE * len(targets) / len(capture), f"Reading {target.name}")
        targets.append(target)
    fitted, held_out = ([t for i, t in enumerate(targets) if (i in spared) == out] for out in (False, True))
    later = (options.polish > 0) + (options.refine > 0)
    last = 1 / (1 + 2 * later)
    recolored = yield from subprogress(recolor_scene(scene, fitted, held_out, options.colors), _READ_DONE, last)
    if options.polish:
        middle = last + (1 - last) / later
        recolored = yield from subprogress(_polished(recolored, options), last, middle)
        last = middle
    changed = {key: scene.member(key).gaussians.with_sh(sh) for key, sh in recolored.colors.items()}
    if options.refine:
        from .refine import refine  # torch is an extra

        problem = recolored.setup.problem
        eyes = np.stack([view.observed.target.camera.position for view in problem.views])
        size_m = max(float(np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).max()) * 1.1, 1.0)
        refining = refine(changed, problem.views, recolored.solution, options.refine, size_m)
        changed = yield from subprogress(refining, last, 1.0)
    result = scene
    for key, new in changed.items():
        if options.replace_clear:
            result = result.with_member(key, gaussians=new, wet_sh=None)
        else:
            clear = scene.member(key).gaussians
            result = result.with_member(key, gaussians=new.with_sh(clear.sh), wet_sh=new.sh)
    yield Progress(1.0, "Done")
    numbers = _numbers(scene, recolored)
    report = _run_report(scene, capture, recolored, options, numbers)
    return RecolorRun(result, recolored, report, numbers, capture.problems)


def _polished(recolored: RecolorResult, options: RecolorOptions) -> Generator[Progress, None, RecolorResult]:
    from .refine import photometric_refine  # torch is an extra

    def polishing(done: int, _: SolverStep | None) -> Progress:
        done = min(done, options.polish - 1)
        return Progress(done / options.polish, f"Polishing, step {done + 1} of {options.polish}")

    solution = recolored.solution
    solver = photometric_refine(recolored.setup.problem, solution, options.polish, options.colors.sh_degree)
    solution = replace(solution, sh=(yield from _followed(solver, polishing)))
    return replace(recolored, solution=solution, views=_view_reports(recolored.setup, solution))


def _numbers(scene: Scene, recolored: RecolorResult) -> dict[str, Any]:
    held_out = [view for view in recolored.views if view.is_held_out]
    fitted = [view for view in recolored.views if not view.is_held_out]
    return {
        "seconds": round(sum(recolored.seconds.values()), 3),
        "gaussians": scene.gaussian_count,
        "views": len(fitted),
        "views_held_out": len(held_out),
        "width_px": max(view.observed.target.camera.width for view in recolored.setup.problem.views),
        "psnr_before_db": _mean([view.psnr_clear_db for view in recolored.measured]),
        "psnr_mapped_db": _mean([view.psnr_mapped_db for view in recolored.measured]),
        "psnr_held_out_db": _mean([view.psnr_db for view in held_out]),
        "psnr_db": _mean([view.psnr_db for view in fitted]),
        "trust": {view.name: round(view.trust, 4) for view in fitted},
        "seconds_by_stage": {name: round(seconds, 3) for name, seconds in recolored.seconds.items()},
        "weights_mb": round(recolored.weights_mb, 1),
        "pull": recolored.prior_weight,
    }


def _mean(figures: list[float]) -> float | None:
    """Mean of the finite values, rounded; None without any."""
    finite = [figure for figure in figures if np.isfinite(figure)]
    return round(float(np.mean(finite)), 3) if finite else None


def _run_report(
    scene: Scene, capture: Capture, recolored: RecolorResult, options: RecolorOptions, numbers: dict[str, Any]
) -> RunReport:
    problem = recolored.setup.problem
    compared = (problem.held_out or problem.views)[:_COMPARED]
    steps = np.arange(1, len(recolored.lengths) + 1)
    plain = msgspec.to_builtins(options)
    settings = plain.pop("colors") | plain
    return RunReport(
        f"Recoloring of {scene.name} to {capture.name}",
        settings,
        (ReportCurve("residual", steps, np.array(recolored.lengths, np.float64), is_logarithmic=True),),
        tuple(
            compare_images(
                own.target.name, view.rendered(recolored.solution.sh), own.target.image, own.counted
            )
            for view in compared if (own := view.observed).counted.any()
        ),
        recolored.seconds,
        {
            "Gaussians": f"{numbers['gaussians']:,}",
            "Clear scene": f"{numbers['psnr_before_db']} dB",
            "After the color map": f"{numbers['psnr_mapped_db']} dB",
            "Held-out views" if problem.held_out else "Views": f"{_mean([v.psnr_db for v in recolored.measured])} dB",
        },
        capture.problems + tuple(
            f"{view.name} disagrees with the other views: it counts {view.trust:.0%}"
            for view in recolored.views if view.trust < 0.5
        ),
    )  # fmt: skip


# Set-up

_VIEWS_DONE = 0.6  # share of the set-up spent on rendering views, measured on the built-in street


def prepare_problem(
    scene: Scene, targets: Sequence[TargetView], held_out: Sequence[TargetView], settings: RecolorSettings
) -> Generator[Progress, None, ProblemInputs]:
    """Set up the recoloring of a scene to images; raises ValueError if none shows anything of the scene."""
    if not targets:
        raise ValueError("recoloring needs at least one picture to recolor to")
    members, ground_m = scene_members(scene), ground_height_m(scene)
    views: list[ViewObservation] = []
    room = settings.memory_mb * 1e6
    for i, target in enumerate([*targets, *held_out]):
        yield Progress(_VIEWS_DONE * i / (len(targets) + len(held_out)), f"Looking at view {target.name}")
        views.append(observe_view(scene, members, target, ground_m, room))
        room -= views[-1].weights.nbytes
    used_mb = settings.memory_mb - room / 1e6
    yield Progress(_VIEWS_DONE, f"Mapping colors; weights of {len(views)} views take {used_mb:,.0f} MB")
    fitted = views[: len(targets)]
    if not any(len(view.splats) and view.counted.any() for view in fitted):
        raise ValueError(f"none of the {len(fitted)} cameras sees anything of the scene {scene.name!r}")
    change = color_prior_of(fitted, robust=settings.robust)
    shares = surface_shares(scene, members, fitted, ground_m)
    prior = {member.key: change.of_sh(member.gaussians.sh, own) for member, own in zip(members, shares, strict=True)}
    setup = ProblemInputs(_problem(members, prior, views, len(targets)), tuple(members), prior)
    yield Progress(1.0, "Set up")
    return setup


def _problem(
    members: Sequence[RecolorMember], prior: Colors, views: Sequence[ViewObservation], fitted: int
) -> ColorProblem:
    k = max(member.gaussians.sh.shape[1] for member in members)
    is_visible = np.zeros(sum(len(member.gaussians) for member in members), np.bool_)
    for view in views:
        is_visible[view.rows] = True
    rows, numbers = np.flatnonzero(is_visible), np.cumsum(is_visible) - 1
    start = np.zeros((len(rows), k, 3), np.float32)
    for member in members:
        first, last = np.searchsorted(rows, [member.rows.start, member.rows.stop])
        own = prior[member.key]
        start[first:last, : own.shape[1]] = own[rows[first:last] - member.first]
    listed = tuple(ProblemView(view, numbers[view.rows], view.basis(k)) for view in views)
    evidence = np.zeros((2, len(rows)), np.float32)
    for view in listed[:fitted]:
        own = view.observed.weights.squared_sums(view.observed.counted.astype(np.float32))
        evidence[0, view.indices] += own
        evidence[1, view.indices] += own * own
    one_view = evidence[1] / np.maximum(evidence[0], np.float32(1e-6))
    return ColorProblem(rows, listed[:fitted], listed[fitted:], start, one_view)


# Wet colors from transferred views

_TRANSFERRED_DONE = 0.7  # share of the total time, measured on the built-in street with the wet look


def rainy_scene(
    scene: Scene, views: Sequence[ClearView], transfer: Transfer, settings: RecolorSettings
) -> Generator[Progress, None, Scene]:
    """Give a scene wet colors; its geometry and clear colors are unchanged.

    The views may be lazy. The transfer makes a view rainy; fully wet, since wetness then blends between clear and wet
    colors. It may be stopped at every step without having written anything. Previews are thumbnails of the latest
    transferred view, then of the first view with the current colors. Raises ValueError without views, or if none shows
    anything of the scene.

    Where ground is found, the scene gets a map of its water.
    """
    if not len(views):
        raise ValueError("a scene needs at least one view to become rainy")
    targets = yield from _transferred(views, transfer)
    recolored = yield from subprogress(recolor_scene(scene, targets, [], settings), _TRANSFERRED_DONE, 1.0)
    return with_colors(scene, recolored.colors)


def _transferred(views: Sequence[ClearView], transfer: Transfer) -> Generator[Progress, None, list[TargetView]]:
    targets, preview = list[TargetView](), None
    rainy = iter(transfer.transferred(views))
    while True:
        done, count = len(targets), len(views)
        yield Progress(
            _TRANSFERRED_DONE * done / count, f"Making view {min(done + 1, count)} of {count} rainy", preview
        )
        made = next(rainy, None)
        if made is None:
            return targets
        targets.append(TargetView(made.clear.name, made.clear.camera, made.clear.time_s, made.image))
        preview = thumbnail(made.image)


def wet_scene(scene: Scene, settings: WetSettings | None = None) -> Generator[Progress, None, Scene]:
    """Give a scene the computed wet look, Gaussian by Gaussian; its geometry and clear colors are unchanged.

    Where ground is found, the scene gets a map of its water, and wet colors without reflections: the mirror adds them.
    """
    from ..appearance.wet_look.water_map import with_water  # loads slow parts of scipy
    from ..appearance.wet_look.wet_gaussians import wet_gaussian_colors

    yield Progress(0.0, "Finding the ground, and the water that it holds")
    scene, heights = with_water(scene)
    colors = yield from wet_gaussian_colors(scene, settings or WetSettings(), heights)
    return with_colors(scene, colors)
