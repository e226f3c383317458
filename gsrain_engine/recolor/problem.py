"""The recoloring least-squares problem: unknown harmonics, color prior, views, and robust weights."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64

from ..scene.gaussians import SH_C0
from .settings import RecolorSettings
from .solver import TIKHONOV, Basis, ColorTarget, Harmonics, Rows, SolverStep, evaluate_colors, solve_colors
from .views import NO_CHANGE, ViewAffine, ViewObservation, view_affines
from .weights import Picture

_HALF = np.float32(0.5)
_FROZEN = np.float32(1e9)  # prior weight that keeps a harmonic unchanged


@dataclass(frozen=True, slots=True, eq=False)
class ProblemView:
    """A view with the indices of its splats among the unknowns."""

    observed: ViewObservation
    indices: Rows
    basis: Basis

    def picture(self, sh: Harmonics) -> Picture:
        """Premultiplied image of the harmonics in the linear model."""
        return self.observed.weights.blend(_HALF + evaluate_colors(sh, self.indices, self.basis))

    def rendered(self, sh: Harmonics) -> Picture:
        """Image as renderers show it, splat colors clipped at 0; the target fills the remaining transparency."""
        colors = np.maximum(_HALF + evaluate_colors(sh, self.indices, self.basis), np.float32(0))
        over = (1 - self.observed.alpha[..., None]) * self.observed.target.image
        return np.clip(self.observed.weights.blend(colors) + over, 0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Solved colors with the view parameters estimated along with them."""

    sh: Harmonics
    affines: tuple[ViewAffine, ...]
    """Exposure and white balance of each image."""
    trust: Float64[np.ndarray, " v"]
    """Agreement of each view with the others, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class ColorProblem:
    """Unknowns are the Gaussians visible in any view, in the order of all members' Gaussians."""

    rows: Int64[np.ndarray, " n"]
    """Row of each unknown among the Gaussians of all members."""
    views: tuple[ProblemView, ...]
    held_out: tuple[ProblemView, ...]
    """Views that are not fitted."""
    prior: Harmonics
    one_view: Float32[np.ndarray, " n"]
    """Mean evidence (sum of squared weights) of each Gaussian in one view."""

    def prior_weights(self, settings: RecolorSettings) -> Float32[np.ndarray, "n k 1"]:
        """Weight of the prior, in units of evidence.

        Above degree 0 a share of one view's evidence is added: a single view shows a Gaussian from one direction,
        regardless of its number of pixels.
        """
        tikhonov = TIKHONOV if settings.tikhonov is None else settings.tikhonov
        weights = np.full((*self.prior.shape[:2], 1), tikhonov, np.float32)
        weights[:, 1:, 0] = tikhonov * settings.directional + settings.per_view * self.one_view[:, None]
        weights[:, (settings.sh_degree + 1) ** 2 :] = _FROZEN
        return weights

    def solve(self, settings: RecolorSettings) -> Generator[SolverStep, None, Solution]:
        """Solve for colors, first the exposures, before each round the trust; steps yield the change from the prior."""
        affines, weights = (NO_CHANGE,) * len(self.views), self.prior_weights(settings)
        if settings.exposure and len(self.views) > 1:
            affines = _affines(self.views, len(self.rows))
        solution = Solution(self.prior, affines, np.ones(len(self.views)))
        rounds = min(settings.rounds, settings.iterations)
        for turn in range(rounds):
            # As even as possible, the last rounds longer.
            iterations = settings.iterations * (turn + 1) // rounds - settings.iterations * turn // rounds
            pictures = [view.picture(solution.sh) for view in self.views]
            solution, targets = self._weighed(solution, pictures, settings, is_first=turn == 0)
            offset = solution.sh - self.prior
            change = offset
            for step in solve_colors(targets, len(self.rows), iterations, weights, offset):
                change = offset + step.change
                yield SolverStep(step.length, change)
            solution = replace(solution, sh=self.prior + change)
        return solution

    def first_targets(self, settings: RecolorSettings) -> list[ColorTarget]:
        """Targets of the views before the first solve, with identity exposures."""
        first = Solution(self.prior, (NO_CHANGE,) * len(self.views), np.ones(len(self.views)))
        pictures = [view.picture(self.prior) for view in self.views]
        return self._weighed(first, pictures, settings, is_first=True)[1]

    def _weighed(
        self, solution: Solution, pictures: Sequence[Float32[np.ndarray, "_ _ 3"]], settings: RecolorSettings,
        *, is_first: bool,
    ) -> tuple[Solution, list[ColorTarget]]:  # fmt: skip
        """Compute trust from the images of the current colors, and the targets weighted by it."""
        trust = solution.trust
        counted = [view.observed.counted for view in self.views]
        residuals = [
            affine.undone(view.observed.target.image) * view.observed.alpha[..., None] - picture
            for view, picture, affine in zip(self.views, pictures, solution.affines, strict=True)
        ]
        by_pixel = [each.astype(np.float32) for each in counted]
        if settings.robust:
            spreads = [error_scale(residual, own) for residual, own in zip(residuals, counted, strict=True)]
            trust = irls_view_weights(spreads)
            # Before the first solve, a large error only marks a changed pixel.
            typical = 1e6 if is_first else float(np.median(spreads))
            by_pixel = [
                np.float32(of_view) * own * irls_pixel_weights(residual, typical)
                for of_view, own, residual in zip(trust, by_pixel, residuals, strict=True)
            ]
        targets = [
            ColorTarget(view.observed.weights, view.indices, view.basis, residual, pixels)
            for view, residual, pixels in zip(self.views, residuals, by_pixel, strict=True)
        ]
        return replace(solution, trust=trust), targets


def _affines(views: Sequence[ProblemView], count: int) -> tuple[ViewAffine, ...]:
    counted = [view.observed.counted.astype(np.float32)[..., None] for view in views]
    colors = [
        view.observed.weights.accumulate(own * view.observed.target.image)
        for view, own in zip(views, counted, strict=True)
    ]
    evidence = [
        np.ascontiguousarray(view.observed.weights.accumulate(np.repeat(own, 3, axis=2))[:, 0])
        for view, own in zip(views, counted, strict=True)
    ]
    return tuple(view_affines(colors, evidence, [view.indices for view in views], count))


# Color prior

SURFACES = ("sky", "ground", "other")  # kinds of surface, each with its own map
_FEWEST_PIXELS = 200.0
_STEP_PX = 3  # subsampling step; every third pixel in each direction suffices for maps of twelve numbers


Pixels = Sequence[Float32[np.ndarray, "_ 3"]]


@dataclass(frozen=True, slots=True, eq=False)
class ColorPrior:
    """Affine map of display color for each kind of surface: new = matrix @ old + offset."""

    matrices: Float64[np.ndarray, "3 3 3"]
    offsets: Float64[np.ndarray, "3 3"]

    def of_sh(self, sh: Harmonics, shares: Float32[np.ndarray, "n 3"]) -> Harmonics:
        """Map harmonics; `shares` (sky, ground, other; sum 1) classifies each Gaussian."""
        changed = np.zeros_like(sh)
        for surface in range(len(SURFACES)):
            matrix, offset = self.matrices[surface].astype(np.float32), self.offsets[surface]
            moved = sh @ matrix.T
            # Color is 0.5 + C0 sh[0] + ...: the 0.5 is mapped as well.
            moved[:, 0] += ((matrix.sum(axis=1) * 0.5 + offset - 0.5) / SH_C0).astype(np.float32)
            changed += shares[:, surface, None, None] * moved
        return changed

    def of_colors(
        self, colors: Float32[np.ndarray, "p 3"], shares: Float32[np.ndarray, "p 3"]
    ) -> Float32[np.ndarray, "p 3"]:
        """Map display colors; `shares` (sky, ground, other) need not add up to 1."""
        changed = np.zeros_like(colors)
        total = np.maximum(shares.sum(axis=1), np.float32(1e-6))
        for surface in range(len(SURFACES)):
            moved = colors @ self.matrices[surface].T.astype(np.float32) + self.offsets[surface].astype(np.float32)
            changed += (shares[:, surface] / total)[:, None] * moved
        return changed


def fit_color_prior(clear: Pixels, changed: Pixels, shares: Pixels) -> ColorPrior:
    """Fit the maps to pixels (display colors) by least squares; a surface with too few gets the map of all pixels."""
    x = np.concatenate([np.concatenate(list(clear)), np.ones((sum(map(len, clear)), 1), np.float32)], axis=1)
    y = np.concatenate(list(changed))
    weights = np.concatenate(list(shares))
    everything = _fit(x, y, weights.sum(axis=1))
    maps = [
        _fit(x, y, weights[:, surface]) if weights[:, surface].sum() >= _FEWEST_PIXELS else everything
        for surface in range(len(SURFACES))
    ]
    return ColorPrior(np.stack([each[:3].T for each in maps]), np.stack([each[3] for each in maps]))


def color_prior_of(views: Sequence[ViewObservation], *, robust: bool) -> ColorPrior:
    """Fit the color maps to all views, then refit with less weight on views with large errors."""
    some = [slice(None, None, _STEP_PX)] * 2
    clear = [view.clear[*some].reshape(-1, 3) for view in views]
    changed = [view.target.image[*some].reshape(-1, 3) for view in views]
    shares = [(view.surfaces * view.counted[..., None])[*some].reshape(-1, 3) for view in views]
    change = fit_color_prior(clear, changed, shares)
    if not robust or len(views) < 3:
        return change
    errors = [(change.of_colors(x, w) - y)[None] for x, y, w in zip(clear, changed, shares, strict=True)]
    trust = irls_view_weights(
        [error_scale(error, (w.sum(axis=1) > 0)[None]) for error, w in zip(errors, shares, strict=True)]
    )
    return fit_color_prior(clear, changed, [np.float32(t) * w for t, w in zip(trust, shares, strict=True)])


def _fit(
    x: Float32[np.ndarray, "p 4"], y: Float32[np.ndarray, "p 3"], weights: Float[np.ndarray, " p"]
) -> Float64[np.ndarray, "4 3"]:
    """Weighted ridge regression toward 0.7 times the identity, for stable maps of uniformly colored surfaces."""
    weighted = x.astype(np.float64) * weights[:, None]
    total = max(float(weights.sum()), 1e-9)
    tame = np.vstack([0.7 * np.eye(3), np.zeros(3)])
    ridge = 1e-3 * total * np.diag([1, 1, 1, 1e-3]) + 1e-12 * np.eye(4)
    return np.linalg.solve(weighted.T @ x + ridge, weighted.T @ y + ridge @ tame)


# Choice of the prior weight

STRENGTHS = (300.0, 30.0, 3.0, 0.3)
"""Prior weights to try, in evidence of a Gaussian (squared weights, summed over pixels and views)."""

_SPARED = 4  # every Nth view is left out for validation
_MAX_VIEWS = 16
_ITERATIONS = 4


def choose_prior_weight(problem: ColorProblem, settings: RecolorSettings) -> Generator[SolverStep, None, float]:
    """Try prior weights, the strongest first, while the error of validation views decreases.

    A scene with accurate geometry needs little prior. Inaccurate geometry would bake its errors into colors that fit
    only the given views. With fewer than `_SPARED` views no validation is possible and a medium weight is returned.
    Yields the solver's steps.
    """
    views = problem.views[:: -(-len(problem.views) // _MAX_VIEWS)]
    spared = views[_SPARED // 2 :: _SPARED]
    fitted = tuple(view for i, view in enumerate(views) if i % _SPARED != _SPARED // 2)
    if len(views) < _SPARED:
        return STRENGTHS[1]
    trial = replace(problem, views=fitted, held_out=spared)
    best, lowest = STRENGTHS[0], np.inf
    targets, nothing = trial.first_targets(settings), np.zeros_like(problem.prior)
    for strength in STRENGTHS:
        weights = trial.prior_weights(msgspec.structs.replace(settings, tikhonov=strength))
        change = nothing
        for step in solve_colors(targets, len(problem.rows), _ITERATIONS, weights, nothing):
            change = step.change
            yield step
        errors: list[float] = []
        for view in spared:
            difference = view.rendered(problem.prior + change)[view.observed.counted]
            difference = difference - view.observed.target.image[view.observed.counted]
            errors.append(float(np.mean(difference**2)) if len(difference) else 0.0)
        if float(np.median(errors)) > lowest:
            break
        best, lowest = strength, float(np.median(errors))
    return best


# Robust weights (IRLS)

VIEW_LIMIT = 2.0  # a view counts fully up to this multiple of the median view's typical error
PIXEL_LIMIT = 6.0  # number of standard deviations beyond which the error of a pixel is no longer squared
MIN_SPREAD = 1 / 255  # smallest standard deviation: 8-bit quantization is no disagreement
_QUANTILE, _NORMAL = 0.9, 1.645
"""Quantile of the absolute error that estimates the spread, and its value in standard deviations of a normal
distribution. A high quantile is used because half the pixels of a road or wall are fitted immediately."""

_SPACING_PX = 3  # subsampling step; every third pixel in each direction suffices for a quantile


def error_scale(residual: Picture, counted: Bool[np.ndarray, "h w"]) -> float:
    """Typical error of an image: standard deviation estimated from a quantile; 0 without valid pixels."""
    some = residual[::_SPACING_PX, ::_SPACING_PX][counted[::_SPACING_PX, ::_SPACING_PX]]
    return float(np.quantile(np.abs(some), _QUANTILE)) / _NORMAL if some.size else 0.0


def irls_view_weights(spreads: Sequence[float]) -> Float64[np.ndarray, " v"]:
    """Trust in each view by its spread: 1 up to the limit, then falling to almost none (as Geman and McClure 1985)."""
    scaled = np.maximum(np.asarray(spreads, np.float64), MIN_SPREAD)
    limit = VIEW_LIMIT * np.median(scaled)
    return (limit / np.maximum(scaled, limit)) ** 4


def irls_pixel_weights(residual: Picture, typical: float) -> Float32[np.ndarray, "h w"]:
    """Trust in each pixel by its error (Huber 1964); `typical` is the deviation of a channel in a consistent view."""
    limit = np.float32(PIXEL_LIMIT * np.sqrt(3) * max(typical, MIN_SPREAD))
    length = np.sqrt(np.einsum("hwc,hwc->hw", residual, residual))
    return limit / np.maximum(length, limit)
