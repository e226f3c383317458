"""Scene items: the scene's own Gaussians at the time of a picture, in the colors of its wetness."""

from functools import partial

import numpy as np
from jaxtyping import UInt8

from ...rain.frame import RainFrame
from ..cpu.renderer import CpuRenderer
from ..frame_input import FrameInput
from ..level_of_detail import subset_items
from ..photograph import Photograph
from ..renderer import Frame
from .base import FrameParts


class SceneItems:
    """Gaussians of layers and actors, or the photograph in their place."""

    name, factor = "scene", None

    def active(self, frame: FrameInput) -> bool:
        return True

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        if frame.photograph is not None:
            parts.compose = partial(_in_rain, frame.photograph, frame.falling)
            return
        view, quality, rainfall, readout_s = frame.view, frame.quality, frame.rainfall, 0.0
        if view.camera.rolling is not None:
            readout_s = view.camera.rolling.readout_s
        soaked, overcast = 0.0, 0.0
        if rainfall is not None:
            soaked, overcast = rainfall.soaked_share_at(view.time_s), rainfall.overcast_at(view.time_s)
        parts.whole = frame.scene.parts(
            view.time_s, selection=quality.selection, wetness=soaked, overcast=overcast, readout_s=readout_s
        )
        parts.moving = parts.whole
        if _has_still_scene(frame, parts):
            assert quality.still is not None
            parts.still = quality.still
            parts.behind, parts.moving = parts.still.split(frame.scene, parts.whole, view.camera, view.time_s)
        parts.items = list(subset_items(parts.moving, quality.thinning, view.camera))


def _in_rain(photograph: Photograph, falling: RainFrame | None, drawn: Frame) -> UInt8[np.ndarray, "h w 3"]:
    return photograph.pixels if falling is None else photograph.in_rain(falling, drawn.rgba[..., 3:])


def _has_still_scene(frame: FrameInput, parts: FrameParts) -> bool:
    """Return whether what stands still may be drawn once: by the processor, without lamps and lenses."""
    camera = frame.view.camera
    is_plain = frame.is_image and not frame.lamps and camera.lens is None and camera.rolling is None
    is_linear = frame.falling is None or frame.falling.is_linear
    return frame.quality.still is not None and isinstance(parts.renderer, CpuRenderer) and is_plain and is_linear
