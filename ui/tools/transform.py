"""Tools "Transform", "Level", "Set origin or ego start" and "Measure"."""

import logging
from typing import Literal, NamedTuple

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Float64

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.edits import level
from gsrain_engine.editor.edits.actors import SENSOR_HEIGHT_M, set_ego_start, set_origin
from gsrain_engine.editor.edits.gaussians import selected_count
from gsrain_engine.editor.edits.transform import move_member, move_selected, pivot, preview_move
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport.picking import Handle, frame_at
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.scene.scene import Scene

from ..widgets.draw import Canvas, Gizmo, draw_hint, draw_line, draw_point, draw_words
from ..widgets.fields import button
from ..widgets.text import inline_text
from .base import Tool, clicked_point, drag_number

logger = logging.getLogger("gsrain")
Point = Float64[np.ndarray, "3"]


class _Drag(NamedTuple):
    """Target of the current drag, and its transform."""

    scene: Scene
    key: str | None
    time_s: float
    delta: Float64[np.ndarray, "4 4"]


class MoveTool(Tool):
    """Gizmo that moves, rotates and scales the selection, or the active layer or actor."""

    name = "Transform"
    icon = icons_fontawesome_6.ICON_FA_UP_DOWN_LEFT_RIGHT
    key = imgui.Key.t
    help = "Move, turn or scale what is selected, else what is picked in Layers. Ctrl snaps, Esc takes it back."
    handle: Handle = "translate"
    _drag: _Drag | None = None

    def __init__(self, document: Document, viewport: ViewportState, playback: Playback) -> None:
        self._document, self._viewport, self._playback = document, viewport, playback
        self._gizmo = Gizmo("move")

    def draw(self, canvas: Canvas) -> bool:
        """Draw the gizmo and preview the transform; one drag is one undo step."""
        scene, is_resumed = self._document.scene, self.is_resumed()
        if is_resumed:
            self._gizmo.let_go()
        if self._drag is not None and (is_resumed or self._drag.scene is not scene):
            self._drag = None  # canceled by Esc, or the document has changed
        key, time_s = _target(self._document, self._viewport), self._playback.clock.time_s
        middle = pivot(scene, key, time_s) if key != "" else None
        if middle is None:
            draw_hint(canvas, "Select something, or pick an unlocked layer or actor in Layers")
            return False
        delta, uses_button = self._gizmo.draw(canvas, frame_at(middle), self.handle)
        if delta is not None:
            self._drag = _Drag(scene, key, time_s, delta)
            self._viewport.preview = preview_move(scene, key, delta, time_s)
        elif self._drag is not None:
            self._finish(self._drag)
        return uses_button

    def options(self) -> None:
        for handle, (verb, help_text) in _VERBS.items():
            if imgui.radio_button(f"{verb}##handle", self.handle == handle):
                self.handle = handle
            imgui.set_item_tooltip(help_text)
            imgui.same_line()
        key = _target(self._document, self._viewport)
        count = f"{selected_count(self._document.scene):,} selected"
        imgui.text_disabled(count if key is None else key.partition("/")[2] or "nothing")
        imgui.set_item_tooltip("What the gizmo acts on: the selection, else the layer or actor picked in Layers.")

    def _finish(self, drag: _Drag) -> None:
        self._drag, verb = None, _VERBS[self.handle][0]
        if np.array_equal(drag.delta, np.eye(4)):
            return
        if drag.key is None:
            self._document.edit(f"{verb} the selection", move_selected, drag.delta, drag.time_s)
        else:
            self._document.edit(f"{verb} {drag.key.partition('/')[2]}", move_member, drag.key, drag.delta)


_VERBS: dict[Handle, tuple[str, str]] = {
    "translate": ("Move", "Drag an arrow or a square; Ctrl snaps to round steps that fit the view."),
    "rotate": ("Turn", "Drag a ring; Ctrl snaps to 15 degrees."),
    "scale": ("Scale", "Drag a handle: all three axes scale alike; Ctrl snaps to tenths."),
}


def _target(document: Document, viewport: ViewportState) -> str | None:
    """Return None for the selection, the key of a layer or actor, or "" for nothing."""
    if selected_count(document.scene):
        return None
    chosen = viewport.active_member
    return chosen.key if chosen is not None and chosen.visible and not chosen.locked else ""


class LevelTool(Tool):
    """Tool that sets the up direction, from three points of the ground or from the ground itself."""

    name = "Level"
    icon = icons_fontawesome_6.ICON_FA_SCALE_BALANCED
    help = "Click three points of the ground, far from one another: the scene is turned until they lie level."
    _points_m: tuple[Point, ...] = ()

    def __init__(self, document: Document) -> None:
        self._document = document

    def draw(self, canvas: Canvas) -> bool:
        point = clicked_point(self._document, canvas)
        if point is not None:
            self._points_m = (*self._points_m, point)
        if len(self._points_m) == 3:
            points, self._points_m = np.stack(self._points_m), ()
            self._document.edit("Level by three points", level.level_from_points, points)
        for point in self._points_m:
            draw_point(canvas, point)
        if len(self._points_m) == 2:
            draw_line(canvas, *self._points_m)
        draw_hint(canvas, f"Click the {('first', 'second', 'third')[len(self._points_m)]} point of the ground")
        return False

    def options(self) -> None:
        help_text = "Find the largest low plane of the scene and make it level; it becomes the ground."
        if button("From the ground", help_text):
            self._points_m = ()
            self._document.edit("Level by the ground", level.level_from_ground)
        imgui.same_line()
        inline_text("ground at")
        ground_m, bounds_m = self._document.scene.ground_m or 0.0, (-1000, 1000)
        help_text = "Height of the ground in the world, in meters: rain falls down to it."
        changed, height = drag_number("##ground height", ground_m, 0.01, bounds_m, "%.2f m", help_text, 6, flags=0)
        if changed:
            self._document.edit("Ground height", level.set_ground_height, height, gesture="ground height")
        if imgui.is_item_deactivated():
            self._document.end_gesture()
        imgui.same_line()
        if button("Clear##level", "Forget the points that were clicked."):
            self._points_m = ()


class OriginTool(Tool):
    """Tool that sets the ego vehicle's start, the world's origin, or the ground height."""

    name = "Set origin or ego start"
    icon = icons_fontawesome_6.ICON_FA_LOCATION_CROSSHAIRS
    help = "Click a point of the ground: where the ego vehicle starts, or the world's origin, or the ground's height."
    meaning: Literal["Ego start", "World origin", "Ground height"] = "Ego start"

    def __init__(self, document: Document, viewport: ViewportState, playback: Playback) -> None:
        self._document, self._viewport, self._playback = document, viewport, playback

    def draw(self, canvas: Canvas) -> bool:
        ego = self._document.scene.ego_to_world(self._playback.clock.time_s)
        if ego is not None:
            draw_point(canvas, ego[:3, 3])
            draw_words(canvas, ego[:3, 3], "ego")
        draw_hint(canvas, f"Click a point of the ground: {self.meaning.lower()}")
        point = clicked_point(self._document, canvas)
        if point is None:
            return False
        logger.info("%s: x %.2f, y %.2f, z %.2f m", self.meaning, *point)
        if self.meaning == "Ego start":
            self._document.edit("Ego start", set_ego_start, point, self._viewport.navigation.heading)
        elif self.meaning == "Ground height":
            self._document.edit("Ground height", level.set_ground_height, float(point[2]))
        else:
            self._document.edit("World origin", set_origin, point)
            self._viewport.navigation.position = self._viewport.navigation.position - point
        return False

    def options(self) -> None:
        for meaning, help_text in _MEANINGS.items():
            if imgui.radio_button(meaning, self.meaning == meaning):
                self.meaning = meaning
            imgui.set_item_tooltip(help_text)
            imgui.same_line()
        imgui.new_line()


_MEANINGS: dict[Literal["Ego start", "World origin", "Ground height"], str] = {
    "Ego start": f"The ego vehicle starts over the point, its sensors {SENSOR_HEIGHT_M} m above it. A scene that has "
    "none gets one that stands there and looks as you do.",
    "World origin": "Everything moves so that the point becomes x = y = z = 0.",
    "Ground height": "The ground is as high as the point: rain falls down to it.",
}


class MeasureTool(Tool):
    """Tool that measures the distance of two points, and scales the scene by a known length."""

    name = "Measure"
    icon = icons_fontawesome_6.ICON_FA_RULER
    key = imgui.Key.m
    help = "Click two points: their distance in meters. Type how long it truly is to set the scene's scale."
    true_m = 1.0
    points_m: tuple[Point, ...] = ()
    _scene_to_world: Float64[np.ndarray, "4 4"] | None = None

    def __init__(self, document: Document) -> None:
        self._document = document

    def draw(self, canvas: Canvas) -> bool:
        # The points are in world coordinates: clear them when the scene gets another scale or orientation.
        present = self._document.scene.scene_to_world
        if self._scene_to_world is None or not np.array_equal(present, self._scene_to_world):
            self.points_m, self._scene_to_world = (), present
        point = clicked_point(self._document, canvas)
        if point is not None:
            self.points_m = (*self.points_m, point) if len(self.points_m) < 2 else (point,)
            self.true_m = self._length_m or self.true_m
        for point in self.points_m:
            draw_point(canvas, point)
        length = self._length_m
        if length is None:
            draw_hint(canvas, "Click the second point" if self.points_m else "Click the first point")
        else:
            first, second = self.points_m
            draw_line(canvas, first, second)
            draw_words(canvas, (first + second) / 2, _in_words(length))
        return False

    def options(self) -> None:
        length = self._length_m
        imgui.begin_disabled(length is None)
        imgui.align_text_to_frame_padding()
        imgui.text(_in_words(length) if length is not None else "- m")
        imgui.set_item_tooltip("Straight distance of the two points, in meters.")
        imgui.same_line()
        imgui.text("is truly")
        imgui.same_line()
        imgui.set_next_item_width(6 * imgui.get_font_size())
        _, self.true_m = imgui.input_float("##true length", self.true_m, 0, 0, "%.3f m")
        imgui.set_item_tooltip("How long it truly is, in meters.")
        imgui.same_line()
        help_text = "Let the whole scene grow or shrink so that the line is as long as this."
        if button("Set scale", help_text) and length is not None:
            self._document.edit("Set the scale", level.set_length, length, self.true_m)
        imgui.end_disabled()
        imgui.same_line()
        if button("Clear##measure", "Forget both points."):
            self.points_m = ()

    @property
    def _length_m(self) -> float | None:
        if len(self.points_m) < 2:
            return None
        first, second = self.points_m
        return float(np.linalg.norm(second - first))


def _in_words(length_m: float) -> str:
    return f"{length_m:.3f} m" if length_m < 100 else f"{length_m:.1f} m"
