"""The rig's cameras side by side: which there are, where they stand in the mosaic, and what of it is drawn."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gsrain_engine.scene.scene import RigCamera, Scene

from ..view.texture import Texture

_WIDTH_STEP_PX = 16


@dataclass(slots=True)
class Mosaic:
    """What the panel wants and what has been drawn for it."""

    rig: str = ""
    """Name of the rig; one that the scene has not is its first."""
    width_px: int = 240
    """Of each picture."""
    is_wanted: bool = False
    """Whether the panel is to be seen; said anew in each frame."""
    is_behind: bool = False
    """Whether pictures are older than what the scene shows now."""
    pictures: dict[str, Texture] = field(default_factory=dict[str, Texture])
    """By camera."""

    def want(self, width_px: float) -> None:
        """Have the pictures drawn in about this width."""
        self.is_wanted = True
        self.width_px = max(64, _WIDTH_STEP_PX * round(width_px / _WIDTH_STEP_PX))

    def cameras(self, scene: Scene) -> tuple[RigCamera, ...]:
        if not scene.rigs:
            return ()
        return scene.rigs.get(self.rig) or next(iter(scene.rigs.values()))


def mosaic_rows(cameras: Sequence[RigCamera]) -> list[list[RigCamera]]:
    """Put cameras where one would look for them: those that look ahead above, from left to right; the others below."""
    ahead = [each for each in cameras if each.camera_to_ego[0, 2] > 0]
    behind = [each for each in cameras if each.camera_to_ego[0, 2] <= 0]
    rows = [sorted(ahead, key=_leftness, reverse=True), sorted(behind, key=_leftness, reverse=True)]
    return [row for row in rows if row]


def _leftness(camera: RigCamera) -> float:
    """How far to the left of straight ahead, or of straight back, a camera looks."""
    return float(np.round(camera.camera_to_ego[1, 2], 6))
