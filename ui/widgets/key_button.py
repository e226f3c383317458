"""The small diamond beside a field that can have keys over time: grey without, lit with, bright at a key's own time."""

from imgui_bundle import ImVec4, icons_fontawesome_6, imgui

from gsrain_engine.rain.weather import Keyed
from gsrain_engine.session.session import Session

from . import fields
from .square_button import square_button

KEYED = ImVec4(0.95, 0.66, 0.25, 1.0)
HERE = ImVec4(1.0, 0.93, 0.45, 1.0)

_TITLES = {"intensity_mm_h": "intensity", "wind_m_s": "wind", "exposure_s": "exposure"}


def key_button_width() -> float:
    """Room that the button takes, with the gap before it."""
    return imgui.get_frame_height() + imgui.get_style().item_spacing.x


def key_button(session: Session, name: Keyed) -> None:
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
        toggle_key(session, name)


def toggle_key(session: Session, name: Keyed) -> None:
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


def tint_keyed(session: Session, name: Keyed) -> int:
    """Tint the frame of the next field if it has keys; returns how many colours to pop."""
    if not session.weather.is_keyed(name):
        return 0
    imgui.push_style_color(imgui.Col_.frame_bg, ImVec4(KEYED.x, KEYED.y, KEYED.z, 0.22))
    return 1


def keyed_slider(session: Session, name: Keyed, *, high: float) -> None:
    """Edit a number that can have keys."""
    colors = tint_keyed(session, name)
    fields.slider(session, name, high=high, beside_px=key_button_width())
    imgui.pop_style_color(colors)
    key_button(session, name)
