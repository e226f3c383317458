"""The colour of a part of the picture without rain, for drops to take: picked by hand where no sky is found."""

from dataclasses import dataclass

import numpy as np

from gsrain_engine.rain.rainfall import mean_sky
from gsrain_engine.render.frame import Color
from gsrain_engine.render.renderer import Renderer
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class SkyPick:
    """A rectangle of the picture, in shares of its width and height from the upper left corner."""

    left: float
    top: float
    right: float
    bottom: float

    @classmethod
    def between(cls, a: tuple[float, float], b: tuple[float, float]) -> "SkyPick":
        """Span two corners; what lies outside the picture is cut off."""
        (left, right), (top, bottom) = (sorted(np.clip(pair, 0.0, 1.0).tolist()) for pair in zip(a, b, strict=True))
        return cls(left, top, right, bottom)


def color_there(
    renderer: Renderer, scene: Scene, shot: Shot, pick: SkyPick, background: Color, wetness: float = 0.0
) -> Color:
    """Draw a scene without rain and average a rectangle of it in linear light; at least one pixel."""
    renderer.draw(scene.parts(shot.time_s, wetness=wetness), shot.camera)
    rgba = renderer.read().rgba
    height, width = rgba.shape[:2]
    x0, x1 = _pixels(pick.left, pick.right, width)
    y0, y1 = _pixels(pick.top, pick.bottom, height)
    seen = rgba[y0:y1, x0:x1].reshape(-1, 4).astype(np.float64)
    return mean_sky(np.clip(seen[:, :3] + (1 - seen[:, 3:]) * np.array(background), 0, 1))


def _pixels(low: float, high: float, count: int) -> tuple[int, int]:
    first = min(int(low * count), count - 1)
    return first, max(first + 1, min(round(high * count), count))
