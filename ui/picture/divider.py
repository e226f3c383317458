"""The line between two pictures: dragged to either side, centred by a double click."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session

_HALF_GRIP = 6.0
_MARGIN = 8.0


def draw_divider(session: Session, labels: tuple[str, str], corner: ImVec2, width: int, height: int) -> None:
    """Draw the line between what is labelled so, over the picture at a corner of the screen, and let it be moved."""
    view = session.view
    x = corner.x + view.divider * width
    imgui.set_cursor_screen_pos(ImVec2(x - _HALF_GRIP, corner.y))
    imgui.invisible_button("divider", ImVec2(2 * _HALF_GRIP, height))
    held, hovered = imgui.is_item_active(), imgui.is_item_hovered()
    if held or hovered:
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
    if held:
        view.divider = min(max(view.divider + imgui.get_io().mouse_delta.x / width, 0.0), 1.0)
    if hovered and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        view.divider = 0.5
    _line_and_labels(session, labels, corner, width, height, bright=held or hovered)


def _line_and_labels(
    session: Session, labels: tuple[str, str], corner: ImVec2, width: int, height: int, *, bright: bool
) -> None:
    left, right = labels
    x = corner.x + session.view.divider * width
    draw = imgui.get_window_draw_list()
    draw.push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height), True)
    color = imgui.get_color_u32((1.0, 1.0, 1.0, 1.0 if bright else 0.75))
    draw.add_line(ImVec2(x, corner.y), ImVec2(x, corner.y + height), color, 2.0)
    draw.add_circle_filled(ImVec2(x, corner.y + height / 2), 7.0, color)
    size = imgui.calc_text_size(left)
    _label(draw, left, ImVec2(x - size.x - 2 * _MARGIN, corner.y + _MARGIN))
    _label(draw, right, ImVec2(x + 2 * _MARGIN, corner.y + _MARGIN))
    draw.pop_clip_rect()


def _label(draw: imgui.ImDrawList, text: str, at: ImVec2) -> None:
    size = imgui.calc_text_size(text)
    dark = imgui.get_color_u32((0.0, 0.0, 0.0, 0.55))
    draw.add_rect_filled(ImVec2(at.x - 5, at.y - 2), ImVec2(at.x + size.x + 5, at.y + size.y + 2), dark, 3.0)
    draw.add_text(at, imgui.get_color_u32((1.0, 1.0, 1.0, 0.95)), text)
