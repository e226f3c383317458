"""Streaks: drops near the camera, one by one."""

from ..frame_input import FrameInput
from .base import Factor, FrameParts


class Streaks:
    """Streak Gaussians; renderers find the visible drops and make them."""

    name = "streaks"
    # Without streaks, the medium must not take their place: together they extinguish what all drops do.
    factor = Factor(name, "streaks", {"streak_gain": 0.0}, {"streaks": True, "streak_gain": 1.0})

    def active(self, frame: FrameInput) -> bool:
        return frame.falling is not None and frame.falling.draws_drops

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        parts.rain = frame.falling
