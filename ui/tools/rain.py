"""Tools "Rain regions" and "Drop color": boxes of streaks and haze, and the color of drops."""

from dataclasses import replace
from functools import partial

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Float64

from gsrain_engine.editor import rain_regions as regions
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.drive import RolloutPlayer
from gsrain_engine.editor.live_rain import LiveRain
from gsrain_engine.editor.rain_regions import FaceHandle, RegionName
from gsrain_engine.editor.viewport.picking import SkyColorPick
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.rain.settings import STREAK_REGION, RegionBox
from gsrain_engine.render.view import RenderView, rain_anchor

from ..panels.rain import PICK_TOOL
from ..widgets.draw import EDGE_MARGIN, WHITE, Canvas, draw_hint, draw_line, draw_lines, draw_point, draw_words
from ..widgets.fields import button
from ..widgets.text import inline_text
from .base import DragTool, Tool, draw_rectangle

_MIN_INSET_EM = 5.0  # height below which the view from outside is left out
_COLORS = {"streak_region": (0.45, 0.85, 1.0, 1.0), "haze_region": (1.0, 0.8, 0.45, 1.0)}
_LABELS: dict[RegionName, str] = {"streak_region": "Streak region", "haze_region": "Haze region"}
_HELP = {"streak_region": "Where drops are simulated one by one.", "haze_region": "Region that haze is limited to."}
_WHOLE: dict[RegionName, RegionBox | None] = {"streak_region": STREAK_REGION, "haze_region": None}
_GRIP_PX = 11.0
_CAMERA = (0.62, 0.62, 0.66, 0.9)


class RegionTool(Tool):
    """Drag a dot to move its face along the normal; the opposite face stays."""

    name = "Rain regions"
    icon = icons_fontawesome_6.ICON_FA_CLOUD_SHOWERS_HEAVY
    help = "Drag the dots: each moves one face of the region that drops, or haze, stand in."
    region: RegionName = "streak_region"
    _drag: regions.BoxFaceDrag | None = None
    _frozen: RenderView | None = None

    def __init__(self, document: Document, live_rain: LiveRain, rollouts: RolloutPlayer) -> None:
        self._document, self._live_rain, self._rollouts = document, live_rain, rollouts

    def draw(self, canvas: Canvas) -> bool:
        """Draw the region with a dot on each visible face, and an outside view; handle the mouse."""
        box = regions.region_box(self._document.rain, self.region)
        anchor = rain_anchor(self._rollouts.displayed_scene, self._live_rain.displayed, canvas.shot)
        color, edges = _COLORS[self.region], partial(regions.project_edges, box, anchor)
        draw_lines(canvas, edges(canvas.shot.camera).tolist(), color, 2.0)
        inset = self._inset(canvas, box, anchor)
        handles = regions.face_handles(box, anchor, canvas.shot.camera)
        outside = regions.face_handles(box, anchor, inset.shot.camera, inset=0.0)
        place, there = (inset, outside) if inset.hovered else (canvas, handles)
        under = _under_mouse(place, there)
        if under is not None and self._drag is None and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            self._drag = regions.BoxFaceDrag(under, box, self.region, place.shot.camera, place.mouse_px)
            self._frozen = inset.shot
        self._move_face(canvas, inset)
        lit = self._drag.handle if self._drag is not None else under
        self._dots(canvas, box, handles, lit, labeled=place is canvas)
        if inset.height < _MIN_INSET_EM * imgui.get_font_size():
            return lit is not None
        draw, far = imgui.get_window_draw_list(), inset.on_screen(inset.width, inset.height)
        draw.add_rect_filled(inset.corner, far, imgui.get_color_u32((0.05, 0.06, 0.08, 0.82)), 5.0)
        ink = imgui.get_color_u32((0.8, 0.8, 0.8, 0.8))
        draw.add_text(inset.on_screen(8, 5), ink, "From outside: drag the dots")
        for start, end in regions.frustum_lines(canvas.shot.camera, 0.45 * float(min(box.size_m))):
            draw_line(inset, start, end, _CAMERA)
        draw_lines(inset, edges(inset.shot.camera).tolist(), color, 2.0)
        self._dots(inset, box, outside, lit, labeled=True)
        return lit is not None or inset.hovered

    def _dots(
        self, canvas: Canvas, box: RegionBox, handles: list[FaceHandle], lit: FaceHandle | None, *, labeled: bool
    ) -> None:
        for handle in handles:
            is_lit = lit is not None and handle.face == lit.face
            draw_point(canvas, handle.point_m, *((WHITE, 7.0) if is_lit else (_COLORS[self.region], 5.5)))
            if is_lit and labeled:
                place = (box.maximum_m if handle.upper else box.minimum_m)[handle.axis]
                draw_words(canvas, handle.point_m, f"{'xyz'[handle.axis]} {place:.2f} m")

    def _inset(self, canvas: Canvas, box: RegionBox, anchor: Float64[np.ndarray, "4 4"]) -> Canvas:
        """Return the inset viewport at the lower right; its camera is fixed while a face is dragged.

        In a small viewport it is a pixel high.
        """
        em, room = imgui.get_font_size(), canvas.edges.max_bottom - canvas.edges.corner - EDGE_MARGIN
        width, height = int(min(15 * em, 0.5 * canvas.width)), int(min(11 * em, room))
        if height < _MIN_INSET_EM * em:
            height = 1
        corner = canvas.on_screen(*canvas.corner_block(width, height if height > 1 else -EDGE_MARGIN))
        shot = self._frozen if self._frozen is not None else regions.inset_view(box, anchor, width, height)
        inset = Canvas(corner, width, height, shot, canvas.hovered, canvas.active)
        x, y = inset.mouse_px
        return replace(inset, hovered=canvas.hovered and 0 <= x < width and 0 <= y < height)

    def options(self) -> None:
        for region, label in _LABELS.items():
            if imgui.radio_button(label, self.region == region):
                self.region, self._drag = region, None
            imgui.set_item_tooltip(_HELP[region])
            imgui.same_line()
        x, y, z = regions.region_box(self._document.rain, self.region).size_m
        imgui.align_text_to_frame_padding()
        is_limited = getattr(self._document.rain, self.region) is not None
        imgui.text_disabled(f"{x:.1f} x {y:.1f} x {z:.1f} m" if is_limited else "everywhere; drag a dot to limit it")
        imgui.set_item_tooltip("Ahead, across, upward; numbers of both corners are in the Rain panel under Regions.")
        imgui.same_line()
        help_text = "The region of the paper's setup." if self.region == "streak_region" else "Haze everywhere."
        if button("Reset##region", help_text):
            label = f"Reset the {_LABELS[self.region].lower()}"
            self._document.change_rain(label, None, **{self.region: _WHOLE[self.region]})

    def _move_face(self, canvas: Canvas, inset: Canvas) -> None:
        """Move the dragged face with the mouse, until the button is released."""
        if self._drag is None:
            return
        if not imgui.is_mouse_down(imgui.MouseButton_.left):
            self._drag = self._frozen = None
            self._document.end_gesture()
            return
        moved = imgui.get_io().mouse_delta
        if canvas.active and (moved.x or moved.y):
            place = inset if self._drag.camera is inset.shot.camera else canvas
            changed = self._drag.pulled(*place.mouse_px)
            self._document.change_rain(
                f"Drag the {_LABELS[self.region].lower()}", "region face", **{self.region: changed}
            )


def _under_mouse(canvas: Canvas, handles: list[FaceHandle]) -> FaceHandle | None:
    x, y = canvas.mouse_px
    near: list[tuple[float, int]] = []
    for number, handle in enumerate(handles if canvas.hovered else ()):
        pixel = canvas.pixel(handle.point_m)
        if pixel is not None and (away := float(np.hypot(pixel[0] - x, pixel[1] - y))) < _GRIP_PX:
            near.append((away, number))
    return handles[min(near)[1]] if near else None


class SkyPickTool(DragTool):
    """Click, or drag from corner to corner; drops get the color."""

    name = PICK_TOOL
    icon = icons_fontawesome_6.ICON_FA_CLOUD_SUN
    help = "Give drops a color of the image: click a pixel of the sky, or drag a rectangle (mean in linear light)."

    def __init__(self, document: Document, viewport: ViewportState, live_rain: LiveRain) -> None:
        self._document, self._viewport, self._live_rain = document, viewport, live_rain

    def draw(self, canvas: Canvas) -> bool:
        """Draw the rectangle, and request its color on release."""
        state = self.follow_drag(canvas)
        if state in ("pressed", "dragged") and self.has_moved:
            draw_rectangle(canvas, self.points[0], self.points[-1])
        elif state == "released":
            ends = self.points[0], self.points[-1 if self.has_moved else 0]
            start, end = ((x / canvas.width, y / canvas.height) for x, y in ends)
            self._viewport.sky_pick = SkyColorPick.between(start, end)
        draw_hint(canvas, "Click the sky, or drag a rectangle over it")
        return True

    def options(self) -> None:
        own = self._document.rain.drop_color
        red, green, blue = own or self._live_rain.sky.drops
        imgui.color_button("##drops now", (red, green, blue, 1.0))
        imgui.same_line()
        inline_text("picked" if own is not None else "from the scene's sky")
        imgui.begin_disabled(own is None)
        if imgui.button("From sky"):
            self._document.change_rain("Drop color from sky", drop_color=None)
        imgui.end_disabled()
        imgui.set_item_tooltip("Take the mean of the scene's own sky in linear light, the default.")
