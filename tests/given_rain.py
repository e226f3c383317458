"""Rain frames of chosen Gaussians or drops, for tests of renderers and of the drop field."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gsrain_engine.rain.drop_field import DropCulling, DropPhases, Drops, place_drops
from gsrain_engine.rain.frame import RainCamera, RainFrame
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.geometry import linear_to_srgb

STILL: dict[str, float] = {"wind_speed_m_s": 0.0, "gust_m_s": 0.0, "turbulence_m_s": 0.0}
"""Settings of calm air."""

HERE = RainCamera(Camera.from_fov(64, 48, 60.0, np.eye(4)), np.eye(4), np.zeros(3))
"""A camera at the origin, which looks up along z."""


@dataclass(frozen=True, eq=False)
class GivenRain(RainFrame):
    """A `RainFrame` whose Gaussians are given, not made from drops."""

    given: Gaussians = Gaussians.empty()  # noqa: RUF009

    @property
    def haze(self) -> Gaussians:
        return self.given


def given_rain(gaussians: Gaussians, light=(0.5, 0.5, 0.5), model: Literal["physical", "paper"] = "physical"):
    rain = RainSettings(
        intensity_mm_h=1.0, streaks=False, haze="gaussians", model=model,
        drop_color=tuple(linear_to_srgb(np.array(light, np.float32).astype(np.float64)).tolist()),
    )  # fmt: skip
    frame = RainSimulation.start(rain).frame(0.0, HERE)
    return GivenRain(**{name: getattr(frame, name) for name in frame.__dataclass_fields__}, given=gaussians)


def gaussians_of(rain: RainFrame) -> Gaussians:
    """Streaks and haze of a frame, as the renderers without a GPU draw them."""
    return rain.gaussians


def all_drops(rain: RainFrame) -> Drops:
    """Every drop of the cell, by the readable reference."""
    return place_drops(np.arange(rain.count), rain.rain.seed, rain.where)


def found_drops(
    count: int, seed: int, where: DropPhases, period_m: np.ndarray, culling: DropCulling, *, in_view: bool = True
):
    """Numbers of the drops of a chosen cell that the kernel finds."""
    frame = RainSimulation.start(RainSettings(intensity_mm_h=1.0, seed=seed)).frame(0.0, HERE)
    chosen = replace(frame, count=count, find_drops=lambda: (where, culling), period_m=period_m)
    return chosen.visible_drops(in_view=in_view).numbers
