"""The Log panel: what the program has said, newest at the bottom."""

import logging

from imgui_bundle import ImVec4, imgui

from gsrain_engine.session.session import Session

_ERROR, _WARNING = ImVec4(1.0, 0.45, 0.4, 1.0), ImVec4(1.0, 0.72, 0.3, 1.0)


def log_panel(session: Session) -> None:
    """Draw the panel."""
    imgui.push_text_wrap_pos(0.0)
    for level, text in session.log.lines:
        if level >= logging.ERROR:
            imgui.text_colored(_ERROR, text)
        elif level >= logging.WARNING:
            imgui.text_colored(_WARNING, text)
        else:
            imgui.text_unformatted(text)
    imgui.pop_text_wrap_pos()
    if imgui.get_scroll_y() >= imgui.get_scroll_max_y():
        imgui.set_scroll_here_y(1.0)
