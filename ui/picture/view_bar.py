"""The bar above the picture: time, where from, what is shown."""

from typing import get_args

from imgui_bundle import icons_fontawesome_6, imgui

from gsrain_engine.render.look import Look
from gsrain_engine.session.session import Session
from gsrain_engine.session.view.view_options import Split, ViewOptions

_ICONS = icons_fontawesome_6


def view_bar(session: Session) -> None:
    playing = session.clock.playing
    icon = _ICONS.ICON_FA_PAUSE if playing else _ICONS.ICON_FA_PLAY
    if _button(icon, "Play", "Let time go on or stop it (Space)."):
        session.clock.toggle()
    if _button(
        _ICONS.ICON_FA_EXPAND,
        "Frame",
        "Back off until what is chosen under Layers, or else the whole scene, can be seen (F).",
    ):
        session.frame_scene()
    if _button(_ICONS.ICON_FA_HOUSE, "Home", "Back to where the scene was first looked at from (R)."):
        session.go_home()
    if _button(_ICONS.ICON_FA_CAMERA, "Screenshot", "Save the picture as PNG (F12); the log says where."):
        session.take_screenshot()
    _, session.view.follow_path = imgui.checkbox("Ride along", session.view.follow_path)
    imgui.set_item_tooltip("Ride along the camera path: your own keys, else the ego vehicle's drive or a swing (V).")
    imgui.same_line()
    _choice("##look", session.view, "look", get_args(Look), "Look: the picture, or what it is made of.", 9, "Look: ")
    imgui.same_line()
    _choice("##split", session.view, "split", get_args(Split), "Compare two pictures side by side.", 11, "Compare: ")
    imgui.same_line()
    words = f"{session.clock.time_s:.2f} s   flies {session.navigation.speed_m_s:.3g} m/s"
    if imgui.calc_text_size(words).x < imgui.get_content_region_avail().x:
        imgui.text_disabled(words)
        imgui.set_item_tooltip("Time in the scene, and how fast W A S D fly (Ctrl+wheel). F1 shows all keys.")
    else:
        imgui.new_line()


def _button(icon: str, name: str, help_text: str) -> bool:
    clicked = imgui.button(f"{icon}###{name}")
    imgui.set_item_tooltip(f"{name}: {help_text}")
    imgui.same_line()
    return clicked


def _choice(
    name: str, options: ViewOptions, field: str, choices: tuple[str, ...], help_text: str, width_em: float, title: str
) -> None:
    imgui.set_next_item_width(width_em * imgui.get_font_size())
    present = getattr(options, field)
    if imgui.begin_combo(name, f"{title}{present}"):
        for each in choices:
            if imgui.selectable(each, each == present)[0]:
                setattr(options, field, each)
        imgui.end_combo()
    imgui.set_item_tooltip(help_text)
