"""Dialogs and tooltips: each fits into the window, and a tooltip leaves free what is read next."""

from imgui_bundle import ImVec2, imgui

from .text import key_names

_DIALOG_SHARE = 0.94, 0.9  # maximum width and height of a dialog, as shares of the window's
_TOOLTIP_EM, _TOOLTIP_SHARE = 36.0, 0.9
_ROW_EM = 3.0  # items that are higher are pictures and plots, over which a tooltip follows the mouse
_GAP = 4.0


def place_dialog(width_em: float, height_em: float = 0.0, cond: int = 0, pos_cond: int = imgui.Cond_.appearing) -> None:
    """Center the next window, in the widths of a letter m; it scrolls where its content does not fit.

    A height of 0 is that of the content. `cond` is that of the size.
    """
    em, screen = imgui.get_font_size(), imgui.get_main_viewport()
    widest, highest = (share * side for share, side in zip(_DIALOG_SHARE, (screen.size.x, screen.size.y), strict=True))
    imgui.set_next_window_size(ImVec2(min(width_em * em, widest), min(height_em * em, highest)), cond)
    imgui.set_next_window_size_constraints(ImVec2(0, 0), ImVec2(widest, highest))
    imgui.set_next_window_pos(screen.get_center(), pos_cond, ImVec2(0.5, 0.5))


def free_height(below: float) -> float:
    """Height in pixels that a list in a dialog may have, with so much for everything else."""
    return _DIALOG_SHARE[1] * imgui.get_main_viewport().size.y - below


def install_tooltips() -> None:
    """Let Dear ImGui's tooltips of text wrap their lines, name the keys of this system, and lie above their item."""
    imgui.set_item_tooltip, imgui.set_tooltip = _item_tooltip, _tooltip


def _item_tooltip(text: str) -> None:
    """Draw a tooltip above the last item if the mouse rests on it; where there is no room, below the next row."""
    if not imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
        return
    low, high, screen = imgui.get_item_rect_min(), imgui.get_item_rect_max(), imgui.get_main_viewport()
    if high.y - low.y < _ROW_EM * imgui.get_font_size():
        padding = imgui.get_style().window_padding
        size = imgui.calc_text_size(key_names(text), False, _wrap_px())
        wide, tall = size.x + 2 * padding.x, size.y + 2 * padding.y
        x = max(min(low.x, screen.pos.x + screen.size.x - wide), screen.pos.x)
        above, below = low.y - _GAP - tall, high.y + imgui.get_frame_height_with_spacing() + _GAP
        if above >= screen.pos.y:
            imgui.set_next_window_pos(ImVec2(x, above))
        elif below + tall <= screen.pos.y + screen.size.y:
            imgui.set_next_window_pos(ImVec2(x, below))
    _tooltip(text)


def _tooltip(text: str) -> None:
    """Draw a tooltip in place of earlier ones of this frame, at the mouse unless the next window has a place."""
    if imgui.internal.begin_tooltip_ex(imgui.internal.TooltipFlags_.override_previous, 0):
        imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + _wrap_px())
        imgui.text_unformatted(key_names(text))
        imgui.pop_text_wrap_pos()
        imgui.end_tooltip()


def _wrap_px() -> float:
    padding = imgui.get_style().window_padding.x
    return min(_TOOLTIP_EM * imgui.get_font_size(), _TOOLTIP_SHARE * imgui.get_main_viewport().size.x - 2 * padding)
