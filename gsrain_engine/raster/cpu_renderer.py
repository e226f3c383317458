"""Draws scene and rain on the CPU, behind the same interface as the OpenGL renderer."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from gsrain_engine.rain.rain_gaussians import RainGaussians
from gsrain_engine.render.frame import Frame
from gsrain_engine.render.statistics import RenderStatistics, Stopwatch
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Part

from .compositing import composite, composite_in_rain
from .projection import Splats, project_unsorted
from .rain_light import add_rain_light
from .tiles import TileLists, bin_into_tiles

_LEAST_WEIGHT = np.float32(0.5)
"""Pixels that the scene covers less than this have no depth, as in the OpenGL renderer."""


class CpuRenderer:
    """Renders scene and rain into one picture. Needs no OpenGL; the same bytes at any number of threads."""

    name = "cpu"

    name = "cpu"

    def __init__(self) -> None:
        self.statistics = RenderStatistics()
        self._frame: Frame | None = None

    def draw(
        self,
        parts: Sequence[Part],
        camera: Camera,
        rain: RainGaussians | None = None,
        *,
        with_depth: bool = False,
    ) -> None:
        """Draw parts and rain as one depth-ordered compositing; `read` hands out the picture.

        `camera` is in the world (metres). Depth is the scene's own: rain takes no part in it.
        """
        self.statistics = RenderStatistics(stages_ms={"project": 0.0, "sort": 0.0, "draw": 0.0})
        drops = rain.gaussians if rain is not None and len(rain.gaussians) else None
        scene_count = sum(len(part.gaussians) for part in parts)
        everything, is_drop = list(parts), [None] * len(parts)
        if drops is not None:
            everything, is_drop = [*parts, Part(drops, np.eye(4))], [*is_drop, np.ones(len(drops), bool)]
        self.statistics.gaussians = sum(len(part.gaussians) for part in everything)

        with self._timed("project"):
            unsorted = project_unsorted(everything, camera, is_drop)
        with self._timed("sort"):
            splats = unsorted.nearest_first()
            tiles = bin_into_tiles(splats.shapes, camera.width, camera.height)
        with self._timed("draw"):
            if rain is None or drops is None:
                self._frame = _clear(splats, tiles, with_depth=with_depth)
            elif rain.mixing == "linear":
                self._frame = _in_linear_light(splats, tiles, scene_count, rain, with_depth=with_depth)
            else:
                self._frame = _as_display_color(splats, tiles, scene_count, with_depth=with_depth)
        self.statistics.splats_drawn = len(splats)

    def read(self) -> Frame:
        """Hand out the last picture, with depth if it was drawn."""
        assert self._frame is not None, "draw before reading the picture"
        return self._frame

    def _timed(self, stage: str) -> Stopwatch:
        return Stopwatch(self.statistics.stages_ms, stage)


def _clear(splats: Splats, tiles: TileLists, *, with_depth: bool) -> Frame:
    rgba, weighted = composite(splats.shapes, splats.colors, tiles)
    return Frame(rgba, _expected_depth(weighted, rgba[..., 3]) if with_depth else None)


def _in_linear_light(
    splats: Splats, tiles: TileLists, scene_count: int, rain: RainGaussians, *, with_depth: bool
) -> Frame:
    scene = composite_in_rain(splats.shapes, splats.colors, splats.indices >= scene_count, tiles)
    depth = _expected_depth(scene.fourth, scene.rgba[..., 3]) if with_depth else None
    return Frame(add_rain_light(scene, rain.light_linear), depth)


def _as_display_color(splats: Splats, tiles: TileLists, scene_count: int, *, with_depth: bool) -> Frame:
    """Rain is one more colour (the paper's form); a second walk without it tells the depth."""
    rgba, _ = composite(splats.shapes, splats.colors, tiles)
    if not with_depth:
        return Frame(rgba)
    scene = splats.indices < scene_count
    shapes = splats.shapes[scene]
    clear, weighted = composite(shapes, splats.colors[scene], bin_into_tiles(shapes, tiles.width, tiles.height))
    return Frame(rgba, _expected_depth(weighted, clear[..., 3]))


def _expected_depth(
    weighted: Float32[np.ndarray, "h w"], weight: Float32[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w"]:
    return np.where(weight > _LEAST_WEIGHT, weighted / np.maximum(weight, _LEAST_WEIGHT), np.float32(0))
