"""Keyboard in menus and lists: what is typed moves the focus to the first item that begins with it."""

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

from imgui_bundle import imgui

_FORGET_S = 1.0
_ITEMS = ("menu_item", "selectable", "begin_menu")
_LETTERS = tuple(
    (chr(code), imgui.Key(int(imgui.Key.a) + code - ord("a"))) for code in range(ord("a"), ord("z") + 1)
) + tuple((str(digit), imgui.Key(int(imgui.Key._0) + digit)) for digit in range(10))


class _Typed:
    """Text that was typed into the open menu or list."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget what was typed into the last window: the frames of the next are counted from 0 again."""
        self.text = ""
        self.is_new = False
        self.open_frame = -2
        self._frame, self._typed_s = -1, 0.0

    def update(self) -> None:
        """Read the keys of this frame, once."""
        if imgui.get_frame_count() == self._frame:
            return
        self._frame, self.is_new = imgui.get_frame_count(), False
        if imgui.get_io().want_text_input or imgui.get_io().key_ctrl or not is_menu_open():
            self.text = ""
            return
        pressed = "".join(letter for letter, key in _LETTERS if imgui.is_key_pressed(key, False))
        if pressed:
            now = imgui.get_time()
            self.text = pressed if now - self._typed_s > _FORGET_S else self.text + pressed
            self._typed_s, self.is_new = now, True


_typed = _Typed()


def is_menu_open() -> bool:
    """Return whether a menu, a list or another popup is open, and no dialog, which has keys of its own."""
    is_open = imgui.is_popup_open("", imgui.PopupFlags_.any_popup)
    is_open = is_open and imgui.internal.get_top_most_popup_modal() is None
    if is_open:
        _typed.open_frame = imgui.get_frame_count()
    return is_open


def has_keys() -> bool:
    """Return whether a menu or list is open, or was in the last frame: a key closed it, or goes to the next menu."""
    return is_menu_open() or imgui.get_frame_count() - _typed.open_frame in (0, 1)


def install_type_ahead() -> None:
    """Let the items of Dear ImGui's menus and lists take the focus when their beginning is typed. Once per window."""
    _typed.forget()
    for name in _ITEMS:
        function = getattr(imgui, name)
        if not hasattr(function, "takes_typed"):
            setattr(imgui, name, _focused_by_typing(function))


def combo_box(text: str, at: int, titles: Sequence[str]) -> tuple[bool, int]:
    """Draw a combo box whose list takes typed text; returns whether it changed, and the chosen number."""
    changed, chosen = False, at
    if not imgui.begin_combo(text, titles[at] if 0 <= at < len(titles) else ""):
        return False, at
    for number, title in enumerate(titles):
        imgui.push_id(str(number))
        if imgui.selectable(title, number == at)[0]:
            changed, chosen = number != at, number
        if number == at and imgui.is_window_appearing():
            imgui.set_item_default_focus()
        imgui.pop_id()
    imgui.end_combo()
    return changed, chosen


def _focused_by_typing(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def item(label: str, *arguments: Any, **options: Any) -> Any:
        is_in_menu = bool(imgui.internal.get_current_window().flags & imgui.WindowFlags_.popup)
        is_focused = is_in_menu and imgui.is_window_focused()
        drawn = function(label, *arguments, **options)
        _typed.update()
        if _typed.is_new and is_focused and label.partition("##")[0].strip().lower().startswith(_typed.text):
            _typed.is_new = False
            imgui.internal.focus_item()
            imgui.set_nav_cursor_visible(True)
        return drawn

    item.takes_typed = True  # type: ignore[attr-defined]
    return item
