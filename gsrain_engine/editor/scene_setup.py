"""Set-up of a scene whose file tells neither axes nor unit: which way is up, the scale, the ground, and rain."""

from ..choices import Axis
from ..scene.scene import Scene
from .document import Document
from .edits.level import guess_orientation, oriented
from .viewport_state import ViewportState

SETUP_MM_H = 5.0
"""Rain that the last step of the set-up sets: moderate."""


class SceneSetup:
    """Steps from a file of Gaussians to rain, each an edit that can be undone. Main thread only."""

    def __init__(self, document: Document, viewport: ViewportState) -> None:
        self._document, self._viewport = document, viewport
        self.is_open = False
        """True while the bar with the steps is displayed."""

    def enter(self, scene: Scene, *, is_foreign: bool) -> None:
        """Open the bar for a scene that has just been opened, if it is a foreign file, which holds no unit.

        `is_foreign` is false for scene folders, which hold what was chosen, and for recovered scenes.
        """
        self.is_open = is_foreign and scene.unit_is_assumed and scene.gaussian_count > 0 and scene.view is None

    @property
    def axis(self) -> Axis | None:
        """Axis of the file that points up; None if the scene was leveled, so that none does exactly."""
        return _AXES.get(self._document.scene.up)

    def guess(self) -> None:
        """Find up direction, ground, and with a camera path the scale; without ground it is at the lowest point."""
        if self._document.edit("Guess the orientation", guess_orientation):
            self._viewport.go_home()

    def turn(self, axis: Axis) -> None:
        """Let another axis of the file point up."""
        if self._document.edit(f"Up: {axis}", oriented, axis):
            self._viewport.go_home()

    def rain(self) -> None:
        """Let it rain, which ends the set-up."""
        self._document.change_rain(f"Intensity {SETUP_MM_H:g} mm/h", intensity_mm_h=SETUP_MM_H)
        self.is_open = False


_AXES: dict[tuple[float, float, float], Axis] = {
    (1, 0, 0): "x", (-1, 0, 0): "-x", (0, 1, 0): "y", (0, -1, 0): "-y", (0, 0, 1): "z", (0, 0, -1): "-z",
}  # fmt: skip
