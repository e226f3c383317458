"""The tool "Level": which way is up, from three points of the ground or from the ground itself."""

from dataclasses import dataclass, field

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Float64

from gsrain_engine.session.edits.level import level_from_ground, level_from_points, set_ground_height
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.picking import pick_point

from ..widgets.markers import draw_hint, draw_line, draw_point, is_clicked
from ..widgets.viewport import Viewport

_ORDINALS = ("first", "second", "third")


@dataclass(slots=True)
class LevelTool:
    """A `Tool`."""

    name: str = "Level"
    icon: str = icons_fontawesome_6.ICON_FA_SCALE_BALANCED
    key: imgui.Key | None = None
    help: str = "Click three points of the ground, far from one another: the scene is turned until they lie level."
    _points_m: list[Float64[np.ndarray, "3"]] = field(default_factory=list[Float64[np.ndarray, "3"]])

    def draw(self, session: Session, viewport: Viewport) -> bool:
        if is_clicked(viewport):
            point = pick_point(session.scene, viewport.shot, *viewport.mouse_px)
            if point is not None:
                self._points_m = [*self._points_m, point]
        if len(self._points_m) == 3:
            points, self._points_m = np.stack(self._points_m), []
            session.edit("Level by three points", level_from_points, points)
        for point in self._points_m:
            draw_point(viewport, point)
        if len(self._points_m) == 2:
            draw_line(viewport, self._points_m[0], self._points_m[1])
        draw_hint(viewport, f"Click the {_ORDINALS[len(self._points_m)]} point of the ground")
        return False

    def options(self, session: Session) -> None:
        if imgui.button("From the ground"):
            self._points_m = []
            session.edit("Level by the ground", level_from_ground)
        imgui.set_item_tooltip("Find the largest low plane of the scene and make it level; it becomes the ground.")
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        imgui.text("ground at")
        imgui.same_line()
        imgui.set_next_item_width(6 * imgui.get_font_size())
        ground = session.scene.ground_m
        changed, height = imgui.drag_float("##ground height", ground or 0.0, 0.01, -1000, 1000, "%.2f m")
        imgui.set_item_tooltip("Height of the ground in the world, in metres: rain falls down to it.")
        if changed:
            session.edit("Ground height", set_ground_height, height, gesture="ground height")
        if imgui.is_item_deactivated():
            session.end_gesture()
        imgui.same_line()
        if imgui.button("Clear##level"):
            self._points_m = []
        imgui.set_item_tooltip("Forget the points that were clicked.")
