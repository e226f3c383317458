"""Spray: water that fast vehicles throw from a wet road into their wakes."""

import numpy as np

from ...scene.scene import DrawItem
from ...water.spray import spray_gaussians, spray_of
from ..frame_input import FrameInput
from .base import Factor, FrameParts


class Spray:
    """Gaussians of the spray that floats at the time of the picture. It has no depth of its own."""

    name = "spray"
    factor = Factor(name, "spray", {"spray": False}, {"spray": True}, needs_wet_ground=True)

    def active(self, frame: FrameInput) -> bool:
        return frame.falling is not None and not frame.is_photograph and has_spray(frame)

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        rain = parts.rain or frame.falling
        assert frame.rainfall is not None and rain is not None
        parts.rain = rain
        found = spray_gaussians(spray_of(frame.scene, frame.rainfall, frame.time_s), rain)
        parts.items.append(DrawItem(found, np.eye(4)))


def has_spray(frame: FrameInput) -> bool:
    """Return whether spray floats in a scene at the time of a picture, drawn or not."""
    return frame.rainfall is not None and len(spray_of(frame.scene, frame.rainfall, frame.time_s)) > 0
