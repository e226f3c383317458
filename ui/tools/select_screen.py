"""Selection tools on the screen: brush, lasso, polygon, rectangle, flood and color pick."""

from typing import get_args

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.selection import screen
from gsrain_engine.editor.selection.candidates import Mode, base_color, is_selectable, select_similar_colors
from gsrain_engine.editor.selection.commands import select
from gsrain_engine.editor.selection.screen import Depths, select_in_screen_shape
from gsrain_engine.editor.selection.volume import Volume, flood_select, in_volume
from gsrain_engine.editor.viewport.picking import PickResult, pick

from ..widgets.draw import Viewport, is_clicked
from . import base
from .base import LeftDrag

_MIN_PX, _MAX_PX = 2.0, 300.0
_STEP = 1.2

# Brush

MODIFIERS = "Shift adds, Ctrl removes, both intersect."


class BrushTool:
    """Paint with a disc."""

    name = "Brush"
    icon = icons_fontawesome_6.ICON_FA_PAINTBRUSH
    key: imgui.Key | None = imgui.Key.n
    help = f"Paint over what to select; [ and ] change the brush. {MODIFIERS}"

    def __init__(self) -> None:
        self._drag = LeftDrag()

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        options = session.selecting
        if not (imgui.get_io().want_text_input or imgui.get_io().key_ctrl):
            for key, factor in ((imgui.Key.left_bracket, 1 / _STEP), (imgui.Key.right_bracket, _STEP)):
                if imgui.is_key_pressed(key):
                    options.brush_radius_px = min(max(options.brush_radius_px * factor, _MIN_PX), _MAX_PX)
        state = self._drag.follow(viewport)
        if state != "none":
            size = viewport.width, viewport.height
            pixels = screen.stroke(self._drag.points, options.brush_radius_px, *size)
            if state == "released":
                take_shape(session, viewport, pixels, "brush")
                self._drag.drop()
            else:
                for edge in screen.outlines(pixels):
                    base.draw_polyline(viewport, edge.tolist(), closed=True)
        if viewport.hovered or viewport.active:
            base.draw_ring(viewport, viewport.mouse_px, options.brush_radius_px)
        return True

    def options(self, session: Editor) -> None:
        options = session.selecting
        shape_options(session)
        same_line_if_fits(7)
        imgui.set_next_item_width(7 * imgui.get_font_size())
        flags = imgui.SliderFlags_.always_clamp
        _, options.brush_radius_px = imgui.drag_float(
            "##radius", options.brush_radius_px, 0.5, _MIN_PX, _MAX_PX, "radius %.0f px", flags
        )
        imgui.set_item_tooltip("Radius of the brush in pixels ([ and ]).")


# Lasso


class LassoTool:
    """Drag around the Gaussians to select."""

    name = "Lasso"
    icon = icons_fontawesome_6.ICON_FA_PENCIL
    key: imgui.Key | None = imgui.Key.l
    help = f"Drag around what to select. {MODIFIERS}"

    def __init__(self) -> None:
        self._drag = LeftDrag()

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        state = self._drag.follow(viewport)
        if state in ("pressed", "dragged"):
            base.draw_polyline(viewport, self._drag.points)
            base.draw_faint_line(viewport, self._drag.points[-1], self._drag.points[0])
        elif state == "released":
            if self._drag.has_moved:
                pixels = screen.polygon(self._drag.points, viewport.width, viewport.height)
                take_shape(session, viewport, pixels, "lasso")
            self._drag.drop()
        return True

    def options(self, session: Editor) -> None:
        shape_options(session)


# Polygon


class PolygonTool:
    """Click corners; the first one, or Enter, closes. Deactivating the tool clears the corners."""

    name = "Polygon"
    icon = icons_fontawesome_6.ICON_FA_DRAW_POLYGON
    key: imgui.Key | None = imgui.Key.p
    help = f"Click corners; Enter or the first one closes, Backspace drops the last. {MODIFIERS}"

    def __init__(self) -> None:
        self._corners: list[tuple[float, float]] = []
        self._frame = -1

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        if imgui.get_frame_count() != self._frame + 1:
            self._corners.clear()
        self._frame = imgui.get_frame_count()
        closes = self._take_keys()
        if viewport.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            if len(self._corners) >= 3 and base.is_mouse_at(viewport, self._corners[0]):
                closes = True
            else:
                self._corners.append(viewport.mouse_px)
        if closes and len(self._corners) >= 3:
            pixels = screen.polygon(self._corners, viewport.width, viewport.height)
            take_shape(session, viewport, pixels, "polygon")
            self._corners.clear()
        self._show(viewport)
        return True

    def options(self, session: Editor) -> None:
        shape_options(session)
        same_line_if_fits(10)
        imgui.align_text_to_frame_padding()
        imgui.text_disabled("click corners, Enter closes" if self._corners else "click corners")
        imgui.set_item_tooltip("Enter or a click on the first corner closes; Backspace drops the last; Esc drops all.")

    def _take_keys(self) -> bool:
        if imgui.get_io().want_text_input:
            return False
        if imgui.is_key_pressed(imgui.Key.backspace) and self._corners:
            self._corners.pop()
        return imgui.is_key_pressed(imgui.Key.enter, False) or imgui.is_key_pressed(imgui.Key.keypad_enter, False)

    def _show(self, viewport: Viewport) -> None:
        if not self._corners:
            return
        if viewport.hovered:
            for end in {self._corners[0], self._corners[-1]}:
                base.draw_faint_line(viewport, end, viewport.mouse_px)
        base.draw_polyline(viewport, self._corners)
        for corner in self._corners:
            is_end = corner is self._corners[0] and len(self._corners) >= 3
            base.draw_knob(viewport, corner, is_lit=is_end and base.is_mouse_at(viewport, corner))


# Rectangle


class RectangleTool:
    """Drag from corner to corner."""

    name = "Rectangle"
    icon = icons_fontawesome_6.ICON_FA_VECTOR_SQUARE
    key: imgui.Key | None = imgui.Key.b
    help = f"Drag from corner to corner. {MODIFIERS}"

    def __init__(self) -> None:
        self._drag = LeftDrag()

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        state = self._drag.follow(viewport)
        if state in ("pressed", "dragged"):
            base.draw_rectangle(viewport, self._drag.points[0], self._drag.points[-1])
        elif state == "released":
            if self._drag.has_moved:
                ends = self._drag.points[0], self._drag.points[-1]
                pixels = screen.rectangle(*ends, viewport.width, viewport.height)
                take_shape(session, viewport, pixels, "rectangle")
            self._drag.drop()
        return True

    def options(self, session: Editor) -> None:
        shape_options(session)


# Flood and color pick


class FloodTool:
    """Click on a Gaussian to select connected ones of similar color."""

    name = "Flood"
    icon = icons_fontawesome_6.ICON_FA_FILL_DRIP
    key: imgui.Key | None = imgui.Key.g
    help = f"Click on what to select as far as it hangs together and looks alike. {MODIFIERS}"

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        options, picked = session.selecting, _clicked(session, viewport)
        if picked is not None:
            moment = viewport.shot.time_s
            found = flood_select(
                session.scene, moment, picked.key, picked.gaussian, options.tolerance, options.flood_reach
            )
            select(session, found, mode_now(session), "flood")
        return False

    def options(self, session: Editor) -> None:
        options = session.selecting
        mode_options(session)
        same_line_if_fits(9)
        tolerance_option(session)
        same_line_if_fits(9)
        imgui.set_next_item_width(9 * imgui.get_font_size())
        flags = imgui.SliderFlags_.always_clamp
        _, options.flood_reach = imgui.drag_float(
            "##reach", options.flood_reach, 0.05, 0.5, 20.0, "reach %.1f spacings", flags
        )
        imgui.set_item_tooltip(
            "Over how wide a gap the flood runs, in spacings: the distance to the eighth nearest alike Gaussian there."
        )


class ColorPickTool:
    """Click on a color to select it everywhere."""

    name = "Colour pick"
    icon = icons_fontawesome_6.ICON_FA_EYE_DROPPER
    key: imgui.Key | None = imgui.Key.i
    help = f"Click on a colour to select it everywhere. {MODIFIERS}"

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        picked = _clicked(session, viewport)
        if picked is not None:
            part = session.scene.part(session.scene.member(picked.key), viewport.shot.time_s)
            assert part is not None, "what was picked is there"
            color = base_color(part, picked.gaussian)
            found = select_similar_colors(session.scene, viewport.shot.time_s, color, session.selecting.tolerance)
            select(session, found, mode_now(session), "colour")
        return False

    def options(self, session: Editor) -> None:
        mode_options(session)
        same_line_if_fits(9)
        tolerance_option(session)


def _clicked(session: Editor, viewport: Viewport) -> PickResult | None:
    """Return the selectable Gaussian under a finished click, or None."""
    return pick(session.scene, viewport.shot, *viewport.mouse_px, is_selectable) if is_clicked(viewport) else None


_MODE_HELP: dict[Mode, str] = {
    "set": "Select what the tool finds, and nothing else.",
    "add": "Add what the tool finds (Shift).",
    "remove": "Take away what the tool finds (Ctrl or Alt).",
    "intersect": "Keep only what was selected and is found (Shift+Ctrl).",
}

_DEPTH_HELP = (
    "all through: everything behind the shape as well\n"
    "front-most: only what is seen, not what it hides\n"
    "to a depth: down to so many metres from the camera"
)


def mode_now(session: Editor) -> Mode:
    """Return the selection mode: from the held modifier keys, else as chosen in the bar."""
    io = imgui.get_io()
    removes = io.key_ctrl or io.key_alt
    if io.key_shift:
        return "intersect" if removes else "add"
    return "remove" if removes else session.selecting.mode


def take_shape(session: Editor, viewport: Viewport, pixels: np.ndarray, by: str) -> None:
    found = select_in_screen_shape(session.scene, viewport.shot, pixels, session.selecting.reach)
    select(session, found, mode_now(session), by)


def apply_volume(session: Editor, time_s: float, volume: Volume, by: str, *, now: bool = False) -> None:
    """Select the Gaussians in a volume, if Enter was pressed or `now`."""
    keys = (imgui.Key.enter, imgui.Key.keypad_enter)
    is_entered = not imgui.get_io().want_text_input and any(imgui.is_key_pressed(key, False) for key in keys)
    if now or is_entered:
        select(session, in_volume(session.scene, time_s, volume), mode_now(session), by)


def mode_options(session: Editor) -> None:
    """Draw the four selection modes; the current one is highlighted."""
    now = mode_now(session)
    for number, mode in enumerate(get_args(Mode)):
        if number:
            imgui.same_line(0, 2)
        lit = mode == now
        if lit:
            imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(imgui.Col_.button_active))
        if imgui.button(mode.capitalize()):
            session.selecting.mode = mode
        if lit:
            imgui.pop_style_color()
        imgui.set_item_tooltip(_MODE_HELP[mode])


def shape_options(session: Editor) -> None:
    options = session.selecting
    mode_options(session)
    same_line_if_fits(14)
    choices = get_args(Depths)
    imgui.set_next_item_width(7.5 * imgui.get_font_size())
    changed, picked = imgui.combo("##depths", choices.index(options.depths), list(choices))
    imgui.set_item_tooltip(_DEPTH_HELP)
    if changed:
        options.depths = choices[picked]
    if options.depths == "to a depth":
        same_line_if_fits(5.5)
        imgui.set_next_item_width(5.5 * imgui.get_font_size())
        _, options.depth_m = imgui.drag_float("##depth_m", options.depth_m, 0.1, 0.2, 2000.0, "%.1f m")
        imgui.set_item_tooltip("How deep, in metres from the camera along its view axis.")
    same_line_if_fits(6)
    _, options.touching = imgui.checkbox("Touching", options.touching)
    imgui.set_item_tooltip(
        "Take in Gaussians that the shape touches within one standard deviation, not only those whose centre it covers."
    )


def tolerance_option(session: Editor) -> None:
    options = session.selecting
    imgui.set_next_item_width(9 * imgui.get_font_size())
    flags = imgui.SliderFlags_.always_clamp
    _, options.tolerance = imgui.drag_float("##tolerance", options.tolerance, 0.005, 0, 1, "tolerance %.2f", flags)
    imgui.set_item_tooltip(
        "How far red, green and blue may each differ from the colour under the mouse, 0..1.\n"
        "Drag, or double-click to type."
    )


def volume_buttons(session: Editor, volume: Volume, name: str) -> bool:
    """Draw the buttons of a volume; returns True if it is to be removed."""
    same_line_if_fits(11)
    if imgui.button(f"Apply##{name}"):
        apply_volume(session, session.clock.time_s, volume, name, now=True)
    imgui.set_item_tooltip("Select what is inside (Enter), whether the camera sees it or not.")
    imgui.same_line()
    is_dropped = imgui.button(f"Drop##{name}")
    imgui.set_item_tooltip(f"Take the {name} away; the selection stays.")
    return is_dropped


def same_line_if_fits(width_em: float) -> None:
    """Continue on the same line, after a gap, if the width still fits; else on the next."""
    imgui.same_line(0, 10)
    if imgui.get_content_region_avail().x < width_em * imgui.get_font_size():
        imgui.new_line()
