"""Numbers: sliders whose value is next to the knob and can be typed, bounds that are displayed, and a compass."""

import math
from collections.abc import Generator
from contextlib import contextmanager

from imgui_bundle import ImVec2, ImVec4, imgui

from gsrain_engine.fields import number_text

from .draw import color

_LEFT, _RIGHT = imgui.MouseButton_.left, imgui.MouseButton_.right
_FOUR_DIGITS = "%.4g"
_LOG = int(imgui.SliderFlags_.logarithmic)
_LOG_ZERO = 1e-4
"""ImGui's smallest value above 0 on a logarithmic scale from 0 on, for four digits."""


def typed_seconds(name: str, value: float) -> float | None:
    """Draw a number field in seconds; returns the number when Enter is pressed or the field loses the focus."""
    changed, typed = imgui.input_float(name, value, 0, 0, "%.2f s")
    storage, item = imgui.get_state_storage(), imgui.get_item_id()
    if changed:
        storage.set_float(item, typed)
    return storage.get_float(item, value) if imgui.is_item_deactivated_after_edit() else None


def plain_form(value: float) -> str:
    """Return the format of a number in four digits without an exponent."""
    power = math.floor(math.log10(abs(value))) if value else 0
    return _FOUR_DIGITS if -4 <= power < 4 else f"%.{max(3 - power, 0)}f"


# Sliders


def slide(
    name: str,
    value: float,
    low: float,
    high: float,
    form: str = _FOUR_DIGITS,
    flags: int = 0,
    *,
    bounds: tuple[float, float] | None = None,
    unit: str = "",
) -> tuple[bool, float]:
    """Draw a slider with its value on the side of the knob that has more room; returns whether it has changed, and it.

    A drag sets the value; a double click, or Ctrl+click, types one. What is typed may leave the slider's scale up to
    `bounds`; beyond these it becomes the bound, which appears next to the slider for a moment, in `unit`.
    """
    shown = plain_form(value) if form == _FOUR_DIGITS else form
    text = shown % value if "%" in shown.replace("%%", "") else shown
    with _value_next_to_knob(name, text, _knob_share(value, low, high, bool(flags & _LOG))) as is_typing:
        changed, new = imgui.slider_float(name, value, low, high, form, flags & _LOG)
    return _edited(changed, new, value, bounds or (low, high), unit, is_typing)


def slide_whole(
    name: str, value: int, low: int, high: int, text: str | None = None, flags: int = 0, *, unit: str = ""
) -> tuple[bool, int]:
    """Draw a slider of a whole number, as `slide` does; `text` replaces the number."""
    with _value_next_to_knob(name, text or str(value), _knob_share(value, low, high, bool(flags & _LOG))) as is_typing:
        changed, new = imgui.slider_int(name, value, low, high, "%d", flags & _LOG)
    changed, number = _edited(changed, new, value, (low, high), unit, is_typing)
    return changed, round(number)


def _edited(
    changed: bool, new: float, value: float, bounds: tuple[float, float], unit: str, is_typing: bool
) -> tuple[bool, float]:
    """Begin to type after a double click, and ignore a click that does not drag: it may be the first of two."""
    if not is_typing and imgui.is_item_hovered() and imgui.is_mouse_double_clicked(_LEFT):
        imgui.set_keyboard_focus_here(-1)  # as the Tab key: into the text
    by_mouse = imgui.is_mouse_down(_LEFT) or imgui.is_mouse_released(_LEFT)
    if not is_typing and by_mouse and not imgui.is_mouse_dragging(_LEFT):
        changed = False
    new = in_bounds(changed, new, *bounds, unit)
    return changed and new != value, new if changed else value


def _knob_share(value: float, low: float, high: float, is_logarithmic: bool) -> float:
    """Return the position of a slider's knob, 0..1."""
    if is_logarithmic and low >= 0:
        start = max(low, _LOG_ZERO)
        share = math.log(max(value, start) / start) / math.log(high / start)
    else:
        share = (value - low) / (high - low) if high > low else 0.0
    return min(max(share, 0.0), 1.0)


@contextmanager
def _value_next_to_knob(name: str, text: str, share: float) -> Generator[bool]:
    """Replace the text over the knob of the slider within; yields True while a value is typed into it."""
    is_typing, width = imgui.internal.temp_input_is_active(imgui.get_id(name)), imgui.calc_item_width()
    if is_typing:
        yield True
        return
    ink = imgui.get_color_u32(imgui.Col_.text)
    visible = name.partition("##")[0]
    imgui.push_style_color(imgui.Col_.text, ImVec4(0, 0, 0, 0))
    yield False
    imgui.pop_style_color()
    low, bottom, size = imgui.get_item_rect_min(), imgui.get_item_rect_max().y, imgui.calc_text_size(text)
    padding, draw, y = (
        imgui.get_style().frame_padding,
        imgui.get_window_draw_list(),
        low.y + (bottom - low.y - size.y) / 2,
    )
    x = low.x + padding.x if share > 0.5 else low.x + width - padding.x - size.x
    draw.push_clip_rect(low, ImVec2(low.x + width, bottom), True)
    draw.add_text(ImVec2(x, y), ink, text)
    draw.pop_clip_rect()
    if visible:
        draw.add_text(ImVec2(low.x + width + imgui.get_style().item_inner_spacing.x, y), ink, visible)


# Bounds

_REFUSED = ImVec4(0.86, 0.3, 0.2, 1.0)
_FLASH_S = 1.5


def in_bounds(changed: bool, value: float, low: float, high: float, unit: str = "") -> float:
    """Return the last item's value, clamped; draws the bound that it was beyond next to the item for a moment."""
    storage, key = imgui.get_state_storage(), imgui.get_item_id() ^ 0x5EED
    if changed:
        is_beyond = 1.0 if value > high else -1.0 if value < low else 0.0
        storage.set_float(key, is_beyond * imgui.get_time())
    refused_s = storage.get_float(key, 0.0)
    if refused_s and imgui.get_time() - abs(refused_s) < _FLASH_S:
        word, bound = ("max", high) if refused_s > 0 else ("min", low)
        _flash(f"{word} {number_text(bound)}{'' if unit in '°%' else ' '}{unit}")
    return min(max(value, low), high)


def _flash(text: str) -> None:
    """Draw a refused value's bound below the last item."""
    low, high, size = imgui.get_item_rect_min(), imgui.get_item_rect_max(), imgui.calc_text_size(text)
    draw, hue = imgui.get_foreground_draw_list(), color(_REFUSED)
    draw.add_rect(low, high, hue, imgui.get_style().frame_rounding, 2.0)
    top = high.y + 2
    draw.add_rect_filled(ImVec2(low.x, top), ImVec2(low.x + size.x + 12, top + size.y + 6), hue, 3.0)
    draw.add_text(ImVec2(low.x + 6, top + 3), color((1.0, 1.0, 1.0, 1.0)), text)


# Compass

_NAMES = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
_STEP_DEG, _STEP_M_S = 5.0, 0.5
_TURNS = ((imgui.Key.left_arrow, -1, 0), (imgui.Key.right_arrow, 1, 0), (imgui.Key.up_arrow, 0, 1),
          (imgui.Key.down_arrow, 0, -1))  # fmt: skip


def compass(
    name: str, from_deg: float, speed_m_s: float, full_m_s: float, diameter_px: float, help_text: str
) -> tuple[bool, float, float]:
    """Draw a wind's compass, north up; returns whether it has changed, and the direction and speed of the wind.

    The needle comes from where the wind does and ends at the center, and is as long as the wind is fast: `full_m_s`
    reaches the rim. A drag sets both, with Ctrl in steps of 15 degrees; with the focus, arrow keys turn it by 5 degrees
    and change its speed by 0.5 m/s.
    """
    corner, radius = imgui.get_cursor_screen_pos(), diameter_px / 2
    imgui.invisible_button(name, ImVec2(diameter_px, diameter_px), imgui.ButtonFlags_.enable_nav)
    imgui.set_item_tooltip(help_text)
    is_active, is_hovered, is_focused = imgui.is_item_active(), imgui.is_item_hovered(), imgui.is_item_focused()
    center, rim = ImVec2(corner.x + radius, corner.y + radius), radius - 0.8 * imgui.get_font_size()
    turned, faster = from_deg, speed_m_s
    if is_active and imgui.is_mouse_down(_LEFT):
        mouse, io = imgui.get_mouse_pos(), imgui.get_io()
        x, y = mouse.x - center.x, center.y - mouse.y
        faster = round(min(math.hypot(x, y) / rim, 1.0) * full_m_s, 1)
        step = 15.0 if io.key_ctrl else 1.0
        if faster > 0:
            turned = round(math.degrees(math.atan2(x, y)) / step) * step % 360
    elif is_focused:
        for key, right, up in _TURNS:
            imgui.internal.set_key_owner(key, imgui.get_item_id())
            if imgui.is_key_pressed(key):
                turned = (turned + right * _STEP_DEG) % 360
                faster = min(max(faster + up * _STEP_M_S, 0.0), full_m_s)
    _draw_compass(center, rim, from_deg, min(speed_m_s / full_m_s, 1.0), is_active or is_hovered or is_focused)
    return (turned, faster) != (from_deg, speed_m_s), turned, faster


def compass_name(from_deg: float) -> str:
    """Return the direction of the eight of the compass that is nearest."""
    return _NAMES[round(from_deg / 45) % 8]


def _draw_compass(center: ImVec2, rim: float, from_deg: float, share: float, is_lit: bool) -> None:
    draw, ink = imgui.get_window_draw_list(), color(int(imgui.Col_.text))
    faint = color(int(imgui.Col_.text_disabled))
    draw.add_circle_filled(center, rim, color(int(imgui.Col_.frame_bg_hovered if is_lit else imgui.Col_.frame_bg)))
    draw.add_circle(center, rim, color(int(imgui.Col_.border)), 0, 1.5)
    draw.add_circle(center, rim / 2, color(int(imgui.Col_.separator)))

    def at(degrees: float, reach: float) -> ImVec2:
        angle = math.radians(degrees)
        return ImVec2(center.x + rim * reach * math.sin(angle), center.y - rim * reach * math.cos(angle))

    for number in range(16):
        draw.add_line(at(22.5 * number, 0.86 if number % 4 == 0 else 0.93), at(22.5 * number, 1.0), faint)
    for number in (0, 2, 4, 6):
        size, place = imgui.calc_text_size(_NAMES[number]), at(45.0 * number, 1.0 + 0.5 * imgui.get_font_size() / rim)
        draw.add_text(ImVec2(place.x - size.x / 2, place.y - size.y / 2), ink if number == 0 else faint, _NAMES[number])
    hue = color(int(imgui.Col_.slider_grab_active))
    if share > 0:
        tail, head = at(from_deg, share), at(from_deg + 180.0, 0.12 * share)
        draw.add_line(tail, center, hue, 3.0)
        side = [ImVec2(center.x + 0.09 * (each.x - center.x), center.y + 0.09 * (each.y - center.y))
                for each in (at(from_deg + 90, 1.0), at(from_deg - 90, 1.0))]  # fmt: skip
        draw.add_triangle_filled(head, *side, hue)
        draw.add_circle_filled(tail, 5.0, hue)
    draw.add_circle_filled(center, 2.5, ink)
