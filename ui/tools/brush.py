"""Select by painting over things."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.selection import image_shapes
from gsrain_engine.session.session import Session

from ..widgets.viewport import Viewport
from . import outline
from .left_drag import LeftDrag
from .selecting import MODIFIERS, beside, shape_options, take_shape

_LEAST_PX, _MOST_PX = 2.0, 300.0
_STEP = 1.2


class BrushTool:
    """Paint with a disc."""

    name = "Brush"
    icon = icons_fontawesome_6.ICON_FA_PAINTBRUSH
    key: imgui.Key | None = imgui.Key.n
    help = f"Paint over what to select; [ and ] change the brush. {MODIFIERS}"

    def __init__(self) -> None:
        self._drag = LeftDrag()

    def draw(self, session: Session, viewport: Viewport) -> bool:
        options = session.selecting
        if not (imgui.get_io().want_text_input or imgui.get_io().key_ctrl):
            for key, factor in ((imgui.Key.left_bracket, 1 / _STEP), (imgui.Key.right_bracket, _STEP)):
                if imgui.is_key_pressed(key):
                    options.brush_radius_px = min(max(options.brush_radius_px * factor, _LEAST_PX), _MOST_PX)
        state = self._drag.follow(viewport)
        if state != "none":
            size = viewport.width, viewport.height
            pixels = image_shapes.stroke(self._drag.points, options.brush_radius_px, *size)
            if state == "released":
                take_shape(session, viewport, pixels, "brush")
                self._drag.drop()
            else:
                for edge in image_shapes.outlines(pixels):
                    outline.line(viewport, edge.tolist(), closed=True)
        if viewport.hovered or viewport.active:
            outline.ring(viewport, viewport.mouse_px, options.brush_radius_px)
        return True

    def options(self, session: Session) -> None:
        options = session.selecting
        shape_options(session)
        beside(7)
        imgui.set_next_item_width(7 * imgui.get_font_size())
        flags = imgui.SliderFlags_.always_clamp
        _, options.brush_radius_px = imgui.drag_float(
            "##radius", options.brush_radius_px, 0.5, _LEAST_PX, _MOST_PX, "radius %.0f px", flags
        )
        imgui.set_item_tooltip("Radius of the brush in pixels ([ and ]).")
