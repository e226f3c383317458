"""The rain of one moment as Gaussians: what the rain hands to a renderer."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.gaussians import Gaussians


@dataclass(frozen=True, slots=True, eq=False)
class RainGaussians:
    """Streak and haze Gaussians in the world (metres, z up), to be sorted and composited among the scene's own.

    Renderers draw them with the dilation's compensation and down to an alpha of 1/65536.
    """

    gaussians: Gaussians
    light_linear: Float32[np.ndarray, "3"]
    """A drop's colour in linear light."""
    mixing: Literal["linear", "display"]
    """Whether the drop's light adds to the scene's in linear light, or as display colour (the paper's form)."""
    drops_drawn: int
    """Drops that became streaks; each is one to four Gaussians."""
    haze_drawn: int
    """Haze Gaussians among them."""
