"""What stands over the picture while something is awaited, and quietly in a corner where something went wrong."""

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.session.session import Session

_WIDTH_EM = 34.0
_MARGIN = 10.0


def draw_notice(session: Session, corner: ImVec2, width: int, height: int) -> None:
    """Draw a bar that moves while a scene is opened, and say what went wrong; nothing at other times."""
    if session.busy is not None:
        _busy(session.busy, corner, width, height)
    if session.problem is not None:
        _problem(session, session.problem, corner, width, height)


def _busy(words: str, corner: ImVec2, width: int, height: int) -> None:
    wide = min(_WIDTH_EM * imgui.get_font_size(), width - 2 * _MARGIN)
    imgui.set_cursor_screen_pos(ImVec2(corner.x + (width - wide) / 2, corner.y + 0.4 * height))
    if _begin("busy", wide):
        imgui.text_wrapped(words)
        imgui.progress_bar(-imgui.get_time(), ImVec2(-1, 0), "")
    _end()


def _problem(session: Session, problem: str, corner: ImVec2, width: int, height: int) -> None:
    wide = min(_WIDTH_EM * imgui.get_font_size(), width - 2 * _MARGIN)
    padding = imgui.get_style().window_padding
    words = f"{icons_fontawesome_6.ICON_FA_TRIANGLE_EXCLAMATION}  {problem}"
    text_height = imgui.calc_text_size(words, False, wide - 2 * padding.x).y
    tall = text_height + 2 * padding.y + imgui.get_frame_height_with_spacing()
    at = ImVec2(corner.x + width - wide - _MARGIN, corner.y + height - tall - _MARGIN)
    imgui.set_cursor_screen_pos(at)
    if _begin("problem", wide):
        imgui.push_style_color(imgui.Col_.text, (0.95, 0.45, 0.38, 1.0))
        imgui.text_wrapped(words)
        imgui.pop_style_color()
        if imgui.button("Close"):
            session.problem = None
        imgui.same_line()
        if imgui.button("Details"):
            imgui.set_window_focus("Log")
        imgui.set_item_tooltip("Show the log, which has the rest.")
        imgui.same_line()
        if imgui.button("Copy"):
            imgui.set_clipboard_text(problem)
        imgui.set_item_tooltip("Put the sentence on the clipboard.")
    _end()


def _begin(name: str, wide: float) -> bool:
    color = imgui.get_style_color_vec4(imgui.Col_.popup_bg)
    imgui.push_style_color(imgui.Col_.child_bg, (color.x, color.y, color.z, 0.94))
    imgui.push_style_var(imgui.StyleVar_.child_rounding, 5.0)
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.borders
    return imgui.begin_child(name, ImVec2(wide, 0), flags)


def _end() -> None:
    imgui.end_child()
    imgui.pop_style_var()
    imgui.pop_style_color()
