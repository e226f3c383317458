"""Selection tools on the screen: brush, lasso, polygon, rectangle, flood and color pick."""

from typing import get_args

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Bool

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import is_editable
from gsrain_engine.editor.selection import screen
from gsrain_engine.editor.selection.candidates import Found, Mode, base_color, select_similar_colors
from gsrain_engine.editor.selection.commands import select
from gsrain_engine.editor.selection.volume import flood_select
from gsrain_engine.editor.viewport.picking import PickResult, pick

from ..widgets.draw import Viewport, is_clicked
from . import base
from .base import same_line_if_fits

MODIFIERS = "Shift adds, Ctrl removes, both intersect."
_DEPTH_HELP = (
    "all through: everything behind the shape as well\n"
    "front-most: only what is seen, not what it hides\n"
    "to a depth: down to so many meters from the camera"
)


class ShapeTool(base.DragTool):
    """A shape drawn with the left button; the release selects the Gaussians in it."""

    selects_by_click = False

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        state = self.follow_drag(viewport)
        if state in ("pressed", "dragged"):
            self.outline(session, viewport)
        elif state == "released" and (self.has_moved or self.selects_by_click):
            self.select(session, viewport)
        return True

    def outline(self, session: Editor, viewport: Viewport) -> None:
        raise NotImplementedError

    def mask(self, session: Editor, width: int, height: int) -> Bool[np.ndarray, "h w"]:
        """Pixels of the shape in a viewport of a size."""
        raise NotImplementedError

    def select(self, session: Editor, viewport: Viewport) -> None:
        pixels = self.mask(session, viewport.width, viewport.height)
        found = screen.select_in_screen_shape(session.scene, viewport.shot, pixels, session.selecting.reach)
        select(session, found, mode_now(session), self.name.lower())

    def options(self, session: Editor) -> None:
        options = session.selecting
        mode_options(session)
        same_line_if_fits(14)
        choices = get_args(screen.Depths)
        imgui.set_next_item_width(7.5 * imgui.get_font_size())
        changed, picked = imgui.combo("##depths", choices.index(options.depths), list(choices))
        imgui.set_item_tooltip(_DEPTH_HELP)
        if changed:
            options.depths = choices[picked]
        if options.depths == "to a depth":
            same_line_if_fits(5.5)
            help_text = "How deep, in meters from the camera along its view axis."
            _, options.depth_m = base.drag_number(
                "##depth_m", options.depth_m, 0.1, (0.2, 2000.0), "%.1f m", help_text, 5.5, flags=0
            )
        same_line_if_fits(6)
        _, options.touching = imgui.checkbox("Touching", options.touching)
        imgui.set_item_tooltip(
            "Take in Gaussians that the shape touches within one standard deviation, not only those whose center it "
            "covers."
        )


class RectangleTool(ShapeTool):
    """Drag from corner to corner."""

    name = "Rectangle"
    icon = icons_fontawesome_6.ICON_FA_VECTOR_SQUARE
    key = imgui.Key.b
    help = f"Drag from corner to corner. {MODIFIERS}"

    def outline(self, session: Editor, viewport: Viewport) -> None:
        base.draw_rectangle(viewport, self.points[0], self.points[-1])

    def mask(self, session: Editor, width: int, height: int) -> Bool[np.ndarray, "h w"]:
        return screen.rectangle(self.points[0], self.points[-1], width, height)


class LassoTool(ShapeTool):
    """Drag around the Gaussians to select."""

    name = "Lasso"
    icon = icons_fontawesome_6.ICON_FA_PENCIL
    key = imgui.Key.l
    help = f"Drag around what to select. {MODIFIERS}"

    def outline(self, session: Editor, viewport: Viewport) -> None:
        base.draw_polyline(viewport, self.points)
        base.draw_faint_line(viewport, self.points[-1], self.points[0])

    def mask(self, session: Editor, width: int, height: int) -> Bool[np.ndarray, "h w"]:
        return screen.polygon(self.points, width, height)


class PolygonTool(LassoTool):
    """Click corners; the first one, or Enter, closes. Deactivating the tool clears the corners."""

    name = "Polygon"
    icon = icons_fontawesome_6.ICON_FA_DRAW_POLYGON
    key = imgui.Key.p
    help = f"Click corners; Enter or the first one closes, Backspace drops the last. {MODIFIERS}"

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        corners = () if self.is_resumed() else self.points
        closes = False
        if not imgui.get_io().want_text_input:
            if imgui.is_key_pressed(imgui.Key.backspace):
                corners = corners[:-1]
            closes = any(imgui.is_key_pressed(key, False) for key in (imgui.Key.enter, imgui.Key.keypad_enter))
        if viewport.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            if len(corners) >= 3 and _is_mouse_at(viewport, corners[0]):
                closes = True
            else:
                corners = (*corners, viewport.mouse_px)
        self.points = corners
        if closes and len(corners) >= 3:
            self.select(session, viewport)
            self.points = ()
        if self.points:
            self.outline(session, viewport)
        return True

    def outline(self, session: Editor, viewport: Viewport) -> None:
        if viewport.hovered:
            for end in {self.points[0], self.points[-1]}:
                base.draw_faint_line(viewport, end, viewport.mouse_px)
        base.draw_polyline(viewport, self.points)
        draw = imgui.get_window_draw_list()
        for corner in self.points:
            closes = corner is self.points[0] and len(self.points) >= 3 and _is_mouse_at(viewport, corner)
            center = viewport.on_screen(*corner)
            draw.add_circle_filled(center, _KNOB_PX if closes else _KNOB_PX - 2, imgui.get_color_u32(base.DARK))
            draw.add_circle_filled(center, _KNOB_PX - (2 if closes else 3.5), imgui.get_color_u32(base.LIGHT))

    def options(self, session: Editor) -> None:
        super().options(session)
        same_line_if_fits(10)
        imgui.align_text_to_frame_padding()
        imgui.text_disabled("click corners, Enter closes" if self.points else "click corners")
        imgui.set_item_tooltip("Enter or a click on the first corner closes; Backspace drops the last; Esc drops all.")


_KNOB_PX = 7.0  # half the width of a corner's knob


def _is_mouse_at(viewport: Viewport, at: base.Pixel) -> bool:
    x, y = viewport.mouse_px
    return max(abs(x - at[0]), abs(y - at[1])) <= _KNOB_PX + 2


class BrushTool(ShapeTool):
    """Paint with a disc."""

    name = "Brush"
    icon = icons_fontawesome_6.ICON_FA_PAINTBRUSH
    key = imgui.Key.n
    help = f"Paint over what to select; [ and ] change the brush. {MODIFIERS}"
    selects_by_click = True

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        options, io = session.selecting, imgui.get_io()
        if not (io.want_text_input or io.key_ctrl):
            for key, factor in ((imgui.Key.left_bracket, 1 / _STEP), (imgui.Key.right_bracket, _STEP)):
                if imgui.is_key_pressed(key):
                    options.brush_radius_px = min(max(options.brush_radius_px * factor, _RADII_PX[0]), _RADII_PX[1])
        super().draw(session, viewport)
        if viewport.hovered or viewport.active:
            draw, at = imgui.get_window_draw_list(), viewport.on_screen(*viewport.mouse_px)
            for color, width in ((base.DARK, 3.5), (base.LIGHT, 1.5)):
                draw.add_circle(at, options.brush_radius_px, imgui.get_color_u32(color), 0, width)
        return True

    def outline(self, session: Editor, viewport: Viewport) -> None:
        for edge in screen.outlines(self.mask(session, viewport.width, viewport.height)):
            base.draw_polyline(viewport, edge.tolist(), closed=True)

    def mask(self, session: Editor, width: int, height: int) -> Bool[np.ndarray, "h w"]:
        return screen.stroke(self.points, session.selecting.brush_radius_px, width, height)

    def options(self, session: Editor) -> None:
        options = session.selecting
        super().options(session)
        same_line_if_fits(7)
        help_text = "Radius of the brush in pixels ([ and ])."
        _, options.brush_radius_px = base.drag_number(
            "##radius", options.brush_radius_px, 0.5, _RADII_PX, "radius %.0f px", help_text, 7
        )


_RADII_PX = 2.0, 300.0
_STEP = 1.2

# Gaussians alike the one under the mouse


class ColorPickTool(base.Tool):
    """Click on a color to select it everywhere."""

    name = "Color pick"
    icon = icons_fontawesome_6.ICON_FA_EYE_DROPPER
    key = imgui.Key.i
    help = f"Click on a color to select it everywhere. {MODIFIERS}"
    by = "color"

    def draw(self, session: Editor, viewport: Viewport) -> bool:
        if is_clicked(viewport):
            picked = pick(session.scene, viewport.shot, *viewport.mouse_px, is_editable)
            if picked is not None:
                select(session, self.find(session, picked, viewport.shot.time_s), mode_now(session), self.by)
        return False

    def find(self, session: Editor, picked: PickResult, time_s: float) -> Found:
        part = session.scene.part(session.scene.member(picked.key), time_s)
        assert part is not None, "what was picked is there"
        color = base_color(part, picked.gaussian)
        return select_similar_colors(session.scene, time_s, color, session.selecting.tolerance)

    def options(self, session: Editor) -> None:
        options = session.selecting
        mode_options(session)
        same_line_if_fits(9)
        help_text = (
            "How far red, green and blue may each differ from the color under the mouse, 0..1.\n"
            "Drag, or double-click to type."
        )
        _, options.tolerance = base.drag_number(
            "##tolerance", options.tolerance, 0.005, (0, 1), "tolerance %.2f", help_text, 9
        )


class FloodTool(ColorPickTool):
    """Click on a Gaussian to select connected ones of similar color."""

    name = "Flood"
    icon = icons_fontawesome_6.ICON_FA_FILL_DRIP
    key = imgui.Key.g
    help = f"Click on what to select as far as it hangs together and looks alike. {MODIFIERS}"
    by = "flood"

    def find(self, session: Editor, picked: PickResult, time_s: float) -> Found:
        options = session.selecting
        return flood_select(session.scene, time_s, picked.key, picked.gaussian, options.tolerance, options.flood_reach)

    def options(self, session: Editor) -> None:
        options = session.selecting
        super().options(session)
        same_line_if_fits(9)
        help_text = (
            "Over how wide a gap the flood runs, in spacings: the distance to the eighth nearest alike Gaussian there."
        )
        _, options.flood_reach = base.drag_number(
            "##reach", options.flood_reach, 0.05, (0.5, 20.0), "reach %.1f spacings", help_text, 9
        )


# Modes

_MODE_HELP: dict[Mode, str] = {
    "set": "Select what the tool finds, and nothing else.",
    "add": "Add what the tool finds (Shift).",
    "remove": "Take away what the tool finds (Ctrl or Alt).",
    "intersect": "Keep only what was selected and is found (Shift+Ctrl).",
}


def mode_now(session: Editor) -> Mode:
    """Return the selection mode: from the held modifier keys, else as chosen in the bar."""
    io = imgui.get_io()
    removes = io.key_ctrl or io.key_alt
    if io.key_shift:
        return "intersect" if removes else "add"
    return "remove" if removes else session.selecting.mode


def mode_options(session: Editor) -> None:
    """Draw the four selection modes; the current one is highlighted."""
    now = mode_now(session)
    for number, (mode, help_text) in enumerate(_MODE_HELP.items()):
        if number:
            imgui.same_line(0, 2)
        color = imgui.get_style_color_vec4(imgui.Col_.button_active if mode == now else imgui.Col_.button)
        imgui.push_style_color(imgui.Col_.button, color)
        if imgui.button(mode.capitalize()):
            session.selecting.mode = mode
        imgui.pop_style_color()
        imgui.set_item_tooltip(help_text)
