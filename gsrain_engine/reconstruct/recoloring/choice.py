"""How strongly to pull towards the mapped clear colours: what explains views best that were left out for a moment."""

from collections.abc import Generator
from dataclasses import replace

import msgspec
import numpy as np

from .problem import ColorProblem, ProblemView
from .settings import RecolorSettings
from .solver import Step, solve_colors

STRENGTHS = (300.0, 30.0, 3.0, 0.3)
"""Pulls that are tried, in evidence of a Gaussian (squared weights, summed over pixels and views)."""

_SPARED = 4
"""Every so-many-th view is left out."""
_MOST_VIEWS = 16
_ITERATIONS = 4


def chosen_pull(problem: ColorProblem, settings: RecolorSettings) -> Generator[Step, None, float]:
    """Try pulls, the strongest first, as long as views that were left out become clearer.

    A scene whose geometry is right gains with hardly any pull. One that is not would paint its errors into colours
    that fit the given views alone: there the mapped clear colours know more. With fewer than `_SPARED` views it can't
    be told, and a middling pull is taken. Yields the solver's steps.
    """
    views = problem.views[:: -(-len(problem.views) // _MOST_VIEWS)]
    spared = views[_SPARED // 2 :: _SPARED]
    taught = tuple(view for i, view in enumerate(views) if i % _SPARED != _SPARED // 2)
    if len(views) < _SPARED:
        return STRENGTHS[1]
    trial = replace(problem, views=taught, held_out=spared)
    best, least = STRENGTHS[0], np.inf
    targets, nothing = trial.first_targets(settings), np.zeros_like(problem.prior)
    for strength in STRENGTHS:
        pull = trial.pull(msgspec.structs.replace(settings, tikhonov=strength))
        change = nothing
        for step in solve_colors(targets, len(problem.rows), _ITERATIONS, pull, nothing):
            change = step.change
            yield step
        error = float(np.median([_error(view, problem.prior + change) for view in spared]))
        if error > least:
            break
        best, least = strength, error
    return best


def _error(view: ProblemView, sh: np.ndarray) -> float:
    """Mean squared error of a view; 0 where no pixel counts."""
    counted = view.seen.counted
    difference = (view.shown(sh) - view.seen.target.image)[counted]
    return float(np.mean(difference**2)) if counted.any() else 0.0
