"""One view as a linear operator on the Gaussians' colours: image = W colours, never storing W."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Part

from .accumulation import accumulate
from .compositing import composite
from .projection import project
from .splats import Splats
from .tiles import TileLists, bin_into_tiles

_LEAST_ALPHA = np.float32(1e-3)
"""Where alpha is below this nothing is there."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewWeights:
    """Splats of one view and their tiles: all that is needed to blend any colours, and to go back.

    Colours here are linear: the max(0, .) that a renderer puts on a splat's colour is not part of W.
    """

    splats: Splats
    tiles: TileLists

    def blend(self, channels: Float32[np.ndarray, "m c"]) -> Float32[np.ndarray, "h w c"]:
        """W times up to four channels of the splats: the premultiplied image."""
        c = channels.shape[1]
        padded = np.zeros((len(channels), 4), np.float32)
        padded[:, :c] = channels
        rgba, fourth = composite(self.splats.shapes, padded, self.tiles)
        return np.ascontiguousarray(rgba[..., :c]) if c < 4 else np.dstack([rgba[..., :3], fourth])

    def accumulate(self, image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "m 3"]:
        """W transposed times an image: what each splat gathers from it."""
        return accumulate(self.splats.shapes, image, self.tiles)[:, :3]

    def squared_sums(self) -> Float32[np.ndarray, " m"]:
        """Sum of each splat's squared weights: the diagonal of W transposed times W."""
        nothing = np.zeros((self.tiles.height, self.tiles.width, 3), np.float32)
        return accumulate(self.splats.shapes, nothing, self.tiles)[:, 3]


def view_weights(parts: Sequence[Part], camera: Camera) -> ViewWeights:
    """Project, sort and bin the parts for one camera (in the world, metres)."""
    splats = project(parts, camera)
    return ViewWeights(splats, bin_into_tiles(splats.shapes, splats.nearest_first(), camera.width, camera.height))


def expected(weighted: Float32[np.ndarray, "h w"], weight: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Mean of a blended channel over what was blended; 0 where there is nothing."""
    return np.where(weight > _LEAST_ALPHA, weighted / np.maximum(weight, _LEAST_ALPHA), np.float32(0))
