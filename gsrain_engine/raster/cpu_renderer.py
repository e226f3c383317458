"""Draws scene and rain on the CPU, behind the same interface as the OpenGL renderer."""

from collections.abc import Sequence

import numpy as np

from gsrain_engine.rain.falling_rain import FallingRain
from gsrain_engine.render.frame import Frame
from gsrain_engine.render.look import Look
from gsrain_engine.render.statistics import RenderStatistics, Stopwatch
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Part

from .freed_memory import keep_freed_memory
from .look_colors import in_colors_of
from .pictures import draw_in_rain, draw_look
from .projection import project
from .splats import Splats
from .tiles import bin_into_tiles


class CpuRenderer:
    """Renders scene and rain into one picture. Needs no OpenGL; the same bytes at any number of threads."""

    name = "cpu"

    def __init__(self) -> None:
        keep_freed_memory()
        self.statistics = RenderStatistics()
        self._frame: Frame | None = None

    def draw(
        self,
        parts: Sequence[Part],
        camera: Camera,
        rain: FallingRain | None = None,
        *,
        with_depth: bool = False,
        look: Look = "splats",
    ) -> None:
        self.statistics = RenderStatistics(stages_ms={"project": 0.0, "sort": 0.0, "draw": 0.0})
        with self._timed("project"):
            falling = rain if look == "splats" and rain is not None and len(rain.gaussians) else None
            splats = self._project(parts, camera, falling, as_points=look == "points")
            splats = in_colors_of(look, splats, parts, camera)
        with self._timed("sort"):
            order = splats.nearest_first()
            tiles = bin_into_tiles(splats.shapes, order, camera.width, camera.height)
        with self._timed("draw"):
            if falling is None:
                self._frame = draw_look(look, splats, tiles, with_depth=with_depth)
            else:
                self._frame = draw_in_rain(splats, order, tiles, falling, with_depth=with_depth)
        self.statistics.splats_drawn = len(order)

    def read(self) -> Frame:
        assert self._frame is not None, "draw before reading the picture"
        return self._frame

    def _project(self, parts: Sequence[Part], camera: Camera, rain: FallingRain | None, *, as_points: bool) -> Splats:
        self.statistics.gaussians = sum(part.drawn_count for part in parts)
        if rain is None:
            return project(parts, camera, as_points=as_points)
        drops = rain.gaussians
        self.statistics.drops_drawn, self.statistics.haze_drawn = rain.drops_drawn, rain.haze_drawn
        return project([*parts, Part(drops, np.eye(4))], camera, [*[None] * len(parts), np.ones(len(drops), bool)])

    def _timed(self, stage: str) -> Stopwatch:
        return Stopwatch(self.statistics.stages_ms, stage)
