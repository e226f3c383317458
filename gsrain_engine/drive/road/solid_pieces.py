"""A scene's solid background in small pieces, each with the area that it shows from the side and from above."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.rotations import matrices_from_quaternions
from gsrain_engine.scene.scene import Scene

from .height_grid import HeightGrid

SOLID = 0.5
"""Opacity from which a Gaussian can be driven into or upon: haze and most floaters of a capture have less."""

_CHUNK = 1 << 15
_COUNTS = ((1, 0.0, 0.5), (16, 0.5, 1.5), (64, 1.5, 4.0), (256, 4.0, np.inf))
"""How many pieces a Gaussian falls into whose largest standard deviation is from so many cells to so many."""
_DRAWS = np.clip(np.random.default_rng(0).standard_normal((256, 3)), -2, 2)
"""Places in a Gaussian, in standard deviations; beyond two there is hardly anything to be seen."""


class SolidPieces(NamedTuple):
    """Pieces of Gaussians. World frame: metres, z up."""

    places: Float64[np.ndarray, "n 3"]
    side_m2: Float64[np.ndarray, " n"]
    """What each covers of a view from the side: from where it shows most."""
    top_m2: Float64[np.ndarray, " n"]
    """What each covers of a view from above."""


class Slab(NamedTuple):
    """What is between two heights above the ground."""

    ground: HeightGrid
    low_m: float
    high_m: float

    def above_m(self, places: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        return places[:, 2] - self.ground.at_all(places[:, :2])


class Reach(NamedTuple):
    """The part of the world that matters: a box, and in it, where there is one, a slab over the ground."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    slab: Slab | None = None


def solid_pieces(scene: Scene, reach: Reach, cell_m: float, names: frozenset[str] | None = None) -> SolidPieces:
    """Take apart what stands still and can be seen of a scene, sky aside, so that no piece is much larger than a cell.

    What is hidden or deleted does not count. `names` takes these layers only.
    """
    pieces = [SolidPieces(np.zeros((0, 3)), np.zeros(0), np.zeros(0))]
    for layer in scene.layers:
        if layer.kind == "sky" or not layer.visible or (names is not None and layer.name not in names):
            continue
        part = scene.part(layer)
        assert part is not None
        pieces += _pieces(part.remaining, part.opacity, part.to_world, reach, cell_m)
    places, side, top = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return SolidPieces(places, side, top)


def _pieces(
    gaussians: Gaussians, opacity: float, to_world: Float64[np.ndarray, "4 4"], reach: Reach, cell_m: float
) -> Iterator[SolidPieces]:
    centers = gaussians.means @ to_world[:3, :3].T + to_world[:3, 3]
    far = 2.0 * gaussians.scales.max(axis=1, initial=0.0)[:, None] * np.cbrt(np.linalg.det(to_world[:3, :3]))
    near = ((centers + far >= reach.low) & (centers - far <= reach.high)).all(axis=1)
    chosen = np.flatnonzero(near & (gaussians.opacities * opacity >= SOLID))
    for first in range(0, len(chosen), _CHUNK):
        rows = chosen[first : first + _CHUNK]
        part = gaussians.take(rows)
        turn = matrices_from_quaternions(part.quaternions.astype(np.float64))
        axes = to_world[:3, :3] @ (turn * part.scales[:, None, :])
        middles, opacities = centers[rows].astype(np.float64), part.opacities * opacity
        if reach.slab is not None:
            above, tall = reach.slab.above_m(middles), 2.0 * np.linalg.norm(axes[:, 2], axis=1)
            inside = (above + tall > reach.slab.low_m) & (above - tall < reach.slab.high_m)
            middles, axes, opacities = middles[inside], axes[inside], opacities[inside]
        yield from _strewn(middles, axes, opacities, reach, cell_m)


def _strewn(
    centers: Float64[np.ndarray, "n 3"],
    axes: Float64[np.ndarray, "n 3 3"],
    opacities: np.ndarray,
    reach: Reach,
    cell_m: float,
) -> Iterator[SolidPieces]:
    """Strew pieces over each Gaussian. A flat one's shadows along the axes are its area times its normal."""
    spread = axes @ axes.transpose(0, 2, 1)
    shadow = [
        2 * np.pi * opacities * np.sqrt(np.maximum(_minor(spread, *pair), 0)) for pair in ((1, 2), (0, 2), (0, 1))
    ]
    side, top = np.hypot(shadow[0], shadow[1]), shadow[2]
    longest = np.sqrt(np.einsum("nii->ni", spread).max(axis=1, initial=0.0))
    for count, least, most in _COUNTS:
        own = np.flatnonzero((longest >= least * cell_m) & (longest < most * cell_m))
        draws = _DRAWS[:count] - _DRAWS[:count].mean(axis=0)
        places = (centers[own, None] + np.einsum("kj,nij->nki", draws, axes[own])).reshape(-1, 3)
        inside = ((places >= reach.low) & (places <= reach.high)).all(axis=1)
        if reach.slab is not None:
            above = reach.slab.above_m(places)
            inside &= (above > reach.slab.low_m) & (above < reach.slab.high_m)
        sides, tops = (np.repeat(each[own] / count, count)[inside] for each in (side, top))
        yield SolidPieces(places[inside], sides, tops)


def _minor(spread: Float64[np.ndarray, "n 3 3"], i: int, j: int) -> Float64[np.ndarray, " n"]:
    return spread[:, i, i] * spread[:, j, j] - spread[:, i, j] ** 2
