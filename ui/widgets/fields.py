"""Widgets for settings (title, unit, bounds and help come from a field's `Meta`) and keyframes."""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

import msgspec
from imgui_bundle import ImVec2, ImVec4, icons_fontawesome_6, imgui

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.status import StatusBus
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.editor.viewport_state import ViewportState
from gsrain_engine.fields import Field, field_of
from gsrain_engine.rain.keyframes import Keyed, RainKeyframes
from gsrain_engine.rain.settings import RainSettings, RegionBox
from gsrain_engine.rain.wetness import wetness

from .numbers import in_bounds, slide
from .type_ahead import combo_box

_LABEL_WIDTH = 0.42  # share of a panel's width for labels; longer ones take more


def field_label(name: str, owner: type[msgspec.Struct] = RainSettings, *, label: str = "") -> Field:
    """Draw a field's title with its help as tooltip, and move to the position of its widget; returns its metadata.

    `label` replaces its title.
    """
    info = field_of(owner, name)
    plain_label(label or info.label, info.help)
    return info


_BEYOND_PX = ContextVar("so far right of a window's edge rows break", default=0.0)


@contextmanager
def rows_beyond(pixels: float) -> Generator[None]:
    """Break rows so many pixels right of the window's edge: for one that grows to the width of what it holds."""
    token = _BEYOND_PX.set(pixels)
    try:
        yield
    finally:
        _BEYOND_PX.reset(token)


def same_line_if_room(width_em: float, gap: float = 10.0) -> None:
    """Continue on the same line, after a gap in pixels, if the width still fits; else on the next."""
    imgui.same_line(0, gap)
    if imgui.get_content_region_avail().x + _BEYOND_PX.get() < width_em * imgui.get_font_size():
        imgui.new_line()


def plain_label(text: str, help_text: str) -> None:
    """Draw a label with a tooltip, and move to the position of its widget."""
    indent = imgui.get_cursor_pos_x() - imgui.get_cursor_start_pos().x
    imgui.align_text_to_frame_padding()
    imgui.text(text)
    if help_text:
        imgui.set_item_tooltip(help_text)
    width = indent + imgui.calc_text_size(text).x + imgui.get_font_size()
    imgui.same_line(max(_LABEL_WIDTH * imgui.get_window_width(), width))
    imgui.set_next_item_width(-1)


def rain_field(document: Document, name: str) -> None:
    """Draw the widget of a rain setting that its type selects."""
    info = field_of(RainSettings, name)
    if info.choices:
        choice(document, name)
    else:
        {bool: toggle, int: integer, float: slider}[info.kind](document, name)


def slider(
    document: Document, name: str, *, high: float | None = None, beside_px: float = 0.0, label: str = ""
) -> None:
    """Edit the current value of a number between its bounds; one drag is one undo step.

    `beside_px` stays free; `label` replaces the field's own.
    """
    info, value = field_label(name, label=label), getattr(document.rain_now, name)
    if info.none is not None:
        switched, value = _optional_toggle(name, info, value)
        if switched:
            document.change_rain(info.title, **{name: value})
        if value is None:
            return
    if beside_px:
        imgui.set_next_item_width(-beside_px)
    flags = LOGARITHMIC if info.is_logarithmic else CLAMPED
    scale, bounds = (info.low, high or info.slider_high), (info.low, info.high)
    changed, value = slide(f"##{name}", value, *scale, "%.4g", flags, bounds=bounds, unit=info.unit)
    if changed:
        document.change_rain(info.title, name, **{name: value})
    end_gesture_when_released(document)
    _reset_on_right_click(document, info)


def _reset_on_right_click(document: Document, info: Field) -> None:
    """Set a setting to its default if its widget, the last one, is right-clicked."""
    default, unit = info.default_text or info.none, "" if info.default is None else f" {info.unit}"
    reset = f" Right click: back to {default}{unit}." if default else ""
    imgui.set_item_tooltip(f"Drag; double click: type a value.{reset}")
    is_other = getattr(document.rain, info.name) != info.default
    if default and is_other and imgui.is_item_clicked(imgui.MouseButton_.right):
        document.change_rain(info.title, **{info.name: info.default})


def integer(document: Document, name: str) -> None:
    info = field_label(name)
    changed, value = imgui.input_int(f"##{name}", getattr(document.rain, name))
    value = in_bounds(changed, value, info.low, min(info.high, 2**31 - 1), info.unit)
    if changed:
        document.change_rain(info.title, name, **{name: int(value)})
    end_gesture_when_released(document)
    _reset_on_right_click(document, info)


def choice(document: Document, name: str) -> None:
    info = field_label(name)
    present = info.choices.index(getattr(document.rain, name))
    changed, picked = combo_box(f"##{name}", present, [info.choice_title(each) for each in info.choices])
    if changed:
        document.change_rain(info.title, **{name: info.choices[picked]})


def toggle(document: Document, name: str) -> None:
    info = field_of(RainSettings, name)
    changed, value = imgui.checkbox(info.title, getattr(document.rain, name))
    imgui.set_item_tooltip(info.help)
    if changed:
        document.change_rain(f"{info.title} {'on' if value else 'off'}", **{name: value})


def toggles(document: Document, *names: str) -> None:
    """Draw check boxes next to each other as far as there is room."""
    for number, name in enumerate(names):
        if number > 0:
            same_line_if_fits(field_of(RainSettings, name).title, imgui.get_frame_height())
        toggle(document, name)


def same_line_if_fits(label: str, more_px: float = 0.0) -> None:
    """Go on in the same line if a button with this label, or an item so many pixels wider, has room there."""
    style = imgui.get_style()
    width = imgui.calc_text_size(label, hide_text_after_double_hash=True).x + 2 * style.frame_padding.x + more_px
    right = imgui.get_cursor_screen_pos().x + imgui.get_content_region_avail().x
    if imgui.get_item_rect_max().x + style.item_spacing.x + width < right:
        imgui.same_line()


def box(document: Document, name: str) -> None:
    """Edit the lower and upper corner of a region in meters; corners that would invert it are ignored."""
    info, region = field_of(RainSettings, name), getattr(document.rain, name)
    for corner, words in (("minimum_m", "From"), ("maximum_m", "To")):
        plain_label(f"{words} x, y, z (m)", f"{info.help} In the ego's frame: x forward, y left, z up.")
        changed, value = imgui.drag_float3(f"##{name}.{corner}", list(getattr(region, corner)), 0.05, -200, 200, "%.2f")
        if changed:
            corners = {"minimum_m": region.minimum_m, "maximum_m": region.maximum_m} | {corner: tuple(value)}
            if all(low + 0.1 <= high for low, high in zip(*corners.values(), strict=True)):
                document.change_rain(info.title, f"{name}.{corner}", **{name: RegionBox(**corners)})
        end_gesture_when_released(document)


def end_gesture_when_released(document: Document) -> None:
    """End the undo step when the last widget is released."""
    if imgui.is_item_deactivated():
        document.end_gesture()


# Fields of any settings: metadata and type select the widget

_Settings = TypeVar("_Settings", bound=msgspec.Struct)


def edit_field(settings: _Settings, name: str, *, label: str | None = None, step: int = 1) -> _Settings:
    """Draw a field's widget and return the settings; `label` replaces a long title, `step` is that of an integer."""
    info, value = field_of(type(settings), name), getattr(settings, name)
    if isinstance(value, bool):
        changed, value = imgui.checkbox(f"{info.title}###{name}", value)
    else:
        plain_label(label or info.label, info.help)
        if info.none is not None:
            switched, value = _optional_toggle(name, info, value)
            if switched or value is None:
                return msgspec.structs.replace(settings, **{name: value}) if switched else settings
        if info.choices:
            choices = (None, *info.choices) if info.is_optional else info.choices
            names = [
                str(info.extra.get("none", "none")) if each is None else info.choice_title(each) for each in choices
            ]
            changed, at = combo_box(f"##{name}", choices.index(value), names)
            value = choices[at]
        elif isinstance(value, int):
            step = max(step, info.multiple_of)
            changed, value = imgui.input_int(f"##{name}", value, step, 10 * step)
            value = in_bounds(
                changed, round(value / info.multiple_of) * info.multiple_of, info.low, info.high, info.unit
            )
            value = int(value)
        else:
            changed, value = slide(f"##{name}", value, info.low, info.high, unit=info.unit)
        if info.default_text and imgui.is_item_clicked(imgui.MouseButton_.right):
            changed, value = value != info.default, info.default
    imgui.set_item_tooltip(info.help)
    return msgspec.structs.replace(settings, **{name: value}) if changed else settings


def _optional_toggle(name: str, info: Field, value: float | None) -> tuple[bool, float | None]:
    """Draw the checkbox of an optional number, with the text for None if off; the number's widget comes after it."""
    changed, is_on = imgui.checkbox(f"##{name} given", value is not None)
    imgui.set_item_tooltip(f"{info.help}\nOff: {info.none}.")
    imgui.same_line()
    imgui.set_next_item_width(-1)
    if not is_on:
        imgui.text_disabled(info.none or "")
        return changed, None
    return changed, info.initial if value is None else value


# Keyframe diamond: gray without keyframes, lit with some, bright at a keyframe's time

_KEYED = ImVec4(0.95, 0.66, 0.25, 1.0)
_HERE = ImVec4(1.0, 0.93, 0.45, 1.0)
_TITLES = {
    "intensity_mm_h": "intensity", "wind_m_s": "wind", "exposure_s": "exposure", "wetness": "wetness",
    "lamp_gain": "lamp brightness",
}  # fmt: skip


def keyframe_button_width() -> float:
    """Width of a square button with its gap."""
    return imgui.get_frame_height() + imgui.get_style().item_spacing.x


def keyframe_button(document: Document, viewport: ViewportState, playback: Playback, name: Keyed) -> None:
    now_s, title = playback.clock.time_s, _TITLES[name]
    is_keyed, is_here = document.keyframes.is_keyed(name), _is_keyed_now(document, playback, name)
    imgui.same_line()
    imgui.push_style_color(imgui.Col_.button, ImVec4(0, 0, 0, 0))
    color = _HERE if is_here else _KEYED if is_keyed else imgui.get_style_color_vec4(imgui.Col_.text_disabled)
    imgui.push_style_color(imgui.Col_.text, color)
    clicked = square_button(icons_fontawesome_6.ICON_FA_DIAMOND, f"key {name}")
    imgui.pop_style_color(2)
    if is_here:
        imgui.set_item_tooltip(f"Remove the {title} keyframe at {now_s:.2f} s.")
    elif is_keyed:
        imgui.set_item_tooltip(
            f"The {title} has keyframes: changing it sets one at the present time. Click: insert one at {now_s:.2f} s."
        )
    else:
        imgui.set_item_tooltip(f"Animate the {title}: insert its first keyframe at {now_s:.2f} s.")
    if clicked:
        toggle_keyframe(document, viewport, playback, name)


def toggle_keyframe(document: Document, viewport: ViewportState, playback: Playback, name: Keyed) -> None:
    """Set a field's keyframe at the current time to its current value, or remove the one there."""
    now_s, title = playback.clock.time_s, _TITLES[name]
    if _is_keyed_now(document, playback, name):
        document.edit_keyframes(f"Remove {title} keyframe", RainKeyframes.without_key, now_s, name)
        return
    now = document.rain_now
    value = now.wind_vector_m_s if name == "wind_m_s" else getattr(now, name)
    if value is None:  # exposure: the camera's own; wetness: that of steady rain
        value = viewport.shot(16, 16).camera.exposure_s if name == "exposure_s" else wetness(now.intensity_mm_h)
    document.edit_keyframes(f"Insert {title} keyframe", RainKeyframes.with_key, now_s, **{name: value})


def _is_keyed_now(document: Document, playback: Playback, name: Keyed) -> bool:
    present = document.keyframes.key_at(playback.clock.time_s)
    return present is not None and getattr(present, name) is not None


def tint_keyframed(document: Document, name: Keyed) -> int:
    """Tint the frame of the next field if it has keyframes; returns the number of colors to pop."""
    if not document.keyframes.is_keyed(name):
        return 0
    imgui.push_style_color(imgui.Col_.frame_bg, ImVec4(_KEYED.x, _KEYED.y, _KEYED.z, 0.22))
    return 1


def keyframed_slider(
    document: Document, viewport: ViewportState, playback: Playback, name: Keyed, *, high: float
) -> None:
    colors = tint_keyframed(document, name)
    slider(document, name, high=high, beside_px=keyframe_button_width())
    imgui.pop_style_color(colors)
    keyframe_button(document, viewport, playback, name)


def square_button(icon: str, name: str) -> bool:
    """Draw a centered icon button; returns True if clicked. `name` distinguishes it from others in the panel."""
    side = imgui.get_frame_height()
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(0, imgui.get_style().frame_padding.y))
    clicked = imgui.button(f"{icon}###{name}", ImVec2(side, side))
    imgui.pop_style_var()
    return clicked


# Widgets with their tooltip in one call

_WARNINGS = ImVec4(0.95, 0.6, 0.2, 1.0), ImVec4(0.6, 0.31, 0.0, 1.0)  # on dark panels, and on light ones
_ERRORS = ImVec4(1.0, 0.52, 0.45, 1.0), ImVec4(0.72, 0.1, 0.07, 1.0)
CLAMPED = imgui.SliderFlags_.always_clamp
LOGARITHMIC = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
_Value = TypeVar("_Value")


def warning_color() -> ImVec4:
    """Return the color of warnings in the present theme."""
    return _WARNINGS[_is_light()]


def error_color() -> ImVec4:
    """Return the color of errors in the present theme."""
    return _ERRORS[_is_light()]


def _is_light() -> bool:
    return imgui.get_style_color_vec4(imgui.Col_.window_bg).y > 0.5


def faint(text: str | None) -> None:
    """Draw a wrapped line in the color of disabled text, if there is one."""
    if text:
        imgui.push_text_wrap_pos(0.0)
        imgui.text_disabled(text)
        imgui.pop_text_wrap_pos()


def warn(text: str | None) -> None:
    """Draw a wrapped warning; nothing without a text."""
    if text:
        with text_color(warning_color()):
            imgui.text_wrapped(text)


@contextmanager
def text_color(color: ImVec4 | int) -> Generator[None]:
    """Color the text within; a number is a style color (`imgui.Col_`)."""
    imgui.push_style_color(imgui.Col_.text, color if isinstance(color, ImVec4) else imgui.get_style_color_vec4(color))
    yield
    imgui.pop_style_color()


@contextmanager
def disabled(is_disabled: bool = True) -> Generator[None]:
    """Gray out the widgets within."""
    imgui.begin_disabled(is_disabled)
    yield
    imgui.end_disabled()


def button(
    text: str,
    help_text: str,
    *,
    width: float = 0.0,
    height: float = 0.0,
    enabled: bool = True,
    why_not: str | None = None,
    is_on: bool = False,
) -> bool:
    """Draw a button; returns True if clicked. A reason `why_not` disables it and is added to the tooltip."""
    if is_on:
        imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(imgui.Col_.button_active))
    with disabled(not enabled or why_not is not None):
        clicked = imgui.button(text, ImVec2(width, height))
    if is_on:
        imgui.pop_style_color()
    imgui.set_item_tooltip(help_text if why_not is None else f"{help_text}\n{why_not}")
    return clicked


def copy_buttons(
    what: str, forms: Mapping[str, Callable[[], str]], status: StatusBus, why_not: str | None = None
) -> None:
    """Draw buttons that put text on the clipboard, such as "Copy as Python", in a row if it is wide enough.

    Errors of making the text are reported.
    """
    width, padding = share_of_width(len(forms)), 2 * imgui.get_style().frame_padding.x
    is_row = all(imgui.calc_text_size(f"Copy as {form}").x + padding <= width for form in forms)
    for number, (form, text) in enumerate(forms.items()):
        if number and is_row:
            imgui.same_line()
        help_text = f"Copy {what} in a form that does the same when it is run."
        if button(f"Copy as {form}", help_text, width=width if is_row else -1, why_not=why_not):
            try:
                imgui.set_clipboard_text(text())
            except ValueError as error:
                status.report(error)


def share_of_width(count: int) -> float:
    """Return the width of each of `count` widgets in a row over the panel's width."""
    return (imgui.get_content_region_avail().x - (count - 1) * imgui.get_style().item_spacing.x) / count


def menu_item(name: str, help_text: str, *, possible: bool = True) -> bool:
    clicked, _ = imgui.menu_item(name, "", False, possible)
    imgui.set_item_tooltip(help_text)
    return clicked


def checkbox(text: str, value: bool, help_text: str) -> bool:
    """Draw a checkbox; returns its new value."""
    _, value = imgui.checkbox(text, value)
    imgui.set_item_tooltip(help_text)
    return value


def combo(text: str, value: _Value, choices: Mapping[Any, str] | Sequence[_Value], help_text: str = "") -> _Value:
    """Draw a combo box; returns its new value. Titles are those of the mapping, else the choices themselves."""
    values: list[Any] = list(choices)
    titles = list(choices.values()) if isinstance(choices, Mapping) else [str(each) for each in values]
    changed, at = combo_box(text, values.index(value) if value in values else 0, titles)
    if help_text:
        imgui.set_item_tooltip(help_text)
    return values[at] if changed else value


def number(
    title: str, name: str, value: float, low: float, high: float, form: str, help_text: str, flags: int = 0
) -> float:
    """Draw a label and a slider; returns the new value."""
    plain_label(title, help_text)
    return slide(f"##{name}", value, low, high, form, flags)[1]


def edit_choice(
    settings: _Settings, name: str, choices: Mapping[Any, str] | Sequence[Any], help_text: str | None = None
) -> _Settings:
    """Draw a combo box of other choices or titles than the field's own; returns the updated settings."""
    info, value = field_label(name, type(settings)), getattr(settings, name)
    picked = combo(f"##{name}", value, choices, help_text or info.help)
    return settings if picked == value else msgspec.structs.replace(settings, **{name: picked})
