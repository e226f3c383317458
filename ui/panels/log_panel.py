"""The Log panel: what the program has said, newest at the bottom, narrowed by level and words."""

import logging

from imgui_bundle import ImVec2, ImVec4, imgui

from gsrain_engine.session.log import LogLine
from gsrain_engine.session.session import Session

_COLORS = {logging.ERROR: ImVec4(0.95, 0.45, 0.38, 1.0), logging.WARNING: ImVec4(0.9, 0.62, 0.2, 1.0)}
_LEVELS = {"all": logging.INFO, "warnings": logging.WARNING, "errors": logging.ERROR}


class _Filter:
    """What is shown."""

    level = "all"
    words = ""


def log_panel(session: Session) -> None:
    imgui.set_next_item_width(7 * imgui.get_font_size())
    names = list(_LEVELS)
    changed, picked = imgui.combo("##level", names.index(_Filter.level), names)
    if changed:
        _Filter.level = names[picked]
    imgui.set_item_tooltip("Show everything, or only what may be wrong.")
    imgui.same_line()
    copy_width = imgui.calc_text_size("Copy").x + 4 * imgui.get_style().frame_padding.x
    imgui.set_next_item_width(-copy_width)
    _, _Filter.words = imgui.input_text_with_hint("##words", "words", _Filter.words)
    imgui.set_item_tooltip("Show only lines with these words.")
    shown = [line for line in session.log.lines if _is_shown(line)]
    imgui.same_line()
    if imgui.button("Copy"):
        imgui.set_clipboard_text("\n".join(f"{line.at:%H:%M:%S} {line.text}\n{line.details}".strip() for line in shown))
    imgui.set_item_tooltip("Put these lines on the clipboard, with their details.")
    if imgui.begin_child("lines", ImVec2(0, 0)):
        for number, line in enumerate(shown):
            _line(line, number)
        if not shown:
            imgui.text_disabled("Nothing was said so." if session.log.lines else "Nothing has been said yet.")
        if imgui.get_scroll_y() >= imgui.get_scroll_max_y():
            imgui.set_scroll_here_y(1.0)
    imgui.end_child()


def _is_shown(line: LogLine) -> bool:
    text = f"{line.text} {line.details}".lower()
    return line.level >= _LEVELS[_Filter.level] and all(word in text for word in _Filter.words.lower().split())


def _line(line: LogLine, number: int) -> None:
    imgui.text_disabled(f"{line.at:%H:%M:%S}")
    imgui.same_line()
    color = next((color for level, color in _COLORS.items() if line.level >= level), None)
    imgui.push_text_wrap_pos(0.0)
    if color is not None:
        imgui.text_colored(color, line.text)
    else:
        imgui.text_unformatted(line.text)
    imgui.pop_text_wrap_pos()
    if line.details and imgui.tree_node(f"Details##{number}"):
        imgui.text_unformatted(line.details)
        imgui.tree_pop()
