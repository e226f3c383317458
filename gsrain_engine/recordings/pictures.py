"""Recorded pictures in rain: photographs behind streaks and a medium, or pictures of a scene made of the recording."""

from collections import Counter
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from ..appearance.capture_photos import CapturePhotos
from ..datasets.capture import Capture, CaptureFrame
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.draw import draw
from ..render.frame_input import CameraMemory, FrameInput, Mount
from ..render.passes.glass import ego_motion
from ..render.provenance import PictureProvenance, provenance_of
from ..render.renderer import Renderer
from ..render.sky_color import sky_color
from ..render.view import ego_view
from ..scene.scene import Scene

Colors = UInt8[np.ndarray, "h w 3"]


@runtime_checkable
class RainyPictures(Protocol):
    """Source of the rainy pictures of a recording."""

    provenance: dict[str, PictureProvenance]
    """Provenance of each, by the names of their views."""

    @property
    def written(self) -> int:
        """Number of pictures so far."""
        ...

    def rainy(self, view: CaptureFrame, photo: Colors) -> Colors:
        """Return a picture of the size of a view's photograph; the same array without rain."""
        ...


class PhotoRain:
    """Rain over photographs, under its clouds. Surfaces stay dry, and drops fall in front of everything."""

    def __init__(self, renderer: Renderer, capture: Capture, rain: RainSettings) -> None:
        self._renderer, self._photos, self._rainfall = renderer, CapturePhotos(capture), RainSimulation.start(rain)
        self.written = self.with_distances = 0
        """Numbers of pictures so far, and of those whose distances are measured."""
        self.lights = Counter[str]()
        """Number of pictures by what was done to their light."""
        self.provenance: dict[str, PictureProvenance] = {}

    def rainy(self, view: CaptureFrame, photo: Colors) -> Colors:
        self.written += 1
        frame = self._photos.frame(view, self._rainfall, photo)
        assert frame.photograph is not None
        self.with_distances += not frame.photograph.distances.are_assumed
        self.lights[frame.photograph.light.kind] += 1
        self.provenance[view.name] = provenance_of(frame)
        return photo if frame.is_unchanged else draw(self._renderer, frame).read_uint8()


class ScenePictures:
    """Pictures of a scene that was made of the recording, in rain, from the cameras of its views, with all passes."""

    def __init__(self, renderer: Renderer, scene: Scene, capture: Capture, rain: RainSettings) -> None:
        self._renderer, self._scene, self._rainfall = renderer, scene, RainSimulation.start(rain)
        self._sky = sky_color(renderer, scene, capture[0].camera.moved(scene.scene_to_world))
        self._memory = CameraMemory()
        self.written = 0
        self.provenance: dict[str, PictureProvenance] = {}

    def rainy(self, view: CaptureFrame, photo: Colors) -> Colors:
        self.written += 1
        camera = replace(view.camera, lens=view.lens).moved(self._scene.scene_to_world)
        shot = ego_view(self._scene, camera, view.time_s)
        past = ego_motion(self._scene, shot)
        mount = Mount(self._memory, view.sensor, past.motion, past.camera_to_ego)
        frame = FrameInput.of(self._scene, self._rainfall, self._sky, shot, mount=mount)
        self.provenance[view.name] = provenance_of(frame)
        return draw(self._renderer, frame).read_uint8()
