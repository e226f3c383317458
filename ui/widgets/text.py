"""Text in the window: tables of values, names of keys, and escaping of names."""

import re
from bisect import bisect_left
from collections.abc import Callable, Iterable
from functools import wraps
from typing import Any

from imgui_bundle import imgui

from gsrain_engine.safe_io.text_files import escape_invisible


def readings(table: str, rows: Iterable[tuple[str, str, str]], *, faint: bool = False) -> None:
    """Draw a table of names and values; the third of each row is the tooltip of its name. `table` is its label."""
    text = imgui.text_disabled if faint else imgui.text
    if not imgui.begin_table(table, 2, imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop):
        return
    for name, value, help_text in rows:
        imgui.table_next_row()
        imgui.table_next_column()
        text(name)
        imgui.set_item_tooltip(help_text)
        imgui.table_next_column()
        text(value)
    imgui.end_table()


def inline_text(text: str, *, faint: bool = False) -> None:
    """Draw text in line with the widget that comes next."""
    imgui.align_text_to_frame_padding()
    (imgui.text_disabled if faint else imgui.text)(text)
    imgui.same_line()


def key_names(text: str) -> str:
    """Return a text with keys as they are named here: Cmd for Ctrl on macOS, where Dear ImGui exchanges them."""
    is_mac = "Ctrl" in text and imgui.get_io().config_mac_osx_behaviors
    return text.replace("Ctrl", "Cmd") if is_mac else text


# Names from files: their text must not act as a label's id, change the text direction or crash the window

_HIDDEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters, direction controls, and bytes that are not text, for which Dear ImGui's binding raises."""

_DRAWING = (
    "text", "text_wrapped", "text_disabled", "text_colored", "text_unformatted", "bullet_text", "label_text",
    "text_link", "separator_text", "progress_bar", "calc_text_size",
    "button", "small_button", "checkbox", "radio_button", "selectable", "menu_item", "begin_menu", "tree_node",
    "tree_node_ex", "collapsing_header", "begin_combo", "combo", "list_box", "input_text", "input_text_with_hint",
    "begin_tab_item", "begin_table", "table_setup_column", "begin_child", "begin_popup", "begin_popup_modal",
    "open_popup", "is_popup_open", "push_id", "get_id", "set_clipboard_text",
)  # fmt: skip
"""Functions of Dear ImGui that take text."""

_ONLY_WORDS = ("separator_text", "progress_bar")
"""Functions whose text has no identity, but which still hide text after ##."""


def shortened(words: str, width_px: float) -> str:
    """Return words that end in an ellipsis if they are wider."""

    def is_narrow(text: str) -> bool:
        return imgui.calc_text_size(text).x <= width_px

    if is_narrow(words):
        return words
    count = bisect_left(range(1, len(words)), True, key=lambda kept: not is_narrow(f"{words[:kept].rstrip()}\u2026"))
    return f"{words[:count].rstrip()}\u2026"


def label(name: str, identity: str = "") -> str:
    """Return a widget's label that shows a name as it is, even with ##; `identity` distinguishes equal names."""
    return f"{visible_name(name)}##{plain_identity(identity)}" if identity else visible_name(name)


def visible_name(name: str) -> str:
    return _all_words(escape_invisible(name))


def plain_identity(name: str) -> str:
    """Return a name as the identity of a widget, after ## or ###: different names stay different."""
    return escape_invisible(name.replace("%", "%25").replace("#", "%23").replace("\\", "%5C"))


def escape_all_text() -> None:
    """Make Dear ImGui's functions escape text that can't be drawn: names from files would crash the window."""
    for name in _DRAWING:
        function = getattr(imgui, name)
        if not hasattr(function, "__wrapped__"):
            setattr(imgui, name, _escaping(function, _all_words if name in _ONLY_WORDS else None))
    if not hasattr(imgui.ImDrawList.add_text, "__wrapped__"):
        imgui.ImDrawList.add_text = _escaping(imgui.ImDrawList.add_text)


def _all_words(text: str) -> str:
    """Return text of which Dear ImGui hides nothing."""
    words = text.replace("##", "# #").replace("##", "# #")
    return f"{words} " if words.endswith("#") else words  # followed by ##, a final # would make ###


def _escaping(function: Callable[..., Any], words: Callable[[str], str] | None = None) -> Callable[..., Any]:
    @wraps(function)
    def drawing(*arguments: Any, **options: Any) -> Any:
        if words is not None:
            arguments = tuple(words(each) if isinstance(each, str) else each for each in arguments)
        if options:
            options = {key: _visible(value) for key, value in options.items()}
        return function(*map(_visible, arguments), **options)

    return drawing


def _visible(value: Any) -> Any:
    if isinstance(value, str):
        is_plain = value.isascii() and value.isprintable()
        return value if is_plain else _HIDDEN.sub(lambda found: repr(found[0])[1:-1], value)
    if isinstance(value, list) and value and isinstance(value[0], str):  # the choices of a combo box
        return [_all_words(_visible(each)) for each in value]
    return value
