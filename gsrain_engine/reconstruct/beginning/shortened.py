"""Cuts Gaussians that are long for how near cameras come to them."""

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.rotations import matrices_from_quaternions

from .surfels import SPREAD

LONGEST = 0.1
"""Standard deviation over the distance to the nearest camera. Renderers project as if perspective were linear around a
Gaussian's middle (Zwicker et al. 2001, section 6.2): a piece of road that reaches past a camera would smear the sky."""


def shortened(gaussians: Gaussians, way: Float64[np.ndarray, "p 3"], most: int) -> Gaussians:
    """Replace each that is too long by a row of shorter ones along its longest axis, which cover its step.

    Args:
        gaussians: In the capture's world.
        way: Where cameras are and may be.
        most: So many there may be afterwards; where that is too few, the others stay in one, short piece.
    """
    longest = gaussians.scales.argmax(axis=1)
    rows = np.arange(len(gaussians))
    sigma = gaussians.scales[rows, longest]
    limit = np.maximum(LONGEST * KDTree(way).query(gaussians.means)[0], 1e-6)
    pieces = np.maximum(np.ceil(sigma / limit), 1).astype(np.int64)
    order = np.argsort(pieces, kind="stable")
    fits = np.cumsum(pieces[order] - 1) <= most - len(gaussians)
    pieces[order[~fits]] = 1
    source = np.repeat(rows, pieces)
    first = np.cumsum(pieces) - pieces
    number = np.arange(len(source)) - first[source]
    short = np.minimum(sigma / pieces, limit)
    axes = matrices_from_quaternions(gaussians.quaternions.astype(np.float64))[rows, :, longest]
    along = (number - (pieces[source] - 1) / 2) * short[source] / SPREAD
    scales = gaussians.scales[source].copy()
    scales[np.arange(len(source)), longest[source]] = short[source]
    cut = gaussians.take(source)
    means = gaussians.means[source] + along[:, None] * axes[source]
    return Gaussians(means.astype(np.float32), scales, cut.quaternions, cut.opacities, cut.sh)
