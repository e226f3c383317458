"""Tools "Move", "Level", "Set origin" and "Measure"."""

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Float64

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.actors import SENSOR_HEIGHT_M, set_ego_start, set_origin
from gsrain_engine.editor.edits.gaussians import selected_count
from gsrain_engine.editor.edits.level import (
    distance_m,
    level_from_ground,
    level_from_points,
    set_ground_height,
    set_length,
)
from gsrain_engine.editor.edits.transform import move_member, move_selected, pivot, preview_move
from gsrain_engine.editor.viewport.picking import Handle, frame_at, pick_point
from gsrain_engine.scene.scene import Scene

from ..widgets.draw import Gizmo, Viewport, draw_hint, draw_line, draw_point, draw_words, is_clicked

_VERBS: dict[Handle, tuple[str, str]] = {
    "translate": ("Move", "Drag an arrow or a square; Ctrl snaps to half a metre."),
    "rotate": ("Turn", "Drag a ring; Ctrl snaps to 15 degrees."),
    "scale": ("Scale", "Drag a handle: all three axes scale alike; Ctrl snaps to tenths."),
}


@dataclass(slots=True)
class _Drag:
    """Target of the current drag, and its transform."""

    scene: Scene
    key: str | None
    time_s: float
    delta: Float64[np.ndarray, "4 4"]


@dataclass(slots=True)
class MoveTool:
    """Gizmo that moves, rotates and scales the selection, or the active layer or actor."""

    name: str = "Move"
    icon: str = icons_fontawesome_6.ICON_FA_UP_DOWN_LEFT_RIGHT
    key: imgui.Key | None = imgui.Key.t
    help: str = "Move, turn or scale what is selected, else what is picked in Layers. Ctrl snaps, Esc takes it back."
    handle: Handle = "translate"
    _gizmo: Gizmo = field(default_factory=lambda: Gizmo("move"))
    _drag: _Drag | None = None
    _frame: int = 0

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        """Draw the gizmo and preview the transform; one drag is one undo step."""
        scene = session.scene
        was_put_away, self._frame = self._frame < imgui.get_frame_count() - 1, imgui.get_frame_count()
        if was_put_away:
            self._gizmo.let_go()
        if self._drag is not None and (was_put_away or self._drag.scene is not scene):
            self._drag = None  # canceled by Esc, or the document has changed
        key, time_s = _target(session), session.clock.time_s
        middle = pivot(scene, key, time_s) if key != "" else None
        if middle is None:
            draw_hint(viewport, "Select something, or pick an unlocked layer or actor in Layers")
            return False
        delta, is_taken = self._gizmo.draw(viewport, frame_at(middle), self.handle)
        if delta is not None:
            self._drag = _Drag(scene, key, time_s, delta)
            session.preview = preview_move(scene, key, delta, time_s)
        elif self._drag is not None:
            self._finish(session, self._drag)
        return is_taken

    def options(self, session: Editor) -> None:
        for handle, (verb, help_text) in _VERBS.items():
            if imgui.radio_button(f"{verb}##handle", self.handle == handle):
                self.handle = handle
            imgui.set_item_tooltip(help_text)
            imgui.same_line()
        key = _target(session)
        name = f"{selected_count(session.scene):,} selected" if key is None else key.partition("/")[2] or "nothing"
        imgui.text_disabled(name)
        imgui.set_item_tooltip("What the gizmo acts on: the selection, else the layer or actor picked in Layers.")

    def _finish(self, session: Editor, drag: _Drag) -> None:
        self._drag, verb = None, _VERBS[self.handle][0]
        if np.array_equal(drag.delta, np.eye(4)):
            return
        if drag.key is None:
            session.edit(f"{verb} the selection", move_selected, drag.delta, drag.time_s)
        else:
            name = drag.key.partition("/")[2]
            session.edit(f"{verb} {name}", move_member, drag.key, drag.delta)


def _target(session: Editor) -> str | None:
    """Return None for the selection, the key of a layer or actor, or "" for nothing."""
    if selected_count(session.scene):
        return None
    chosen = next((each for each in session.scene.members if each.key == session.view.member), None)
    return chosen.key if chosen is not None and chosen.visible and not chosen.locked else ""


# Level

_ORDINALS = ("first", "second", "third")


@dataclass(slots=True)
class LevelTool:
    """Tool that sets the up direction, from three points of the ground or from the ground itself."""

    name: str = "Level"
    icon: str = icons_fontawesome_6.ICON_FA_SCALE_BALANCED
    key: imgui.Key | None = None
    help: str = "Click three points of the ground, far from one another: the scene is turned until they lie level."
    _points_m: list[Float64[np.ndarray, "3"]] = field(default_factory=list[Float64[np.ndarray, "3"]])

    def draw(self, session: Editor, viewport: Viewport) -> bool:
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

    def options(self, session: Editor) -> None:
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


# Set origin

Meaning = Literal["Ego start", "World origin", "Ground height"]

_HELP: dict[Meaning, str] = {
    "Ego start": f"The ego vehicle starts over the point, its sensors {SENSOR_HEIGHT_M} m above it. A scene that has "
    "none gets one that stands there and looks as you do.",
    "World origin": "Everything moves so that the point becomes x = y = z = 0.",
    "Ground height": "The ground is as high as the point: rain falls down to it.",
}


@dataclass(slots=True)
class OriginTool:
    """Tool that sets the ego vehicle's start, the world's origin, or the ground height."""

    name: str = "Set origin"
    icon: str = icons_fontawesome_6.ICON_FA_LOCATION_CROSSHAIRS
    key: imgui.Key | None = None
    help: str = (
        "Click a point of the ground: where the ego vehicle starts, or the world's origin, or the ground's height."
    )
    meaning: Meaning = "Ego start"

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        ego = session.scene.ego_to_world(session.clock.time_s)
        if ego is not None:
            draw_point(viewport, ego[:3, 3])
            draw_words(viewport, ego[:3, 3], "ego")
        draw_hint(viewport, f"Click a point of the ground: {self.meaning.lower()}")
        if is_clicked(viewport):
            point = pick_point(session.scene, viewport.shot, *viewport.mouse_px)
            if point is not None and self.meaning == "Ego start":
                session.edit("Ego start", set_ego_start, point, session.navigation.heading)
            elif point is not None and self.meaning == "Ground height":
                session.edit("Ground height", set_ground_height, float(point[2]))
            elif point is not None:
                session.edit("World origin", set_origin, point)
                session.navigation.position = session.navigation.position - point
        return False

    def options(self, session: Editor) -> None:
        meanings: tuple[Meaning, ...] = get_args(Meaning)
        for meaning in meanings:
            if imgui.radio_button(meaning, self.meaning == meaning):
                self.meaning = meaning
            imgui.set_item_tooltip(_HELP[meaning])
            imgui.same_line()
        imgui.new_line()


# Measure


@dataclass(slots=True)
class MeasureTool:
    """Tool that measures the distance of two points, and scales the scene by a known length."""

    name: str = "Measure"
    icon: str = icons_fontawesome_6.ICON_FA_RULER
    key: imgui.Key | None = imgui.Key.m
    help: str = "Click two points: their distance in metres. Type how long it truly is to set the scene's scale."
    true_m: float = 1.0
    _points_m: list[Float64[np.ndarray, "3"]] = field(default_factory=list[Float64[np.ndarray, "3"]])
    _scene_to_world: Float64[np.ndarray, "4 4"] | None = None

    def draw(self, session: Editor, viewport: Viewport) -> bool:
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

    def options(self, session: Editor) -> None:
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
        """Clear the points, which are in world coordinates, when the scene gets another scale or orientation."""
        present = scene.scene_to_world
        if self._scene_to_world is None or not np.array_equal(present, self._scene_to_world):
            self._points_m, self._scene_to_world = [], present


def _in_words(length_m: float) -> str:
    return f"{length_m:.3f} m" if length_m < 100 else f"{length_m:.1f} m"
