"""Two views and their correspondence, worked out in a thread: recorded ones, or the live one and a recorded one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gsrain_engine.appearance.clear_view import ClearView
from gsrain_engine.appearance.matching.correspondence import Correspondence, correspondence
from gsrain_engine.appearance.views.capture_views import capture_views
from gsrain_engine.appearance.views.placed_camera import PlacedCamera
from gsrain_engine.appearance.views.scene_views import scene_view, scene_views
from gsrain_engine.datasets.capture import Capture, View
from gsrain_engine.datasets.prepared import prepared
from gsrain_engine.scene.scene import Scene

WIDTH_PX = 480
"""Of the pictures that are matched."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchedViews:
    """A view, another one, and where each pixel of the first lies in the second."""

    of: ClearView
    to: ClearView
    found: Correspondence


class MatchableViews:
    """Views of a capture with what is known about their pixels; used from one thread.

    Depth is that of the capture, or of its lidar; where it has neither, or where the live view takes part, of the scene
    that was made from it.
    """

    def __init__(self, capture: Capture, scene: Scene | None) -> None:
        """Take a capture, and the scene in whose units and axes it lies, if it does."""
        self.capture, self.scene = capture, scene
        self._recorded = capture_views(capture, WIDTH_PX)
        self._straight = [prepared(view, min(WIDTH_PX, view.camera.width)) for view in capture]
        self._seen: Sequence[ClearView] | None = None
        if scene is not None:
            placed = [_placed(view, scene) for view in self._straight]
            self._seen = scene_views(scene, placed)

    def matched(self, of: int | PlacedCamera, to: int) -> MatchedViews:
        """Match a recorded view, or the live one, with a recorded one; raises ValueError where that can't be done."""
        is_live = isinstance(of, PlacedCamera)
        uses_scene = self._seen is not None and (is_live or not self._has_depth)
        if is_live and self.scene is None:
            raise ValueError("The capture does not lie in the scene: look from one of its views to match it.")
        other = self._of_scene(to) if uses_scene else self._recorded[to]
        if is_live:
            view = scene_view(self.scene or Scene(""), of.at_width(WIDTH_PX))
        else:
            view = self._of_scene(of) if uses_scene else self._recorded[of]
        return MatchedViews(view, other, correspondence(view, other))

    @property
    def _has_depth(self) -> bool:
        return bool(self.capture.sweeps) or any(view.depth_source is not None for view in self.capture)

    def _of_scene(self, index: int) -> ClearView:
        """A recorded picture, with the scene's depth."""
        assert self._seen is not None, "there is a scene"
        recorded = self._straight[index].image.astype(np.float32) / np.float32(255)
        return replace(self._seen[index], image=recorded)


def _placed(view: View, scene: Scene) -> PlacedCamera:
    return PlacedCamera(view.name, view.camera.moved(scene.scene_to_world), view.time_s, view.sensor)
