"""What the timeline shows and what is chosen there; not part of the document."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.paths.speed import PathSpeed

from .ruler import Ruler


class KeyDrag(NamedTuple):
    """A key in the hand: every place of the hand gives the same path, whichever way led there."""

    path: CameraPath
    """As it was when the key was taken hold of; scene units and axes."""
    key: int
    copies: bool = False
    """Leave the key where it is and drag a copy."""
    in_view: bool = False
    """Taken in the picture, not on the timeline."""
    has_moved: bool = False
    """Whether the hand has moved since: else it was a click."""

    def begun(self) -> "KeyDrag":
        return self._replace(has_moved=True)


@dataclass(slots=True)
class Timeline:
    """State of the Timeline panel."""

    key: int | None = None
    """Number of the chosen key, which an undo may have taken away: `camera_path.edits.chosen_key` looks."""
    drag: KeyDrag | None = None
    fps: float = 30.0
    """Of the film: keys and steps keep to its frames."""
    show_path: bool = True
    """Draw the path and its keys into the picture."""
    ruler: Ruler = field(default_factory=Ruler)
    is_fitted: bool = False
    """Whether the ruler has been set to show the scene's whole time."""
    takes_keys: bool = False
    """Whether the panel has the keyboard."""
    asks_for_time: bool = False
    """Whether the panel should let a moment be typed next."""


@lru_cache(maxsize=4)
def speed_of(path: CameraPath) -> PathSpeed:
    """Speed of a path in the world; of the same path only worked out once."""
    return PathSpeed.of(path)
