"""Streaks: drops near the camera, one by one."""

from ..frame_input import FrameInput
from .base import FrameParts


class Streaks:
    """Streak Gaussians; renderers find the visible drops and make them."""

    name = "streaks"

    def active(self, frame: FrameInput) -> bool:
        return frame.falling is not None and frame.falling.draws_drops

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        parts.rain = frame.falling
