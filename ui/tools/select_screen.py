"""Selection tools on the screen: brush, lasso, polygon, rectangle, flood and color pick."""

from typing import Any, get_args

import numpy as np
from imgui_bundle import icons_fontawesome_6, imgui
from jaxtyping import Bool

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.edits.members import is_editable
from gsrain_engine.editor.selection import screen
from gsrain_engine.editor.selection.candidates import Mode, base_color, select_similar_colors
from gsrain_engine.editor.selection.commands import SelectionTool
from gsrain_engine.editor.selection.volume import flood_select
from gsrain_engine.editor.viewport.picking import PickResult, pick

from ..widgets.draw import Canvas, is_clicked
from ..widgets.fields import same_line_if_room
from ..widgets.type_ahead import combo_box
from . import base

MODIFIERS = "Shift adds, Ctrl removes, both intersect."
_DEPTH_HELP = (
    "all through: everything behind the shape as well\n"
    "front-most: only what is seen, not what it hides\n"
    "to a depth: down to so many meters from the camera"
)


class ShapeTool(base.DragTool):
    """A shape drawn with the left button; the release selects the Gaussians in it."""

    selects_by_click = False

    def __init__(self, selection: SelectionTool) -> None:
        self._selection = selection

    def draw(self, canvas: Canvas) -> bool:
        state = self.follow_drag(canvas)
        if state in ("pressed", "dragged"):
            self.outline(canvas)
        elif state == "released" and (self.has_moved or self.selects_by_click):
            self.select(canvas)
        return True

    def outline(self, canvas: Canvas) -> None:
        raise NotImplementedError

    def mask(self, width: int, height: int) -> Bool[np.ndarray, "h w"]:
        """Pixels of the shape in a viewport of a size."""
        raise NotImplementedError

    def select(self, canvas: Canvas) -> None:
        pixels = self.mask(canvas.width, canvas.height)
        shape = canvas.shot, pixels, self._selection.reach
        self._selection.select(mode_now(self._selection), self.name.lower(), screen.select_in_screen_shape, *shape)

    def options(self) -> None:
        options = self._selection
        mode_options(self._selection)
        same_line_if_room(14)
        choices = get_args(screen.Depths)
        imgui.set_next_item_width(7.5 * imgui.get_font_size())
        changed, picked = combo_box("##depths", choices.index(options.depths), list(choices))
        imgui.set_item_tooltip(_DEPTH_HELP)
        if changed:
            options.depths = choices[picked]
        if options.depths == "to a depth":
            same_line_if_room(5.5)
            help_text = "How deep, in meters from the camera along its view axis."
            _, options.depth_m = base.drag_number(
                "##depth_m", options.depth_m, 0.005 * options.depth_m, (0.02, 2000.0), "%.3g m", help_text, 5.5, flags=0
            )
        same_line_if_room(6)
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

    def outline(self, canvas: Canvas) -> None:
        base.draw_rectangle(canvas, self.points[0], self.points[-1])

    def mask(self, width: int, height: int) -> Bool[np.ndarray, "h w"]:
        return screen.rectangle(self.points[0], self.points[-1], width, height)


class LassoTool(ShapeTool):
    """Drag around the Gaussians to select."""

    name = "Lasso"
    icon = icons_fontawesome_6.ICON_FA_PENCIL
    key = imgui.Key.l
    help = f"Drag around what to select. {MODIFIERS}"

    def outline(self, canvas: Canvas) -> None:
        base.draw_polyline(canvas, self.points)
        base.draw_faint_line(canvas, self.points[-1], self.points[0])

    def mask(self, width: int, height: int) -> Bool[np.ndarray, "h w"]:
        return screen.polygon(self.points, width, height)


class PolygonTool(LassoTool):
    """Click corners; the first one, or Enter, closes. Deactivating the tool clears the corners."""

    name = "Polygon"
    icon = icons_fontawesome_6.ICON_FA_DRAW_POLYGON
    key = imgui.Key.p
    help = f"Click corners; Enter or the first one closes, Backspace drops the last. {MODIFIERS}"

    def draw(self, canvas: Canvas) -> bool:
        corners = () if self.is_resumed() else self.points
        closes = False
        if not imgui.get_io().want_text_input:
            if imgui.is_key_pressed(imgui.Key.backspace):
                corners = corners[:-1]
            closes = any(imgui.is_key_pressed(key, False) for key in (imgui.Key.enter, imgui.Key.keypad_enter))
        if canvas.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            if len(corners) >= 3 and canvas.is_mouse_near(corners[0], _KNOB_PX + 2):
                closes = True
            else:
                corners = (*corners, canvas.mouse_px)
        self.points = corners
        if closes and len(corners) >= 3:
            self.select(canvas)
            self.points = ()
        if self.points:
            self.outline(canvas)
        return True

    def outline(self, canvas: Canvas) -> None:
        if canvas.hovered:
            for end in {self.points[0], self.points[-1]}:
                base.draw_faint_line(canvas, end, canvas.mouse_px)
        base.draw_polyline(canvas, self.points)
        draw = imgui.get_window_draw_list()
        for corner in self.points:
            closes = corner is self.points[0] and len(self.points) >= 3 and canvas.is_mouse_near(corner, _KNOB_PX + 2)
            center = canvas.on_screen(*corner)
            draw.add_circle_filled(center, _KNOB_PX if closes else _KNOB_PX - 2, imgui.get_color_u32(base.DARK))
            draw.add_circle_filled(center, _KNOB_PX - (2 if closes else 3.5), imgui.get_color_u32(base.LIGHT))

    def options(self) -> None:
        super().options()
        same_line_if_room(10)
        imgui.align_text_to_frame_padding()
        imgui.text_disabled("click corners, Enter closes" if self.points else "click corners")
        imgui.set_item_tooltip("Enter or a click on the first corner closes; Backspace drops the last; Esc drops all.")


_KNOB_PX = 7.0  # half the width of a corner's knob


class BrushTool(ShapeTool):
    """Paint with a disc."""

    name = "Brush"
    icon = icons_fontawesome_6.ICON_FA_PAINTBRUSH
    key = imgui.Key.n
    help = f"Paint over what to select; [ and ] change the brush. {MODIFIERS}"
    selects_by_click = True

    def draw(self, canvas: Canvas) -> bool:
        options, io = self._selection, imgui.get_io()
        if not (io.want_text_input or io.key_ctrl):
            for key, factor in ((imgui.Key.left_bracket, 1 / _STEP), (imgui.Key.right_bracket, _STEP)):
                if imgui.is_key_pressed(key):
                    options.brush_radius_px = min(max(options.brush_radius_px * factor, _RADII_PX[0]), _RADII_PX[1])
        super().draw(canvas)
        if canvas.hovered or canvas.active:
            draw, at = imgui.get_window_draw_list(), canvas.on_screen(*canvas.mouse_px)
            for color, width in ((base.DARK, 3.5), (base.LIGHT, 1.5)):
                draw.add_circle(at, options.brush_radius_px, imgui.get_color_u32(color), 0, width)
        return True

    def outline(self, canvas: Canvas) -> None:
        for edge in screen.outlines(self.mask(canvas.width, canvas.height)):
            base.draw_polyline(canvas, edge.tolist(), closed=True)

    def mask(self, width: int, height: int) -> Bool[np.ndarray, "h w"]:
        return screen.stroke(self.points, self._selection.brush_radius_px, width, height)

    def options(self) -> None:
        options = self._selection
        super().options()
        same_line_if_room(7)
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

    def __init__(self, document: Document, selection: SelectionTool) -> None:
        self._document, self._selection = document, selection

    def draw(self, canvas: Canvas) -> bool:
        if is_clicked(canvas):
            picked = pick(self._document.scene, canvas.shot, *canvas.mouse_px, is_editable)
            if picked is not None:
                self._selection.select(mode_now(self._selection), self.by, *self.search(picked, canvas.shot.time_s))
        return False

    def search(self, picked: PickResult, time_s: float) -> tuple[Any, ...]:
        """Function that finds Gaussians like the picked one, and its arguments."""
        part = self._document.scene.part(self._document.scene.member(picked.key), time_s)
        assert part is not None, "what was picked is there"
        return select_similar_colors, time_s, base_color(part, picked.gaussian), self._selection.tolerance

    def options(self) -> None:
        options = self._selection
        mode_options(self._selection)
        same_line_if_room(9)
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

    def search(self, picked: PickResult, time_s: float) -> tuple[Any, ...]:
        limits = self._selection.tolerance, self._selection.flood_reach
        return flood_select, time_s, picked.key, picked.gaussian, *limits

    def options(self) -> None:
        options = self._selection
        super().options()
        same_line_if_room(9)
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


def mode_now(selection: SelectionTool) -> Mode:
    """Return the selection mode: from the held modifier keys, else as chosen in the bar."""
    io = imgui.get_io()
    removes = io.key_ctrl or io.key_alt
    if io.key_shift:
        return "intersect" if removes else "add"
    return "remove" if removes else selection.mode


def mode_options(selection: SelectionTool) -> None:
    """Draw the four selection modes; the current one is highlighted."""
    now = mode_now(selection)
    for number, (mode, help_text) in enumerate(_MODE_HELP.items()):
        if number:
            imgui.same_line(0, 2)
        color = imgui.get_style_color_vec4(imgui.Col_.button_active if mode == now else imgui.Col_.button)
        imgui.push_style_color(imgui.Col_.button, color)
        if imgui.button(mode.capitalize()):
            selection.mode = mode
        imgui.pop_style_color()
        imgui.set_item_tooltip(help_text)
