"""Medium: extinction and airlight of the drops that are not drawn one by one, and of fog."""

from ..frame_input import FrameInput
from .base import Factor, FrameParts


class Medium:
    """Medium along the rays of the picture, or the paper's haze of Gaussians."""

    name = "medium"
    factor = Factor(name, "medium", {"haze": "none", "visibility_m": None}, {"haze": "medium"})

    def active(self, frame: FrameInput) -> bool:
        return frame.falling is not None and frame.falling.has_haze

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        parts.rain = frame.falling
