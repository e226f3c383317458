"""The tool "Measure": the distance between two points, and the scene's metre from a length that is known."""

from dataclasses import dataclass, field

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Float64

from gsrain_engine.scene.scene import Scene
from gsrain_engine.session.edits.scale import distance_m, set_length
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.picking import pick_point

from ..widgets.markers import draw_hint, draw_line, draw_point, draw_words, is_clicked
from ..widgets.viewport import Viewport


@dataclass(slots=True)
class MeasureTool:
    """A `Tool`."""

    name: str = "Measure"
    icon: str = icons_fontawesome_6.ICON_FA_RULER
    key: imgui.Key | None = imgui.Key.m
    help: str = "Click two points: their distance in metres. Type how long it truly is to set the scene's scale."
    true_m: float = 1.0
    _points_m: list[Float64[np.ndarray, "3"]] = field(default_factory=list[Float64[np.ndarray, "3"]])
    _scene_to_world: Float64[np.ndarray, "4 4"] | None = None

    def draw(self, session: Session, viewport: Viewport) -> bool:
        self._forget_other_worlds(session.scene)
        if is_clicked(viewport):
            point = pick_point(session.scene, viewport.shot, *viewport.mouse_px)
            if point is not None:
                self._points_m = [*self._points_m, point] if len(self._points_m) < 2 else [point]
                self.true_m = self._length_m or self.true_m
        for point in self._points_m:
            draw_point(viewport, point)
        length = self._length_m
        if length is None:
            draw_hint(viewport, "Click the second point" if self._points_m else "Click the first point")
        else:
            first, second = self._points_m
            draw_line(viewport, first, second)
            draw_words(viewport, (first + second) / 2, _in_words(length))
        return False

    def options(self, session: Session) -> None:
        length = self._length_m
        imgui.begin_disabled(length is None)
        imgui.align_text_to_frame_padding()
        imgui.text(_in_words(length) if length is not None else "- m")
        imgui.set_item_tooltip("Straight distance of the two points, in metres.")
        imgui.same_line()
        imgui.text("is truly")
        imgui.same_line()
        imgui.set_next_item_width(6 * imgui.get_font_size())
        _, self.true_m = imgui.input_float("##true length", self.true_m, 0, 0, "%.3f m")
        imgui.set_item_tooltip("How long it truly is, in metres.")
        imgui.same_line()
        if imgui.button("Set scale") and length is not None:
            session.edit("Set the scale", set_length, length, self.true_m)
        imgui.set_item_tooltip("Let the whole scene grow or shrink so that the line is as long as this.")
        imgui.end_disabled()
        imgui.same_line()
        if imgui.button("Clear##measure"):
            self._points_m = []
        imgui.set_item_tooltip("Forget both points.")

    @property
    def _length_m(self) -> float | None:
        return distance_m(*self._points_m) if len(self._points_m) == 2 else None

    def _forget_other_worlds(self, scene: Scene) -> None:
        """Points are of the world: they go where it gets other metres or another up."""
        present = scene.scene_to_world
        if self._scene_to_world is None or not np.array_equal(present, self._scene_to_world):
            self._points_m, self._scene_to_world = [], present


def _in_words(length_m: float) -> str:
    return f"{length_m:.3f} m" if length_m < 100 else f"{length_m:.1f} m"
