"""A recolouring as a least-squares problem: unknown harmonics of what any view sees, their prior, and the views."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64

from .robust import pixel_trust, spread, view_trust
from .settings import RecolorSettings
from .solver import TIKHONOV, ColorTarget, Step, colors_seen, solve_colors
from .view_affine import NO_CHANGE, ViewAffine, view_affines
from .views import SeenView

_HALF = np.float32(0.5)
_FROZEN = np.float32(1e9)
"""Pull that keeps a harmonic where it is."""


@dataclass(frozen=True, slots=True, eq=False)
class ProblemView:
    """A view with its splats among the unknowns."""

    seen: SeenView
    indices: Int64[np.ndarray, " m"]
    basis: Float32[np.ndarray, "m k"]

    def picture(self, sh: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "h w 3"]:
        """Premultiplied picture of harmonics, in the linear model."""
        return self.seen.weights.blend(_HALF + colors_seen(sh, self.indices, self.basis))

    def shown(self, sh: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "h w 3"]:
        """Picture as renderers show it, no splat's colour below 0, over what is there; what isn't is the target's."""
        colors = np.maximum(_HALF + colors_seen(sh, self.indices, self.basis), np.float32(0))
        over = (1 - self.seen.alpha[..., None]) * self.seen.target.image
        return np.clip(self.seen.weights.blend(colors) + over, 0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Colours, and what was found out about the views on the way."""

    sh: Float32[np.ndarray, "n k 3"]
    affines: tuple[ViewAffine, ...]
    """What each picture's own exposure and white balance is."""
    trust: Float64[np.ndarray, " v"]
    """How far each view agrees with the others, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class ColorProblem:
    """Unknowns are the Gaussians that any view sees, in the order of all members' Gaussians."""

    rows: Int64[np.ndarray, " n"]
    """Row of each unknown among the Gaussians of all members."""
    views: tuple[ProblemView, ...]
    held_out: tuple[ProblemView, ...]
    """Views that have no say."""
    prior: Float32[np.ndarray, "n k 3"]
    one_view: Float32[np.ndarray, " n"]
    """Mean evidence (sum of squared weights) of each Gaussian in one view."""

    def pull(self, settings: RecolorSettings) -> Float32[np.ndarray, "n k 1"]:
        """Pull towards the prior by evidence.

        Above degree 0 the evidence of one view adds its share: however many pixels a single view has of a Gaussian, it
        shows it from one side.
        """
        tikhonov = TIKHONOV if settings.tikhonov is None else settings.tikhonov
        pull = np.full((*self.prior.shape[:2], 1), tikhonov, np.float32)
        pull[:, 1:, 0] = tikhonov * settings.directional + settings.per_view * self.one_view[:, None]
        pull[:, (settings.sh_degree + 1) ** 2 :] = _FROZEN
        return pull

    def solve(self, settings: RecolorSettings) -> Generator[Step, None, Solution]:
        """Solve for colours; exposures are found first, trust is worked out anew before each round.

        Yields:
            The solver's steps; their `change` is from the prior.
        """
        sh = self.prior
        affines, pull = (NO_CHANGE,) * len(self.views), self.pull(settings)
        if settings.exposure and len(self.views) > 1:
            affines = _affines(self.views, len(self.rows))
        solution = Solution(sh, affines, np.ones(len(self.views)))
        for turn, iterations in enumerate(settings.iterations_by_round):
            pictures = [view.picture(solution.sh) for view in self.views]
            solution, targets = self._weighed(solution, pictures, settings, is_first=turn == 0)
            offset = solution.sh - self.prior
            solver = solve_colors(targets, len(self.rows), iterations, pull, offset)
            change = offset
            for step in solver:
                change = offset + step.change
                yield Step(step.length, change)
            solution = Solution(self.prior + change, solution.affines, solution.trust)
        return solution

    def first_targets(self, settings: RecolorSettings) -> list[ColorTarget]:
        """What the views say while their exposures are taken for equal, and nothing has been solved for."""
        beginning = Solution(self.prior, (NO_CHANGE,) * len(self.views), np.ones(len(self.views)))
        pictures = [view.picture(self.prior) for view in self.views]
        return self._weighed(beginning, pictures, settings, is_first=True)[1]

    def _weighed(
        self, solution: Solution, pictures: Sequence[Float32[np.ndarray, "_ _ 3"]], settings: RecolorSettings,
        *, is_first: bool,
    ) -> tuple[Solution, list[ColorTarget]]:  # fmt: skip
        """Work out trust from the pictures of the colours so far, and with it what is wanted."""
        affines, trust = solution.affines, solution.trust
        counted = [view.seen.counted for view in self.views]
        residuals = [
            affine.undone(view.seen.target.image) * view.seen.alpha[..., None] - picture
            for view, picture, affine in zip(self.views, pictures, affines, strict=True)
        ]
        by_pixel = [each.astype(np.float32) for each in counted]
        if settings.robust:
            spreads = [spread(residual, own) for residual, own in zip(residuals, counted, strict=True)]
            trust = view_trust(spreads)
            # Before colours have been solved for, a pixel far off is only one that has changed.
            typical = 1e6 if is_first else float(np.median(spreads))
            by_pixel = [
                np.float32(of_view) * own * pixel_trust(residual, typical)
                for of_view, own, residual in zip(trust, by_pixel, residuals, strict=True)
            ]
        targets = [
            ColorTarget(view.seen.weights, view.indices, view.basis, residual, pixels)
            for view, residual, pixels in zip(self.views, residuals, by_pixel, strict=True)
        ]
        return Solution(solution.sh, affines, trust), targets


def _affines(views: Sequence[ProblemView], count: int) -> tuple[ViewAffine, ...]:
    counted = [view.seen.counted.astype(np.float32)[..., None] for view in views]
    seen = [
        view.seen.weights.accumulate(own * view.seen.target.image) for view, own in zip(views, counted, strict=True)
    ]
    evidence = [
        np.ascontiguousarray(view.seen.weights.accumulate(np.repeat(own, 3, axis=2))[:, 0])
        for view, own in zip(views, counted, strict=True)
    ]
    return tuple(view_affines(seen, evidence, [view.indices for view in views], count))
