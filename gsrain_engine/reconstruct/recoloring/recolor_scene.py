"""Recolours a scene to pictures: from views to new harmonics of each layer and actor, step by step."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import msgspec
import numpy as np
from jaxtyping import Float32

from gsrain_engine.evaluate.image_metrics import psnr
from gsrain_engine.scene.progress import Progress, part_of
from gsrain_engine.scene.scene import Scene

from .choice import chosen_pull
from .preview import small_picture
from .problem import ProblemView, Solution
from .settings import RecolorSettings
from .setup import SetUp, set_up
from .views import TargetView

_SETUP_DONE, _CHOSEN_DONE, _SOLVED_DONE = 0.4, 0.55, 0.96
"""Shares of the whole time, measured on the built-in street with 30 views."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewReport:
    """What came of one view."""

    name: str
    is_held_out: bool
    trust: float
    """How far it agrees with the others, 0 to 1; 1 where it had no say."""
    psnr_clear_db: float
    """Of the scene as it was, against the picture."""
    psnr_mapped_db: float
    """Of the clear colours after the best global map."""
    psnr_db: float


@dataclass(frozen=True, slots=True, eq=False)
class Recolored:
    """New colours of a scene, and how close they come."""

    views: tuple[ViewReport, ...]
    setup: SetUp
    solution: Solution
    seconds: dict[str, float]
    """By stage."""
    lengths: tuple[float, ...]
    """Of the preconditioned residual after each step, compared with the start of its round."""
    pull: float
    """Towards the mapped clear colours, given or chosen."""

    @property
    def colors(self) -> dict[str, Float32[np.ndarray, "_ _ 3"]]:
        """New harmonics by the keys of members."""
        return self.setup.colors(self.solution.sh)

    @property
    def weights_mb(self) -> float:
        problem = self.setup.problem
        return sum(view.seen.weights.nbytes for view in (*problem.views, *problem.held_out)) / 1e6

    def with_solution(self, solution: Solution) -> "Recolored":
        """Return the same with other colours, measured anew."""
        return replace(self, solution=solution, views=_reports(self.setup, solution))

    @property
    def measured(self) -> list[ViewReport]:
        """The held-out views; all of them where none was held out."""
        return [view for view in self.views if view.is_held_out] or list(self.views)


def recolor_scene(
    scene: Scene, targets: Sequence[TargetView], held_out: Sequence[TargetView], settings: RecolorSettings
) -> Generator[Progress, None, Recolored]:
    """Solve the colours of a scene for pictures; its geometry and its clear colours stay as they are.

    It can be stopped at every step: nothing is written anywhere. Stored weights are held within `settings.memory_mb`;
    the pictures and five times the harmonics of what the views see come on top.

    Raises:
        ValueError: When there is no picture, or none shows anything of the scene.
    """
    started = perf_counter()
    setup = yield from part_of(set_up(scene, targets, held_out, settings), 0.0, _SETUP_DONE)
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
    return Recolored(reports, setup, solution, seconds, lengths, pull)


def _chosen(setup: SetUp, settings: RecolorSettings) -> Generator[Progress, None, float]:
    trials, done = chosen_pull(setup.problem, settings), 0
    while True:
        share = 1 - 0.9**done  # how many there will be shows only on the way
        yield Progress(_SETUP_DONE + (_CHOSEN_DONE - _SETUP_DONE) * share, "Choosing how far to trust the pictures")
        try:
            next(trials)
        except StopIteration as finished:
            return finished.value
        done += 1


def _solved(setup: SetUp, settings: RecolorSettings) -> Generator[Progress, None, tuple[Solution, tuple[float, ...]]]:
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
        picture = problem.views[0].shown(problem.prior + step.change)
        yield Progress(share, f"Solving colours, step {len(lengths)} of {settings.iterations}", small_picture(picture))


def _reports(setup: SetUp, solution: Solution) -> tuple[ViewReport, ...]:
    problem = setup.problem
    taught = [(view, trust, False) for view, trust in zip(problem.views, solution.trust.tolist(), strict=True)]
    measured = [*taught, *((view, 1.0, True) for view in problem.held_out)]
    return tuple(
        _report(view, setup, solution, trust, is_held_out=is_held_out)
        for view, trust, is_held_out in measured
        if view.seen.counted.any()
    )


def _report(view: ProblemView, setup: SetUp, solution: Solution, trust: float, *, is_held_out: bool) -> ViewReport:
    seen = view.seen
    clear = seen.alpha[..., None] * seen.clear + (1 - seen.alpha[..., None]) * seen.target.image
    pictures = (np.clip(clear, 0, 1), view.shown(setup.problem.prior), view.shown(solution.sh))
    figures = [psnr(picture, seen.target.image, seen.counted) for picture in pictures]
    return ViewReport(seen.target.name, is_held_out, trust, *figures)
