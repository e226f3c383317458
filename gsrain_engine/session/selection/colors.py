"""Base colours of Gaussians, and those that are alike."""

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.gaussians import SH_C0
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Part
from gsrain_engine.scene.scene import Scene

from .candidates import candidates


def base_colors(part: Part) -> Float32[np.ndarray, "n 3"]:
    """Display colour of each Gaussian without what changes with direction, graded as it is drawn, within 0..1."""
    colors = part.gaussians.sh[:, 0].copy()
    colors *= np.float32(SH_C0)
    colors += np.float32(0.5)
    if part.colors is not None:
        matrix = part.colors.astype(np.float32)
        colors = colors @ matrix[:, :3].T + matrix[:, 3]
    return np.clip(colors, 0, 1, out=colors)


def base_color(part: Part, index: int) -> Float32[np.ndarray, "3"]:
    """Display colour of one Gaussian, see `base_colors`."""
    return base_colors(part._replace(gaussians=part.gaussians.take(np.array([index]))))[0]


def alike(scene: Scene, time_s: float, color: Float32[np.ndarray, "3"], tolerance: float) -> dict[str, Mask]:
    """Find Gaussians whose base colour differs by no more than `tolerance` (0..1) in red, green and blue each."""
    found: dict[str, Mask] = {}
    for each in candidates(scene, time_s):
        difference = base_colors(each.part)
        difference -= color
        near = np.abs(difference, out=difference) <= tolerance
        found[each.key] = Mask.of(near[:, 0] & near[:, 1] & near[:, 2])
    return found
