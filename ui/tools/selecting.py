"""What the selection tools share: how what they find is taken, and the settings that say so."""

from typing import get_args

import numpy as np
from imgui_bundle import imgui

from gsrain_engine.session.selection.combine import Mode
from gsrain_engine.session.selection.in_picture import Depths, in_picture
from gsrain_engine.session.selection.steps import select
from gsrain_engine.session.selection.volumes import Volume, in_volume
from gsrain_engine.session.session import Session

from ..widgets.viewport import Viewport

MODIFIERS = "Shift adds, Ctrl removes, both intersect."

_MODE_HELP: dict[Mode, str] = {
    "set": "Select what the tool finds, and nothing else.",
    "add": "Add what the tool finds (Shift).",
    "remove": "Take away what the tool finds (Ctrl or Alt).",
    "intersect": "Keep only what was selected and is found (Shift+Ctrl).",
}
_DEPTH_HELP = (
    "all through: everything behind the shape as well\n"
    "front-most: only what is seen, not what it hides\n"
    "to a depth: down to so many metres from the camera"
)


def mode_now(session: Session) -> Mode:
    """How what is found is taken: by the keys that are held, else as chosen in the bar."""
    io = imgui.get_io()
    removes = io.key_ctrl or io.key_alt
    if io.key_shift:
        return "intersect" if removes else "add"
    return "remove" if removes else session.selecting.mode


def take_shape(session: Session, viewport: Viewport, pixels: np.ndarray, by: str) -> None:
    found = in_picture(session.scene, viewport.shot, pixels, session.selecting.reach)
    select(session, found, mode_now(session), by)


def apply_volume(session: Session, time_s: float, volume: Volume, by: str, *, now: bool = False) -> None:
    """Select what lies in a volume, if Enter was pressed or `now`."""
    keys = (imgui.Key.enter, imgui.Key.keypad_enter)
    is_entered = not imgui.get_io().want_text_input and any(imgui.is_key_pressed(key, False) for key in keys)
    if now or is_entered:
        select(session, in_volume(session.scene, time_s, volume), mode_now(session), by)


def mode_options(session: Session) -> None:
    """Draw the four ways to take what is found; the one that holds now is lit."""
    now = mode_now(session)
    for number, mode in enumerate(get_args(Mode)):
        if number:
            imgui.same_line(0, 2)
        lit = mode == now
        if lit:
            imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(imgui.Col_.button_active))
        if imgui.button(mode.capitalize()):
            session.selecting.mode = mode
        if lit:
            imgui.pop_style_color()
        imgui.set_item_tooltip(_MODE_HELP[mode])


def shape_options(session: Session) -> None:
    """Draw the settings of tools that draw a shape over the picture."""
    options = session.selecting
    mode_options(session)
    beside(14)
    choices = get_args(Depths)
    imgui.set_next_item_width(7.5 * imgui.get_font_size())
    changed, picked = imgui.combo("##depths", choices.index(options.depths), list(choices))
    imgui.set_item_tooltip(_DEPTH_HELP)
    if changed:
        options.depths = choices[picked]
    if options.depths == "to a depth":
        beside(5.5)
        imgui.set_next_item_width(5.5 * imgui.get_font_size())
        _, options.depth_m = imgui.drag_float("##depth_m", options.depth_m, 0.1, 0.2, 2000.0, "%.1f m")
        imgui.set_item_tooltip("How deep, in metres from the camera along its view axis.")
    beside(6)
    _, options.touching = imgui.checkbox("Touching", options.touching)
    imgui.set_item_tooltip(
        "Take in Gaussians that the shape touches within one standard deviation, not only those whose centre it covers."
    )


def tolerance_option(session: Session) -> None:
    """Draw how far colours may differ."""
    options = session.selecting
    imgui.set_next_item_width(9 * imgui.get_font_size())
    flags = imgui.SliderFlags_.always_clamp
    _, options.tolerance = imgui.drag_float("##tolerance", options.tolerance, 0.005, 0, 1, "tolerance %.2f", flags)
    imgui.set_item_tooltip(
        "How far red, green and blue may each differ from the colour under the mouse, 0..1.\n"
        "Drag, or double-click to type."
    )


def volume_buttons(session: Session, volume: Volume, name: str) -> bool:
    """Draw what can be done with a volume as it stands; returns whether it is to be taken away."""
    beside(11)
    if imgui.button(f"Apply##{name}"):
        apply_volume(session, session.clock.time_s, volume, name, now=True)
    imgui.set_item_tooltip("Select what is inside (Enter), whether the camera sees it or not.")
    imgui.same_line()
    is_dropped = imgui.button(f"Drop##{name}")
    imgui.set_item_tooltip(f"Take the {name} away; the selection stays.")
    return is_dropped


def beside(width_em: float) -> None:
    """Go on in the same line, after a gap, if so much still fits into it; else in the next."""
    imgui.same_line(0, 10)
    if imgui.get_content_region_avail().x < width_em * imgui.get_font_size():
        imgui.new_line()
