"""A run of frames: which camera, which moments. Frame k is the same whether it is rendered alone or among others."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene

from .exposure import expose
from .frame import Frame
from .look import Look
from .mounted_camera import MountedCamera
from .renderer import Renderer
from .scene_view import Shot, rain_view
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
    camera: Camera | CameraPath | MountedCamera
    """A camera that stands still, a path that is flown along, or a camera of the ego vehicle's rig."""
    width: int
    height: int
    fps: float = 30.0
    start_s: float = 0.0
    in_scene_time: bool = False
    """Whether a path's times are the scene's own; else its first key is at 0 s."""
    supersampling: int = 1
    """Draw so many times wider and higher."""
    motion_blur: int = 1
    """Sub-frames over the exposure."""
    at_rest: bool = False
    """Whether the camera stands still while the shutter is open: nothing says how fast it goes along its path."""

    def time_s(self, number: int) -> float:
        """Moment of a frame, the middle of its exposure."""
        return self.start_s + number / self.fps

    @property
    def length_s(self) -> float | None:
        """Time from the start to the end of the flight or of the drive; None for a camera that stands still."""
        match self.camera:
            case Camera():
                return None
            case CameraPath():
                return (self.camera.end_s if self.in_scene_time else self.camera.duration_s) - self.start_s
            case MountedCamera():
                return self.camera.end_s - self.start_s

    def shot(self, number: int) -> Shot:
        return self.shot_at(self.time_s(number))

    def shot_at(self, time_s: float) -> Shot:
        match self.camera:
            case Camera():
                return Shot(self.camera, time_s)
            case CameraPath():
                along = time_s if self.in_scene_time else float(self.camera.times_s[0]) + time_s
                velocity = None if self.at_rest else self.camera.velocity(along)
                return Shot(self.camera.camera(along, self.width, self.height), time_s, velocity)
            case MountedCamera():
                camera = self.camera.at(time_s).resized(self.width, self.height)
                return Shot(camera, time_s, self.camera.velocity(time_s))

    def sky(self, renderer: Renderer) -> Sky:
        """Look at the sky from where the sequence begins; all cameras of a rig look at it from the same place."""
        match self.camera:
            case Camera():
                place = self.camera
            case CameraPath():
                place = self.camera.camera(0.0, self.width, self.height)
            case MountedCamera():
                place = self.camera.front_at_start
        return sky_color(renderer, self.scene, place)

    def frame(
        self, renderer: Renderer, number: int, sky: Sky | None, *, with_depth: bool = False, look: Look = "splats"
    ) -> Frame:
        """Render a frame; without a sky there is no rain. Depth is the scene's at its moment, one sample a pixel."""
        shots, rainfall = self._shots(number), None if sky is None else self.rainfall
        color = (0.0, 0.0, 0.0) if sky is None else sky.at(self.rainfall.wetness_at(self.time_s(number)))
        at_once = with_depth and len(shots) == self.supersampling == 1
        times = self.supersampling
        frame = expose(renderer, self.scene, rainfall, color, shots, times, with_depth=at_once, look=look)
        if at_once or not with_depth:
            return frame
        alone = expose(renderer, self.scene, None, color, [self.shot(number)], with_depth=True)
        return replace(frame, depth=alone.depth)

    def render(
        self, renderer: Renderer, numbers: Iterable[int], sky: Sky, *, with_depth: bool = False, look: Look = "splats"
    ) -> Iterator[RenderedFrame]:
        """Render frames by their numbers, in any order."""
        for number in numbers:
            yield RenderedFrame(number, self.frame(renderer, number, sky, with_depth=with_depth, look=look))

    def _shots(self, number: int) -> list[Shot]:
        """What the shutter sees, evenly over the exposure around the frame's moment."""
        middle, k = self.shot(number), self.motion_blur
        if k == 1:
            return [middle]
        rain = self.rainfall.moment(middle.time_s)
        exposure_s = rain.exposure_s(rain_view(self.scene, rain, middle))
        moments = middle.time_s + exposure_s * ((np.arange(k) + 0.5) / k - 0.5)
        # At its ends a path has no speed beyond the keys: there the camera stands where it last had one.
        low, high = self._flight_s
        places = np.clip(moments, low, high) if low <= middle.time_s <= high else moments
        if self.at_rest:
            places = np.full(k, middle.time_s)
        return [
            replace(self.shot_at(float(place)), time_s=float(t), exposure_share=1 / k)
            for place, t in zip(places, moments, strict=True)
        ]

    @property
    def _flight_s(self) -> tuple[float, float]:
        """When a path begins and ends; what stands still, loops or drives does not end."""
        if not isinstance(self.camera, CameraPath) or self.camera.loop:
            return -np.inf, np.inf
        start = self.camera.start_s if self.in_scene_time else 0.0
        return start, start + self.camera.duration_s
