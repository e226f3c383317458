"""Boxes around the centres of Gaussians: all of them, nearly all, or the core where they are dense."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64

from .gaussians import Gaussians
from .members import Part

_ROBUST_SHARE = 0.98
"""Share of the opacity along an axis that the robust box keeps; captures have strays far outside."""


_SAMPLES = 1_000_000
"""Gaussians that the robust box looks at, evenly spaced in order: sorting all of 10 million takes seconds."""


_CORE_SAMPLES = 100_000
"""Gaussians that the core is found by, evenly spaced in order: a tenth of a second for any number of them."""

_CORE_SHARE = 0.25
"""Least share of the opacity that the core holds."""

_GROWTH = 0.15
"""The core's radius R makes share / R^0.15 largest: twice as far out is worth it for 11 % more."""

_SHELL_BEGINS = 3.0
"""Radii of the core, from its middle, beyond which Gaussians may belong to a shell."""

_SHELL_COVERS = 0.2
"""Least share of all directions that a shell covers; a dome covers half of them, strays next to nothing."""

_RINGS, _SECTORS = 4, 8
"""Of directions: cells of the same solid angle."""


class Bounds(NamedTuple):
    """An axis-aligned box."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]


class Shell(NamedTuple):
    """A sky, or what else surrounds a scene from far away, as seen from the middle of the core."""

    middle: Float64[np.ndarray, "3"]
    nearest_m: float
    """What is nearer to the middle does not belong to it."""
    radius_m: float
    """Distance from the middle by which half of what it covers is passed."""
    smallest: float
    """Size over distance: Gaussians that look smaller from the middle are strays, and don't belong to it either."""

    def holds(self, part: Part) -> Bool[np.ndarray, " n"]:
        """Tell which of a part's Gaussians belong to it, those that are left out too."""
        means = part.gaussians.means @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        distances = np.linalg.norm(means - self.middle, axis=1)
        scale = np.cbrt(np.linalg.det(part.to_world[:3, :3]))
        sizes = scale * part.gaussians.scales.max(axis=1, initial=0)
        return (distances > self.nearest_m) & (sizes > self.smallest * distances)


class Core(NamedTuple):
    """The place of a scene where its Gaussians are dense. World frame, metres."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    shell: Shell | None = None
    """What surrounds it from far away, where anything does."""

    @property
    def middle(self) -> Float64[np.ndarray, "3"]:
        return (self.low + self.high) / 2

    @property
    def radius_m(self) -> float:
        """Radius of the sphere around the box."""
        return float(np.linalg.norm(self.high - self.low)) / 2

    @property
    def farthest_m(self) -> float:
        """Largest distance from the middle to look from: inside of the shell, else where it is still to be seen."""
        if self.shell is None:
            return 50 * self.radius_m
        return max(0.8 * self.shell.radius_m, 1.2 * self.radius_m)


def core_bounds(parts: Sequence[Part], sky: Sequence[Part] = ()) -> Core:
    """Find the dense core of parts, and the shell far around it; `sky` are parts known to be of that shell.

    Its middle is the middle of the denser half of the Gaussians, halved six times over (the half-sample mode of
    Robertson and Cryer 1974, with medians); around it, the core ends where going farther adds little, see `_GROWTH`.
    Opacities are weights. The box keeps 98 % of what is in there along each axis, and is never smaller than a typical
    Gaussian. What lies beyond three radii is a shell where it covers a fifth of all directions. Values that are not
    finite don't count; without Gaussians the core is a point at the origin.
    """
    samples = _samples(parts)
    means, sizes, weights = samples
    if not len(means):
        return Core(np.zeros(3), np.zeros(3))
    size = 2 * float(_weighted_quantiles(sizes, weights, [0.5])[0])
    middle, near = np.zeros(3), np.ones(len(means), np.bool_)
    for _ in range(6):
        middle = np.array([_weighted_quantiles(column, weights[near], [0.5])[0] for column in means[near].T])
        distances = np.linalg.norm(means - middle, axis=1)
        near &= distances <= np.median(distances[near])
    distances = np.linalg.norm(means - middle, axis=1)
    order = np.argsort(distances)
    shares = np.cumsum(weights[order]) / weights.sum()
    worth = shares / np.maximum(distances[order], max(size, 1e-9)) ** _GROWTH
    radius = float(distances[order][np.argmax(np.where(shares >= _CORE_SHARE, worth, 0.0))])
    inside = distances <= radius
    ends = [(1 - _ROBUST_SHARE) / 2, (1 + _ROBUST_SHARE) / 2]
    low, high = np.array([_weighted_quantiles(column, weights[inside], ends) for column in means[inside].T]).T
    half = np.maximum((high - low) / 2, size)
    core = Core((low + high) / 2 - half, (low + high) / 2 + half)
    return core._replace(shell=_shell(core, samples, _samples(sky)))


class _Samples(NamedTuple):
    means: Float64[np.ndarray, "n 3"]
    sizes: Float64[np.ndarray, " n"]
    """Longest standard deviations."""
    weights: Float64[np.ndarray, " n"]


def _samples(parts: Sequence[Part]) -> _Samples:
    step = -(-sum(len(part.gaussians) for part in parts) // _CORE_SAMPLES) or 1
    places, sizes, weights = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0)]
    for part in parts:
        there = np.arange(0, len(part.gaussians), step)
        if part.left_out:
            there = there[~part.left_out.flags[there]]
        g, scale = part.gaussians, float(np.cbrt(np.linalg.det(part.to_world[:3, :3])))
        means = g.means[there].astype(np.float64) @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        longest = scale * g.scales[there].max(axis=1, initial=0.0).astype(np.float64)
        opacities = part.opacity * g.opacities[there].astype(np.float64)
        good = np.isfinite(means).all(axis=1) & np.isfinite(longest) & np.isfinite(opacities)
        places.append(means[good])
        sizes.append(longest[good])
        weights.append(opacities[good])
    weight = np.concatenate(weights)
    return _Samples(np.concatenate(places), np.concatenate(sizes), weight if weight.sum() > 0 else weight + 1)


def _shell(core: Core, samples: _Samples, sky: _Samples) -> Shell | None:
    """Recognize what surrounds the core from far away, by how much of all directions it covers."""
    nearest_m = _SHELL_BEGINS * max(core.radius_m, 1e-9)
    means, sizes, weights = (np.concatenate(pair) for pair in zip(samples, sky, strict=True))
    is_sky = np.arange(len(means)) >= len(samples[0])
    away = means - core.middle
    distances = np.linalg.norm(away, axis=1)
    far = (distances > nearest_m) | (is_sky & (distances > 0))
    if not far.any():
        return None
    away, distances = away[far], distances[far]
    covered = 2 * np.pi * weights[far] * (sizes[far] / distances) ** 2  # steradians
    ring = np.clip((away[:, 2] / distances + 1) * _RINGS / 2, 0, _RINGS - 1).astype(int)
    sector = np.clip((np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS, 0, _SECTORS - 1).astype(int)
    cells = _RINGS * _SECTORS
    full = 4 * np.pi / cells
    share = np.minimum(np.bincount(ring * _SECTORS + sector, covered, cells) / full, 1.0).mean()
    if share < _SHELL_COVERS and not is_sky.any():
        return None
    weights = covered if covered.sum() > 0 else np.ones(len(covered))
    radius_m = float(_weighted_quantiles(distances, weights, [0.5])[0])
    size = float(_weighted_quantiles(sizes[far] / distances, weights, [0.5])[0])
    return Shell(core.middle, nearest_m, radius_m, size / 10)


def bounds(gaussians: Gaussians) -> Bounds:
    """Box around all centres; without Gaussians a point at the origin."""
    if not len(gaussians):
        return Bounds(np.zeros(3), np.zeros(3))
    columns = gaussians.means.T
    return Bounds(
        np.array([column.min() for column in columns], np.float64),
        np.array([column.max() for column in columns], np.float64),
    )


def robust_bounds(*sets: Gaussians, share: float = _ROBUST_SHARE) -> Bounds:
    """Box that keeps the middle `share` (0..1) of all opacity along each axis; without Gaussians the origin.

    Where everything is fully transparent, every centre counts the same. Of more than a million, an even share counts.
    """
    step = -(-sum(map(len, sets)) // _SAMPLES) or 1
    means = np.concatenate([np.zeros((0, 3), np.float32), *(each.means[::step] for each in sets)])
    weights = np.concatenate([np.zeros(0), *(each.opacities[::step].astype(np.float64) for each in sets)])
    if not weights.sum() > 0:
        weights = np.ones(len(weights))
    ends = [(1 - share) / 2, (1 + share) / 2]
    columns = [_weighted_quantiles(column, weights, ends) for column in means.T] if len(means) else []
    low, high = np.array(columns, np.float64).T if columns else np.zeros((2, 3))
    return Bounds(low, high)


def _weighted_quantiles(
    values: Float[np.ndarray, " n"], weights: Float64[np.ndarray, " n"], shares: list[float]
) -> Float64[np.ndarray, " s"]:
    """Smallest values that have at least these shares of the weight at or below them."""
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    index = np.searchsorted(summed, np.array(shares) * summed[-1])
    return values[order[np.minimum(index, len(values) - 1)]].astype(np.float64)
