"""Recorded pictures in rain: photographs behind streaks and a medium, or pictures of a scene made of the recording."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from ..appearance.capture_photos import CapturePhotos
from ..datasets.capture import Capture, CaptureFrame
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.cpu.renderer import CpuRenderer
from ..render.draw import draw
from ..render.frame_input import CameraMemory, FrameInput, Mount
from ..render.passes.glass import ego_motion
from ..render.provenance import PictureProvenance, provenance_of
from ..render.renderer import Renderer
from ..render.sky_color import sky_color
from ..render.view import ego_view
from ..scene.scene import Scene
from ..threads import usable_cores

Colors = UInt8[np.ndarray, "h w 3"]


MakePicture = Callable[[Colors], Colors]
"""Returns a picture of a photograph's size; the same array without rain."""

_MAX_THREADS = 8  # each holds some 200 MB for a picture of 1936 x 1216


@runtime_checkable
class RainyPictures(Protocol):
    """Source of the rainy pictures of a recording."""

    @property
    def threads(self) -> int:
        """Number of pictures that may be made at once."""
        ...

    def begin(self, view: CaptureFrame) -> MakePicture:
        """Return what makes the next picture, that of a view; it may be called in any thread."""
        ...


class PictureFacts(NamedTuple):
    """A picture as it was made."""

    name: str
    provenance: PictureProvenance
    has_distances: bool = False
    """True for a photograph whose distances are measured."""
    light: str = ""
    """Kind of a photograph's `PhotoLight`."""


class CountedPictures(ABC):
    """Rainy pictures with their facts, in the order in which they were begun, whichever thread makes them."""

    threads = 1

    def __init__(self) -> None:
        self._facts: list[PictureFacts | None] = []
        self._pair: tuple[Colors, Colors] | None = None

    def begin(self, view: CaptureFrame) -> MakePicture:
        """Return what makes the next picture, that of a view; it may be called in any thread."""
        self._facts.append(None)
        return partial(self._count, len(self._facts) - 1, view)

    def rainy(self, view: CaptureFrame, photo: Colors) -> Colors:
        """Make the next picture."""
        return self.begin(view)(photo)

    def _count(self, number: int, view: CaptureFrame, photo: Colors) -> Colors:
        picture, self._facts[number] = self._picture(view, photo)
        if number == 0:
            self._pair = photo, picture
        return picture

    @abstractmethod
    def _picture(self, view: CaptureFrame, photo: Colors) -> tuple[Colors, PictureFacts]: ...

    @property
    def facts(self) -> list[PictureFacts]:
        """Facts of the pictures so far."""
        return [each for each in self._facts if each is not None]

    @property
    def written(self) -> int:
        """Number of pictures so far."""
        return len(self.facts)

    @property
    def provenance(self) -> dict[str, PictureProvenance]:
        """Provenance of each, by the names of their views."""
        return {each.name: each.provenance for each in self.facts}

    def draw(self) -> Colors:
        """Draw the first photograph, and its picture in rain beside it."""
        return np.concatenate(self._pair, axis=1) if self._pair else np.zeros((1, 2, 3), np.uint8)


class PhotoRain(CountedPictures):
    """Rain over photographs, under its clouds. Surfaces stay dry, and drops fall in front of everything."""

    def __init__(self, renderer: Renderer, capture: Capture, rain: RainSettings) -> None:
        """Draw by a renderer, and in other threads by copies of it; only that of the CPU has copies."""
        super().__init__()
        self._capture, self._rainfall = capture, RainSimulation.start(rain)
        self._idle = [(renderer, CapturePhotos(capture))]
        self.threads = min(usable_cores(), _MAX_THREADS) if isinstance(renderer, CpuRenderer) else 1

    @property
    def with_distances(self) -> int:
        """Number of pictures so far whose distances are measured."""
        return sum(each.has_distances for each in self.facts)

    @property
    def lights(self) -> Counter[str]:
        """Number of pictures by what was done to their light."""
        return Counter(each.light for each in self.facts)

    def _picture(self, view: CaptureFrame, photo: Colors) -> tuple[Colors, PictureFacts]:
        own: tuple[Renderer, CapturePhotos] | None = None
        with suppress(IndexError):  # all are in use by other threads
            own = self._idle.pop()
        renderer, photos = own = own or (CpuRenderer(), CapturePhotos(self._capture))
        try:
            frame = photos.frame(view, self._rainfall, photo)
            picture = photo if frame.is_unchanged else draw(renderer, frame).read_uint8()
        finally:
            self._idle.append(own)
        shown = frame.photograph
        assert shown is not None
        measured = not shown.distances.are_assumed
        return picture, PictureFacts(view.name, provenance_of(frame), measured, shown.light.kind)


class ScenePictures(CountedPictures):
    """Pictures of a scene that was made of the recording, in rain, from the cameras of its views, with all passes."""

    def __init__(self, renderer: Renderer, scene: Scene, capture: Capture, rain: RainSettings) -> None:
        super().__init__()
        self._renderer, self._scene, self._rainfall = renderer, scene, RainSimulation.start(rain)
        self._sky = sky_color(renderer, scene, capture[0].camera.moved(scene.scene_to_world))
        self._memory = CameraMemory()

    def _picture(self, view: CaptureFrame, photo: Colors) -> tuple[Colors, PictureFacts]:
        camera = replace(view.camera, lens=view.lens).moved(self._scene.scene_to_world)
        shot = ego_view(self._scene, camera, view.time_s)
        past = ego_motion(self._scene, shot)
        mount = Mount(self._memory, view.sensor, past.motion, past.camera_to_ego)
        frame = FrameInput.of(self._scene, self._rainfall, self._sky, shot, mount=mount)
        return draw(self._renderer, frame).read_uint8(), PictureFacts(view.name, provenance_of(frame))
