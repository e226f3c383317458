"""Widgets for the fields of any settings: what a field says about itself decides which widget it gets."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from imgui_bundle import icons_fontawesome_6, imgui

from .fields import FieldInfo, field_info, plain_label
from .file_dialogs import ask_what_to_open
from .square_button import square_button

_Settings = TypeVar("_Settings", bound=msgspec.Struct)

ALL_FILES = "All files{.*}"


def edited(settings: _Settings, name: str, *, label: str | None = None, step: int = 1) -> _Settings:
    """Draw a field's widget; returns the settings as they are now.

    `label` stands for a title that is too long for a panel; `step` is that of a whole number's buttons.
    """
    info, value = field_info(name, type(settings)), getattr(settings, name)
    if isinstance(value, bool):
        changed, value = _checkbox(name, info, value)
    else:
        plain_label(label or (f"{info.title} ({info.unit})" if info.unit else info.title), info.help)
        if info.none is not None:
            switched, value = _given(name, info, value)
            if switched or value is None:
                return _with(settings, name, value) if switched else settings
        if info.choices:
            changed, value = _combo(name, info.choices, value)
        elif isinstance(value, int):
            step = max(step, info.multiple_of)
            changed, value = imgui.input_int(f"##{name}", value, step, 10 * step)
            value = int(min(max(round(value / info.multiple_of) * info.multiple_of, info.low), info.high))
        else:
            changed, value = imgui.slider_float(
                f"##{name}", value, info.low, info.high, "%.4g", imgui.SliderFlags_.always_clamp
            )
        imgui.set_item_tooltip(info.help)
    return _with(settings, name, value) if changed else settings


def place(
    settings: msgspec.Struct, name: str, kinds: str, take: Callable[[str], None], *, label: str | None = None
) -> None:
    """Draw a file's place with a button that asks for it: `kinds` as in a file dialog, "" for a folder.

    What is typed or chosen goes to `take`, a chosen one in a later frame.
    """
    info, present = field_info(name, type(settings)), getattr(settings, name)
    value = "" if present is None else str(present)
    plain_label(label or info.title, info.help)
    beside = imgui.get_frame_height() + imgui.get_style().item_spacing.x
    imgui.set_next_item_width(-beside)
    _, typed = imgui.input_text_with_hint(f"##{name}", "none chosen", value)
    # Letter by letter it would be missing all the time: it is taken when it has been typed.
    if imgui.is_item_deactivated_after_edit():
        take(typed)
    imgui.set_item_tooltip(f"{info.help}\n{value}".strip())
    imgui.same_line()
    if square_button(icons_fontawesome_6.ICON_FA_FOLDER_OPEN, f"choose {name}"):
        ask_what_to_open(f"{info.title}{'' if kinds else ' (folder)'}", kinds, lambda chosen: take(_first(chosen)))
    imgui.set_item_tooltip("Choose a file..." if kinds else "Choose a folder...")


def _first(chosen: Sequence[Path]) -> str:
    return str(chosen[0])


def _given(name: str, info: FieldInfo, value: float | None) -> tuple[bool, float | None]:
    """Draw whether an optional number is given, and the word for that it is not; the number's widget comes after it."""
    changed, is_given = imgui.checkbox(f"##{name} given", value is not None)
    imgui.set_item_tooltip(f"{info.help}\nOff: {info.none}.")
    imgui.same_line()
    imgui.set_next_item_width(-1)
    if not is_given:
        imgui.text_disabled(info.none or "")
    return changed, (value if is_given and value is not None else info.usual if is_given else None)


def _checkbox(name: str, info: FieldInfo, value: bool) -> tuple[bool, bool]:
    changed, value = imgui.checkbox(f"{info.title}###{name}", value)
    imgui.set_item_tooltip(info.help)
    return changed, value


def _combo(name: str, choices: Sequence[str], value: str) -> tuple[bool, str]:
    changed, at = imgui.combo(f"##{name}", choices.index(value), list(choices))
    return changed, choices[at]


def _with(settings: _Settings, name: str, value: Any) -> _Settings:
    return msgspec.structs.replace(settings, **{name: value})
