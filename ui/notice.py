"""What stands over the picture while a scene is opened, and where something went wrong."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.session import Session

_WIDTH_EM = 34.0


def draw_notice(session: Session, corner: ImVec2, width: int, height: int) -> None:
    """Draw a bar that moves while a scene is opened, and say what went wrong; nothing at other times."""
    busy, problem = session.busy, session.problem
    if busy is None and problem is None:
        return
    wide = min(_WIDTH_EM * imgui.get_font_size(), width - 20.0)
    imgui.set_cursor_screen_pos(ImVec2(corner.x + (width - wide) / 2, corner.y + 0.4 * height))
    imgui.push_style_color(imgui.Col_.child_bg, (0.08, 0.08, 0.09, 0.92))
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.borders
    if imgui.begin_child("notice", ImVec2(wide, 0), flags):
        if busy is not None:
            imgui.text_wrapped(busy)
            imgui.progress_bar(-imgui.get_time(), ImVec2(-1, 0), "")
        elif problem is not None:
            imgui.push_style_color(imgui.Col_.text, (1.0, 0.6, 0.55, 1.0))
            imgui.text_wrapped(problem)
            imgui.pop_style_color()
            if imgui.button("Close"):
                session.problem = None
    imgui.end_child()
    imgui.pop_style_color()
