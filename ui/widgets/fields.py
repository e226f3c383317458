"""Widgets for the fields of the rain: title, unit, bounds and help come from the field's own `Meta`."""

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import msgspec
from imgui_bundle import imgui

from gsrain_engine.rain.rain import Box, Rain
from gsrain_engine.session.session import Session

LABEL_WIDTH = 0.42
"""Share of a panel's width that labels take; longer ones take more."""
_BESIDE_EM = 1.0


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
def field_info(name: str, owner: type[msgspec.Struct] = Rain) -> FieldInfo:
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
    at = max(LABEL_WIDTH * imgui.get_window_width(), imgui.calc_text_size(text).x + _BESIDE_EM * imgui.get_font_size())
    imgui.same_line(at)
    imgui.set_next_item_width(-1)


def slider(
    session: Session, name: str, *, high: float | None = None, logarithmic: bool = False, beside_px: float = 0.0
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


def integer(session: Session, name: str) -> None:
    """Edit a whole number."""
    info = field_info(name)
    label(name)
    changed, value = imgui.input_int(f"##{name}", getattr(session.rain, name))
    if changed:
        session.change_rain(info.title, name, **{name: int(min(max(value, info.low), info.high, 2**31 - 1))})
    end_gesture_when_released(session)


def choice(session: Session, name: str) -> None:
    """Pick one of the field's words."""
    info = field_info(name)
    label(name)
    present = info.choices.index(getattr(session.rain, name))
    changed, picked = imgui.combo(f"##{name}", present, list(info.choices))
    if changed:
        session.change_rain(info.title, **{name: info.choices[picked]})


def toggle(session: Session, name: str) -> None:
    """Switch a field on or off."""
    info = field_info(name)
    changed, value = imgui.checkbox(info.title, getattr(session.rain, name))
    imgui.set_item_tooltip(info.help)
    if changed:
        session.change_rain(f"{info.title} {'on' if value else 'off'}", **{name: value})


def box(session: Session, name: str) -> None:
    """Edit the lower and upper corner of a region in metres; a corner that would turn it inside out is not taken."""
    info, region = field_info(name), getattr(session.rain, name)
    for corner, words in (("minimum_m", "from"), ("maximum_m", "to")):
        plain_label(f"{words} x, y, z (m)", f"{info.help} In the ego's frame: x forward, y left, z up.")
        changed, value = imgui.drag_float3(f"##{name}.{corner}", list(getattr(region, corner)), 0.05, -200, 200, "%.2f")
        if changed:
            corners = {"minimum_m": region.minimum_m, "maximum_m": region.maximum_m} | {corner: tuple(value)}
            if all(low + 0.1 <= high for low, high in zip(*corners.values(), strict=True)):
                session.change_rain(info.title, f"{name}.{corner}", **{name: Box(**corners)})
        end_gesture_when_released(session)


def end_gesture_when_released(session: Session) -> None:
    """Close the step of undo when the last widget is let go."""
    if imgui.is_item_deactivated():
        session.end_gesture()
