"""The History panel: every step; a click goes there."""

from imgui_bundle import imgui

from gsrain_engine.session.session import Session

from ..widgets.names import label


class _Seen:
    """The step that the list was last scrolled to."""

    cursor = -1


def history_panel(session: Session) -> None:
    history = session.history
    chosen = None
    for number, step in enumerate(history.labels):
        is_undone = number > history.cursor
        if is_undone:
            imgui.push_style_color(imgui.Col_.text, imgui.get_style_color_vec4(imgui.Col_.text_disabled))
        if imgui.selectable(label(step, str(number)), number == history.cursor)[0]:
            chosen = number
        if is_undone:
            imgui.pop_style_color()
        imgui.set_item_tooltip("Go to this step." if number != history.cursor else "The document as it is now.")
        if number == history.cursor != _Seen.cursor:
            imgui.set_scroll_here_y(0.8)
    _Seen.cursor = history.cursor
    if chosen is not None:
        session.go_to_step(chosen)
