"""The rain of one moment before one camera: what a renderer makes its drops from."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float32, Float64

from gsrain_engine.scene.gaussians import Gaussians, sh_from_color

from .haze import Haze
from .streak_field import StreakField


@dataclass(frozen=True, eq=False)
class FallingRain:
    """Drops and haze in the world (metres, z up), to be sorted and composited among the scene's own Gaussians.

    Renderers draw them with the dilation's compensation and down to an alpha of 1/65536. A GPU makes the streaks itself
    from `streak_field`; whoever can't takes `gaussians`.
    """

    streak_field: StreakField | None
    haze: Haze | None
    haze_sigma_m: float
    color: Float64[np.ndarray, "3"]
    """A drop's display colour."""
    light_linear: Float32[np.ndarray, "3"]
    """The same in linear light."""
    mixing: Literal["linear", "display"]
    """Whether the drop's light adds to the scene's in linear light, or as display colour (the paper's form)."""

    @cached_property
    def gaussians(self) -> Gaussians:
        """Streak and haze Gaussians that the camera may see."""
        return Gaussians.concatenate([self._streaks[1], self.haze_gaussians])

    @cached_property
    def haze_gaussians(self) -> Gaussians:
        if self.haze is None:
            return Gaussians.empty()
        n = len(self.haze.means)
        upright = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
        scales = np.full((n, 3), self.haze_sigma_m, np.float32)
        return Gaussians(self.haze.means, scales, upright, self.haze.opacities, self._sh(n))

    @property
    def drops_drawn(self) -> int:
        """Drops that become streaks; each is one to `Rain.max_copies` Gaussians."""
        return self._streaks[0]

    @property
    def haze_drawn(self) -> int:
        return len(self.haze.means) if self.haze is not None else 0

    @cached_property
    def _streaks(self) -> tuple[int, Gaussians]:
        if self.streak_field is None:
            return 0, Gaussians.empty()
        drops = self.streak_field.drops()
        made = self.streak_field.streaks(drops)
        n = len(made.means)
        return len(drops.numbers), Gaussians(made.means, made.scales, made.quaternions, made.opacities, self._sh(n))

    def _sh(self, count: int) -> Float32[np.ndarray, "n 1 3"]:
        return np.broadcast_to(sh_from_color(self.color.astype(np.float32)[None]), (count, 1, 3)).copy()
