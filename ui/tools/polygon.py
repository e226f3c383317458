"""Select by corners clicked around things."""

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.session.selection import image_shapes
from gsrain_engine.session.session import Session

from ..widgets.viewport import Viewport
from . import outline
from .selecting import MODIFIERS, beside, shape_options, take_shape


class PolygonTool:
    """Click corners; the first one, or Enter, closes. The corners go when the tool is put away."""

    name = "Polygon"
    icon = icons_fontawesome_6.ICON_FA_DRAW_POLYGON
    key: imgui.Key | None = imgui.Key.p
    help = f"Click corners; Enter or the first one closes, Backspace drops the last. {MODIFIERS}"

    def __init__(self) -> None:
        self._corners: list[tuple[float, float]] = []
        self._frame = -1

    def draw(self, session: Session, viewport: Viewport) -> bool:
        if imgui.get_frame_count() != self._frame + 1:
            self._corners.clear()
        self._frame = imgui.get_frame_count()
        closes = self._take_keys()
        if viewport.hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            if len(self._corners) >= 3 and outline.is_at(viewport, self._corners[0]):
                closes = True
            else:
                self._corners.append(viewport.mouse_px)
        if closes and len(self._corners) >= 3:
            pixels = image_shapes.polygon(self._corners, viewport.width, viewport.height)
            take_shape(session, viewport, pixels, "polygon")
            self._corners.clear()
        self._show(viewport)
        return True

    def options(self, session: Session) -> None:
        shape_options(session)
        beside(10)
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
                outline.faint(viewport, end, viewport.mouse_px)
        outline.line(viewport, self._corners)
        for corner in self._corners:
            is_end = corner is self._corners[0] and len(self._corners) >= 3
            outline.knob(viewport, corner, is_lit=is_end and outline.is_at(viewport, corner))
