"""The pictures that detectors are shown of one view: as it was taken, clear, and in rains of many seeds."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import UInt8
from msgspec import structs

from gsrain_engine.rain.rain import Rain
from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.scene_view import draw_shot, rain_in
from gsrain_engine.render.sky_color import Sky
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.srgb import linear_to_srgb, srgb_to_linear

from .frames import JudgedFrame

Kind = Literal["original", "clear", "rainy"]
"""As a camera took it; the scene without rain; in rain."""


class Trial(NamedTuple):
    """What a view is shown in."""

    kind: Kind
    intensity_mm_h: float
    seeds: tuple[int, ...]
    """For which it stands: one of a rain, all of a picture without rain."""


def trials_of(
    intensities_mm_h: tuple[float, ...], seeds: tuple[int, ...], *, originals: bool, scene: bool
) -> list[Trial]:
    """All that a view is shown in: without rain first, then each rain with each seed, the same seeds in each."""
    clear = [Trial("original", 0.0, seeds)] if originals else []
    clear += [Trial("clear", 0.0, seeds)] if scene else []
    rainy = [Trial("rainy", rate, (seed,)) for rate in intensities_mm_h if rate > 0 for seed in seeds]
    return clear + rainy


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Makes the pictures of views. A rain's seed decides its drops: intensities of one seed differ as little as can be.

    Without a scene rain falls in front of the pictures that were taken, as if all that they show were far behind it.
    """

    renderer: Renderer
    scene: Scene
    rain: Rain
    """All but its intensity and its seed."""
    sky: Sky
    is_in_front: bool = False
    """Whether rain falls in front of taken pictures."""
    _rains: dict[tuple[float, int], Rainfall] = field(default_factory=dict[tuple[float, int], Rainfall])

    def take(self, frame: JudgedFrame, trial: Trial) -> UInt8[np.ndarray, "h w 3"]:
        """Make one picture; the same every time. Wet colours come with the rain where the scene has them."""
        if trial.kind == "original":
            assert frame.original is not None
            return frame.original()
        if trial.kind == "clear":
            return self._drawn(frame, None)
        rainfall = self._rainfall(trial.intensity_mm_h, trial.seeds[0])
        return self._in_front(frame, rainfall) if self.is_in_front else self._drawn(frame, rainfall)

    def _rainfall(self, intensity_mm_h: float, seed: int) -> Rainfall:
        key = intensity_mm_h, seed
        if key not in self._rains:
            rain = structs.replace(self.rain, intensity_mm_h=intensity_mm_h, seed=seed)
            self._rains[key] = Rainfall.start(rain)
        return self._rains[key]

    def _drawn(self, frame: JudgedFrame, rainfall: Rainfall | None) -> UInt8[np.ndarray, "h w 3"]:
        wetness = 0.0 if rainfall is None else rainfall.wetness_at(frame.shot.time_s)
        draw_shot(self.renderer, self.scene, rainfall, self.sky.at(wetness), frame.shot)
        return self.renderer.read().to_uint8()

    def _in_front(self, frame: JudgedFrame, rainfall: Rainfall) -> UInt8[np.ndarray, "h w 3"]:
        """Mix rain over the taken picture B, with W its share of a pixel and S its light: enc((1 - W) dec(B) + W S)."""
        assert frame.original is not None
        falling = rain_in(self.scene, rainfall, self.sky.color, frame.shot)
        self.renderer.draw([], frame.shot.camera, falling)
        share = self.renderer.read().rgba[..., 3:]
        is_linear = rainfall.rain.rain_light == "linear"
        encode, decode = (linear_to_srgb, srgb_to_linear) if is_linear else (np.asarray, np.asarray)
        light = decode(np.array(rainfall.rain.drop_color or self.sky.color))
        mixed = encode((1 - share) * decode(frame.original().astype(np.float64) / 255) + share * light)
        return np.rint(np.clip(mixed, 0, 1) * 255).astype(np.uint8)
