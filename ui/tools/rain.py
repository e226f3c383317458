"""Tools "Rain regions" and "Pick sky color": boxes of streaks and haze, and the color of drops."""

from dataclasses import replace

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Float64

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.rain_regions import (
    BoxFaceDrag,
    FaceHandle,
    RegionName,
    face_handles,
    frustum_lines,
    inset_view,
    project_edges,
)
from gsrain_engine.editor.viewport.picking import SkyColorPick
from gsrain_engine.rain.settings import HAZE_REGION, STREAK_REGION, RegionBox
from gsrain_engine.render.draw import RenderView, rain_anchor

from ..panels.rain import PICK_TOOL
from ..widgets.draw import Rgba, Viewport, draw_hint, draw_line, draw_point, draw_words
from . import base
from .base import LeftDrag

_COLORS = {"streak_region": (0.45, 0.85, 1.0, 1.0), "haze_region": (1.0, 0.8, 0.45, 1.0)}
_LABELS: dict[RegionName, str] = {"streak_region": "Streak region", "haze_region": "Haze region"}
_WHOLE = {"streak_region": STREAK_REGION, "haze_region": HAZE_REGION}
_GRIP_PX = 11.0
_WHITE = (1.0, 1.0, 1.0, 1.0)
_CAMERA = (0.62, 0.62, 0.66, 0.9)
Face = tuple[int, bool]
"""Axis, and True for its upper side."""


class RegionTool:
    """Drag a dot to move its face along the normal; the opposite face stays."""

    name = "Rain regions"
    icon = icons_fontawesome_6.ICON_FA_CLOUD_SHOWERS_HEAVY
    key: imgui.Key | None = None
    help = "Drag the dots: each moves one face of the region that drops, or haze, stand in."

    def __init__(self) -> None:
        self._region: RegionName = "streak_region"
        self._pull: BoxFaceDrag | None = None
        self._frozen: RenderView | None = None

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        """Draw the region with a dot on each visible face, and an outside view; handle the mouse."""
        box = getattr(session.rain, self._region)
        anchor = rain_anchor(session.displayed_scene, session.displayed_rain, viewport.shot)
        _edges(viewport, box, anchor, _COLORS[self._region])
        inset = self._inset(viewport, box, anchor)
        handles = face_handles(box, anchor, viewport.shot.camera)
        outside = face_handles(box, anchor, inset.shot.camera, inset=0.0)
        place, there = (inset, outside) if inset.hovered else (viewport, handles)
        under = _under_mouse(place, there)
        if under is not None and self._pull is None and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            self._pull = BoxFaceDrag(under, box, self._region, place.shot.camera, place.mouse_px)
            self._frozen = inset.shot
        held = self._drag(session, viewport, inset)
        face = held if held is not None else None if under is None else under.face
        self._dots(viewport, box, handles, face, labelled=place is viewport)
        _backdrop(inset)
        for start, end in frustum_lines(viewport.shot.camera, 0.45 * float(min(box.size_m))):
            draw_line(inset, start, end, _CAMERA)
        _edges(inset, box, anchor, _COLORS[self._region])
        self._dots(inset, box, outside, face, labelled=True)
        return held is not None or inset.hovered or under is not None

    def _dots(
        self, viewport: Viewport, box: RegionBox, handles: list[FaceHandle], face: Face | None, *, labelled: bool
    ) -> None:
        for handle in handles:
            bright = handle.face == face
            color = _WHITE if bright else _COLORS[self._region]
            draw_point(viewport, handle.point_m, color, 7.0 if bright else 5.5)
            if bright and labelled:
                place = (box.maximum_m if handle.upper else box.minimum_m)[handle.axis]
                draw_words(viewport, handle.point_m, f"{'xyz'[handle.axis]} {place:.2f} m")

    def _inset(self, viewport: Viewport, box: RegionBox, anchor: Float64[np.ndarray, "4 4"]) -> Viewport:
        """Return the inset viewport at the lower right; its camera is fixed while a face is dragged."""
        em = imgui.get_font_size()
        width, height = int(min(15 * em, 0.5 * viewport.width)), int(min(11 * em, 0.5 * viewport.height))
        corner = viewport.on_screen(viewport.width - width - 0.6 * em, viewport.height - height - 0.6 * em)
        shot = self._frozen if self._frozen is not None else inset_view(box, anchor, width, height)
        inset = Viewport(corner, width, height, shot, viewport.hovered, viewport.active)
        x, y = inset.mouse_px
        return replace(inset, hovered=viewport.hovered and 0 <= x < width and 0 <= y < height)

    def options(self, session: Editor) -> None:
        for region, label in _LABELS.items():
            if imgui.radio_button(label, self._region == region):
                self._region, self._pull = region, None
            imgui.set_item_tooltip(
                "Where drops are simulated one by one." if region == "streak_region" else "Where far drops are haze."
            )
            imgui.same_line()
        box = getattr(session.rain, self._region)
        x, y, z = box.size_m
        imgui.align_text_to_frame_padding()
        imgui.text_disabled(f"{x:.1f} x {y:.1f} x {z:.1f} m")
        imgui.set_item_tooltip("Ahead, across, upward; numbers of both corners are in the Rain panel under Regions.")
        imgui.same_line()
        if imgui.button("Reset##region"):
            session.change_rain(
                f"Reset the {_LABELS[self._region].lower()}", None, **{self._region: _WHOLE[self._region]}
            )
        imgui.set_item_tooltip("The region of the paper's setup.")

    def _drag(self, session: Editor, viewport: Viewport, inset: Viewport) -> Face | None:
        """Move the dragged face with the mouse; returns the face."""
        if self._pull is None:
            return None
        if not imgui.is_mouse_down(imgui.MouseButton_.left):
            self._pull = self._frozen = None
            session.end_gesture()
            return None
        moved = imgui.get_io().mouse_delta
        if viewport.active and (moved.x or moved.y):
            place = inset if self._pull.camera is inset.shot.camera else viewport
            changed = self._pull.pulled(*place.mouse_px)
            session.change_rain(f"Drag the {_LABELS[self._region].lower()}", "region face", **{self._region: changed})
        return self._pull.handle.face


def _edges(viewport: Viewport, box: RegionBox, anchor: Float64[np.ndarray, "4 4"], color: Rgba) -> None:
    draw = imgui.get_window_draw_list()
    for start, end in project_edges(box, anchor, viewport.shot.camera).tolist():
        draw.add_line(viewport.on_screen(*start), viewport.on_screen(*end), imgui.get_color_u32(color), 2.0)


def _backdrop(inset: Viewport) -> None:
    draw, far = imgui.get_window_draw_list(), inset.on_screen(inset.width, inset.height)
    draw.add_rect_filled(inset.corner, far, imgui.get_color_u32((0.05, 0.06, 0.08, 0.82)), 5.0)
    words = "From outside: drag the dots"
    at = inset.on_screen(8, 5)
    draw.add_text(at, imgui.get_color_u32((0.8, 0.8, 0.8, 0.8)), words)


def _under_mouse(viewport: Viewport, handles: list[FaceHandle]) -> FaceHandle | None:
    x, y = viewport.mouse_px
    near: list[tuple[float, int]] = []
    for number, handle in enumerate(handles if viewport.hovered else ()):
        pixel = viewport.pixel(handle.point_m)
        if pixel is not None and (away := float(np.hypot(pixel[0] - x, pixel[1] - y))) < _GRIP_PX:
            near.append((away, number))
    return handles[min(near)[1]] if near else None


# Tool "Pick sky color"


class SkyPickTool:
    """Click, or drag from corner to corner; drops get the color."""

    name = PICK_TOOL
    icon = icons_fontawesome_6.ICON_FA_CLOUD_SUN
    key: imgui.Key | None = None
    help = "Give drops the colour of the sky you show: click a pixel, or drag a rectangle (mean in linear light)."

    def __init__(self) -> None:
        self._drag = LeftDrag()

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        """Draw the rectangle, and request its color on release."""
        state = self._drag.follow(viewport)
        if state in ("pressed", "dragged") and self._drag.has_moved:
            base.draw_rectangle(viewport, self._drag.points[0], self._drag.points[-1])
        elif state == "released":
            start, end = self._drag.points[0], self._drag.points[-1] if self._drag.has_moved else self._drag.points[0]
            size = viewport.width, viewport.height
            session.sky_pick = SkyColorPick.between(
                (start[0] / size[0], start[1] / size[1]), (end[0] / size[0], end[1] / size[1])
            )
            self._drag.drop()
        draw_hint(viewport, "Click the sky, or drag a rectangle over it")
        return True

    def options(self, session: Editor) -> None:
        own = session.rain.drop_color
        red, green, blue = own or session.sky
        imgui.color_button("##drops now", (red, green, blue, 1.0))
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        imgui.text("picked" if own is not None else "from the scene's sky")
        imgui.same_line()
        imgui.begin_disabled(own is None)
        if imgui.button("From the sky again"):
            session.change_rain("Drop colour from the sky", drop_color=None)
        imgui.end_disabled()
        imgui.set_item_tooltip("Take the mean of the scene's own sky in linear light, as at first (eq. 3).")
