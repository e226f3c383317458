"""A run of frames: which camera, which moments. Frame k is the same whether it is rendered alone or among others."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene

from .frame import Frame
from .look import Look
from .renderer import Renderer
from .scene_view import Shot, draw_shot
from .sky_color import Sky, sky_color


class RenderedFrame(NamedTuple):
    """A frame of a sequence."""

    number: int
    frame: Frame


@dataclass(frozen=True, slots=True, eq=False)
class FrameSequence:
    """What to render. World frame, metres."""

    scene: Scene
    rainfall: Rainfall
    camera: Camera | CameraPath
    """A camera that stands still, or a path that is flown along."""
    width: int
    height: int
    fps: float = 30.0
    start_s: float = 0.0

    def time_s(self, number: int) -> float:
        """Moment of a frame."""
        return self.start_s + number / self.fps

    def shot(self, number: int) -> Shot:
        """Camera and moment of a frame."""
        t = self.time_s(number)
        if isinstance(self.camera, Camera):
            return Shot(self.camera, t)
        along = float(self.camera.times_s[0]) + t
        return Shot(self.camera.camera(along, self.width, self.height), t, self.camera.velocity(along))

    def sky(self, renderer: Renderer) -> Sky:
        """Look at the sky from where the sequence begins."""
        place = self.camera if isinstance(self.camera, Camera) else self.camera.camera(0.0, self.width, self.height)
        return sky_color(renderer, self.scene, place)

    def render(
        self,
        renderer: Renderer,
        numbers: Iterable[int],
        sky: Sky,
        *,
        with_depth: bool = False,
        look: Look = "splats",
    ) -> Iterator[RenderedFrame]:
        """Render frames by their numbers, in any order."""
        for number in numbers:
            shot = self.shot(number)
            draw_shot(renderer, self.scene, self.rainfall, sky.color, shot, with_depth=with_depth, look=look)
            yield RenderedFrame(number, renderer.read())
