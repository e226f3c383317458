"""Rain of chosen Gaussians, for tests of renderers."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gsrain_engine.rain.simulation import RainFrame
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import linear_to_srgb


@dataclass(frozen=True, eq=False)
class GivenRain(RainFrame):
    """A `RainFrame` whose Gaussians are given, not made from drops."""

    given: Gaussians = Gaussians.empty()  # noqa: RUF009

    @property
    def gaussians(self) -> Gaussians:
        return self.given

    haze_gaussians = gaussians

    @property
    def drops_drawn(self) -> int:
        return len(self.given)


def given_rain(gaussians: Gaussians, light=(0.5, 0.5, 0.5), mixing: Literal["linear", "display"] = "linear"):
    light = np.array(light, np.float32)
    return GivenRain(None, None, 0.0, linear_to_srgb(light.astype(np.float64)), light, mixing, gaussians)
