"""Widgets for the fields of the rain: title, unit, bounds and help come from the field's own `Meta`."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import msgspec
from imgui_bundle import ImVec2, ImVec4, icons_fontawesome_6, im_file_dialog, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.keyframes import Keyed
from gsrain_engine.rain.settings import RainSettings, RegionBox
from gsrain_engine.scene.formats.registry import writable_suffixes

LABEL_WIDTH = 0.42
"""Share of a panel's width that labels take; longer ones take more."""

_SIDE_MARGIN_EM = 1.0


@dataclass(frozen=True)
class FieldInfo:
    """What a field says about itself."""

    title: str
    unit: str
    help: str
    low: float
    high: float
    choices: tuple[str, ...]
    multiple_of: int = 1
    none: str | None = None
    """What it means that an optional number is not given, in a word or two; None where it has to be."""
    usual: float = 0.0
    """What an optional number is when it is given anew."""


@cache
def field_info(name: str, owner: type[msgspec.Struct] = RainSettings) -> FieldInfo:
    """Read the declaration of a field, of the rain or of another struct."""
    hint = get_type_hints(owner, include_extras=True)[name]
    is_optional = type(None) in get_args(hint)
    hint = next((each for each in get_args(hint) if get_origin(each) is Annotated), hint)  # where it may be None
    kind, meta = (hint.__origin__, hint.__metadata__[0]) if get_origin(hint) is Annotated else (hint, msgspec.Meta())
    extra: dict[str, Any] = meta.extra or {}
    choices = tuple(each for each in get_args(kind) if isinstance(each, str))
    low = meta.ge if meta.ge is not None else extra.get("ge", 0.0)
    high = meta.le if meta.le is not None else extra.get("le", 1.0)
    none = str(extra.get("none", "none")) if is_optional and kind in (int, float) else None
    default = next(each for each in msgspec.structs.fields(owner) if each.name == name).default
    usual = extra.get("usual", default if isinstance(default, int | float) else low)
    multiple = int(meta.multiple_of or 1)
    return FieldInfo(
        meta.title or name, extra.get("unit", ""), meta.description or "", low, high, choices, multiple, none, usual
    )


def label(name: str) -> None:
    """Write a field's title with its help as tooltip, and move to where its widget goes."""
    info = field_info(name)
    plain_label(f"{info.title} ({info.unit})" if info.unit else info.title, info.help)


def plain_label(text: str, help_text: str) -> None:
    """Write a label with a tooltip, and move to where its widget goes."""
    imgui.align_text_to_frame_padding()
    imgui.text(text)
    if help_text:
        imgui.set_item_tooltip(help_text)
    at = max(
        LABEL_WIDTH * imgui.get_window_width(), imgui.calc_text_size(text).x + _SIDE_MARGIN_EM * imgui.get_font_size()
    )
    imgui.same_line(at)
    imgui.set_next_item_width(-1)


def slider(
    session: Editor, name: str, *, high: float | None = None, logarithmic: bool = False, beside_px: float = 0.0
) -> None:
    """Edit a number between its bounds, as it is now; one drag is one step of undo. `beside_px` stays free."""
    info = field_info(name)
    label(name)
    if beside_px:
        imgui.set_next_item_width(-beside_px)
    flags = imgui.SliderFlags_.always_clamp | (imgui.SliderFlags_.logarithmic if logarithmic else 0)
    value = getattr(session.rain_now, name)
    changed, value = imgui.slider_float(f"##{name}", value, info.low, high or info.high, "%.4g", flags)
    if changed:
        session.change_rain(info.title, name, **{name: value})
    end_gesture_when_released(session)


def integer(session: Editor, name: str) -> None:
    """Edit a whole number."""
    info = field_info(name)
    label(name)
    changed, value = imgui.input_int(f"##{name}", getattr(session.rain, name))
    if changed:
        session.change_rain(info.title, name, **{name: int(min(max(value, info.low), info.high, 2**31 - 1))})
    end_gesture_when_released(session)


def choice(session: Editor, name: str) -> None:
    """Pick one of the field's words."""
    info = field_info(name)
    label(name)
    present = info.choices.index(getattr(session.rain, name))
    changed, picked = imgui.combo(f"##{name}", present, list(info.choices))
    if changed:
        session.change_rain(info.title, **{name: info.choices[picked]})


def toggle(session: Editor, name: str) -> None:
    """Switch a field on or off."""
    info = field_info(name)
    changed, value = imgui.checkbox(info.title, getattr(session.rain, name))
    imgui.set_item_tooltip(info.help)
    if changed:
        session.change_rain(f"{info.title} {'on' if value else 'off'}", **{name: value})


def box(session: Editor, name: str) -> None:
    """Edit the lower and upper corner of a region in metres; a corner that would turn it inside out is not taken."""
    info, region = field_info(name), getattr(session.rain, name)
    for corner, words in (("minimum_m", "from"), ("maximum_m", "to")):
        plain_label(f"{words} x, y, z (m)", f"{info.help} In the ego's frame: x forward, y left, z up.")
        changed, value = imgui.drag_float3(f"##{name}.{corner}", list(getattr(region, corner)), 0.05, -200, 200, "%.2f")
        if changed:
            corners = {"minimum_m": region.minimum_m, "maximum_m": region.maximum_m} | {corner: tuple(value)}
            if all(low + 0.1 <= high for low, high in zip(*corners.values(), strict=True)):
                session.change_rain(info.title, f"{name}.{corner}", **{name: RegionBox(**corners)})
        end_gesture_when_released(session)


def end_gesture_when_released(session: Editor) -> None:
    """Close the step of undo when the last widget is let go."""
    if imgui.is_item_deactivated():
        session.end_gesture()


# § Widgets for the fields of any settings: what a field says about itself decides which widget it gets.

_Settings = TypeVar("_Settings", bound=msgspec.Struct)

ALL_FILES = "All files{.*}"


def edit_field(settings: _Settings, name: str, *, label: str | None = None, step: int = 1) -> _Settings:
    """Draw a field's widget; returns the settings as they are now.

    `label` stands for a title that is too long for a panel; `step` is that of a whole number's buttons.
    """
    info, value = field_info(name, type(settings)), getattr(settings, name)
    if isinstance(value, bool):
        changed, value = _checkbox(name, info, value)
    else:
        plain_label(label or (f"{info.title} ({info.unit})" if info.unit else info.title), info.help)
        if info.none is not None:
            switched, value = _optional_toggle(name, info, value)
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


def path_field(
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


def _optional_toggle(name: str, info: FieldInfo, value: float | None) -> tuple[bool, float | None]:
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


# § The small diamond beside a field that can have keys over time: grey without, lit with, bright at a key's own time.

KEYED = ImVec4(0.95, 0.66, 0.25, 1.0)

HERE = ImVec4(1.0, 0.93, 0.45, 1.0)

_TITLES = {"intensity_mm_h": "intensity", "wind_m_s": "wind", "exposure_s": "exposure"}


def keyframe_button_width() -> float:
    """Room that the button takes, with the gap before it."""
    return imgui.get_frame_height() + imgui.get_style().item_spacing.x


def keyframe_button(session: Editor, name: Keyed) -> None:
    """Draw the button at the end of a field's row."""
    weather, now_s, title = session.weather, session.clock.time_s, _TITLES[name]
    is_keyed = weather.is_keyed(name)
    present = weather.key_at(now_s)
    is_here = present is not None and getattr(present, name) is not None
    imgui.same_line()
    imgui.push_style_color(imgui.Col_.button, ImVec4(0, 0, 0, 0))
    color = HERE if is_here else KEYED if is_keyed else imgui.get_style_color_vec4(imgui.Col_.text_disabled)
    imgui.push_style_color(imgui.Col_.text, color)
    clicked = square_button(icons_fontawesome_6.ICON_FA_DIAMOND, f"key {name}")
    imgui.pop_style_color(2)
    if is_here:
        imgui.set_item_tooltip(f"Remove the key of the {title} at {now_s:.2f} s.")
    elif is_keyed:
        imgui.set_item_tooltip(
            f"The {title} has keys: changing it sets one at the present time. Click to set one at {now_s:.2f} s."
        )
    else:
        imgui.set_item_tooltip(f"Let the {title} change over time: set its first key at {now_s:.2f} s.")
    if clicked:
        toggle_keyframe(session, name)


def toggle_keyframe(session: Editor, name: Keyed) -> None:
    """Set a field's key at the present time to its present value, or remove the one that is there."""
    weather, now_s, title = session.weather, session.clock.time_s, _TITLES[name]
    present = weather.key_at(now_s)
    if present is not None and getattr(present, name) is not None:
        session.set_weather(f"Remove the key of the {title}", weather.without_key(now_s, name))
        return
    value = getattr(session.rain_now, name)
    if value is None:  # exposure: the camera's own
        value = session.shot(16, 16).camera.exposure_s
    session.set_weather(f"Key the {title}", weather.with_key(now_s, **{name: value}))


def tint_keyframed(session: Editor, name: Keyed) -> int:
    """Tint the frame of the next field if it has keys; returns how many colours to pop."""
    if not session.weather.is_keyed(name):
        return 0
    imgui.push_style_color(imgui.Col_.frame_bg, ImVec4(KEYED.x, KEYED.y, KEYED.z, 0.22))
    return 1


def keyframed_slider(session: Editor, name: Keyed, *, high: float) -> None:
    """Edit a number that can have keys."""
    colors = tint_keyframed(session, name)
    slider(session, name, high=high, beside_px=keyframe_button_width())
    imgui.pop_style_color(colors)
    keyframe_button(session, name)


# § File dialogs: who asks says what to do with the answer, which comes in a later frame.

Answer = Callable[[list[Path]], None]


class _Waiting(NamedTuple):
    answer: Answer
    nameless: frozenset[str]
    """What a dialog for a file to write makes of no name: the bare end of a name, as `.ply` or `.*`."""


_waiting: dict[str, _Waiting] = {}
"""By the dialogs' titles; there is one window."""

SCENE_FOLDERS = "Scene folders{.*}"
"""All that a scene can be saved as."""


def exported_kinds() -> str:
    """Kinds of single files that a scene can be exported to, each by itself; those of installed packages too."""
    return ",".join(f"{suffix.lstrip('.').upper()} files{{{suffix}}}" for suffix in writable_suffixes())


def ask_what_to_open(title: str, kinds: str, answer: Answer, *, several: bool = False) -> None:
    """Show a dialog for files that exist; `kinds` as in "Scenes{.ply,.spz},All files{.*}"."""
    _waiting[title] = _Waiting(answer, frozenset())
    im_file_dialog.FileDialog.instance().open(title, title, kinds, several)


def ask_where_to_save(title: str, kinds: str, answer: Answer) -> None:
    ends = re.findall(r"[{,](\.[^,{}]*)", kinds)
    _waiting[title] = _Waiting(answer, frozenset(ends))
    im_file_dialog.FileDialog.instance().save(title, title, kinds)


def answer_dialogs(session: Editor) -> None:
    """Act on dialogs that were closed. Once a frame."""
    dialogs = im_file_dialog.FileDialog.instance()
    for title in list(_waiting):
        if not dialogs.is_done(title):
            continue
        waiting = _waiting.pop(title)
        chosen = [Path(each.path()) for each in dialogs.get_results()] if dialogs.has_result() else []
        dialogs.close()
        if any(path.name in waiting.nameless for path in chosen):
            session.problem = f"{title}: no name was typed; choose a folder, then type a name behind File name."
        elif chosen:
            waiting.answer([_meant(path) for path in chosen])


def _meant(path: Path) -> Path:
    """What was typed: to a name without a suffix the dialog adds that of the chosen kind, even where it is `.*`."""
    return path.with_suffix("") if path.suffix == ".*" else path


# § A button as wide as it is high, for an icon.


def square_button(icon: str, name: str) -> bool:
    """Draw it, in the middle of its square; returns whether it was clicked. `name` tells it from the panel's others."""
    side = imgui.get_frame_height()
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(0, imgui.get_style().frame_padding.y))
    clicked = imgui.button(f"{icon}###{name}", ImVec2(side, side))
    imgui.pop_style_var()
    return clicked
