"""The viewport: the picture, navigation by mouse and keys, outlines of the rain regions, a small toolbar."""

from collections.abc import Callable
from typing import get_args

from imgui_bundle import ImVec2, ImVec4, imgui

from gsrain_engine.render.look import Look
from gsrain_engine.session.region_outlines import region_outlines
from gsrain_engine.session.session import Session, Split, ViewOptions

from .divider import draw_divider
from .notice import draw_notice
from .overlays import OVERLAYS
from .tool_bar import tool_bar
from .tools import TOOLS
from .viewport import Viewport

TexturesOf = Callable[[int, int], list[int]]
"""Draws the session for a size in pixels and returns the OpenGL names of its sides, from left to right."""

_OUTLINE = {"streak region": ImVec4(0.45, 0.85, 1.0, 0.9), "haze region": ImVec4(1.0, 0.8, 0.45, 0.9)}
_RADIANS_PER_PIXEL = 0.005
_FAST = 4.0
_KEYS = {
    imgui.Key.w: (1, 0, 0), imgui.Key.s: (-1, 0, 0), imgui.Key.d: (0, 1, 0), imgui.Key.a: (0, -1, 0),
    imgui.Key.e: (0, 0, 1), imgui.Key.q: (0, 0, -1),
}  # fmt: skip

HELP = (
    "Left drag: orbit    right drag: look around    middle drag: pan    wheel: nearer, farther\n"
    "W A S D: fly    Q E: down, up    Shift: faster    Ctrl+wheel: fly speed\n"
    "F: frame the scene    R: back to the start    Space: play, pause    F12: screenshot"
)


def viewport_panel(session: Session, textures_of: TexturesOf) -> None:
    """Draw the panel."""
    _toolbar(session)
    size = imgui.get_content_region_avail()
    width, height = max(int(size.x), 16), max(int(size.y), 16)
    corner = imgui.get_cursor_screen_pos()
    textures = textures_of(width, height)
    at = round(session.view.divider * width) if len(textures) == 2 else 0
    if at > 0:
        imgui.image(imgui.ImTextureRef(textures[0]), ImVec2(at, height), ImVec2(0, 0), ImVec2(at / width, 1))
        imgui.set_cursor_screen_pos(ImVec2(corner.x + at, corner.y))
    if at < width:
        imgui.image(imgui.ImTextureRef(textures[-1]), ImVec2(width - at, height), ImVec2(at / width, 0), ImVec2(1, 1))
    if len(textures) == 2:
        draw_divider(session, corner, width, height)
    imgui.set_cursor_screen_pos(corner)
    imgui.set_next_item_allow_overlap()
    flags = imgui.ButtonFlags_.mouse_button_left | imgui.ButtonFlags_.mouse_button_right
    imgui.invisible_button("view", ImVec2(width, height), flags | imgui.ButtonFlags_.mouse_button_middle)
    hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
    viewport = Viewport(corner, width, height, session.shot(width, height), hovered, active)
    imgui.get_window_draw_list().push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height), True)
    taken = [overlay(session, viewport) for overlay in OVERLAYS]
    tool = next((each for each in TOOLS if each.name == session.view.tool), None)
    is_taken = any(taken) or (tool is not None and tool.draw(session, viewport))
    _outlines(session, corner, width, height)
    imgui.get_window_draw_list().pop_clip_rect()
    _mouse(session, viewport, is_taken)
    _keyboard(session)
    tool_bar(session, corner)
    draw_notice(session, corner, width, height)


def _toolbar(session: Session) -> None:
    if imgui.button("Pause" if session.clock.playing else "Play"):
        session.clock.toggle()
    imgui.set_item_tooltip("Let time go on or stop it (Space).")
    imgui.same_line()
    _, session.view.follow_path = imgui.checkbox("Ride along", session.view.follow_path)
    imgui.set_item_tooltip("Ride along the scene's own path: its ego vehicle, or a swing around its middle.")
    imgui.same_line()
    if imgui.button("Frame"):
        session.frame_scene()
    imgui.set_item_tooltip("Back off until the whole scene can be seen (F).")
    imgui.same_line()
    if imgui.button("Home"):
        session.go_home()
    imgui.set_item_tooltip("Back to where the scene was first looked at from (R).")
    imgui.same_line()
    if imgui.button("Screenshot"):
        session.take_screenshot()
    imgui.set_item_tooltip("Save the picture as PNG (F12); the log says where.")
    imgui.same_line()
    _choice("##look", session.view, "look", get_args(Look), "Look: the picture, or what it is made of.", 7.5)
    imgui.same_line()
    _choice("##split", session.view, "split", get_args(Split), "Compare two pictures side by side.", 9.5)
    imgui.same_line()
    imgui.text_disabled(f"{session.clock.time_s:8.2f} s    fly {session.navigation.speed_m_s:.1f} m/s    (?)")
    imgui.set_item_tooltip(HELP)


def _choice(
    name: str, options: ViewOptions, field: str, choices: tuple[str, ...], help_text: str, width_em: float
) -> None:
    imgui.set_next_item_width(width_em * imgui.get_font_size())
    changed, picked = imgui.combo(name, choices.index(getattr(options, field)), list(choices))
    imgui.set_item_tooltip(help_text)
    if changed:
        setattr(options, field, choices[picked])


def _outlines(session: Session, corner: ImVec2, width: int, height: int) -> None:
    draw = imgui.get_window_draw_list()
    for outline in region_outlines(session, width, height):
        color = imgui.get_color_u32(_OUTLINE[outline.name])
        for (x0, y0), (x1, y1) in outline.lines_px.tolist():
            draw.add_line(ImVec2(corner.x + x0, corner.y + y0), ImVec2(corner.x + x1, corner.y + y1), color, 1.5)


def _mouse(session: Session, viewport: Viewport, is_taken: bool) -> None:
    navigation, io = session.navigation, imgui.get_io()
    if viewport.active:
        moved = io.mouse_delta
        if is_taken and imgui.is_mouse_down(imgui.MouseButton_.left):
            return
        if moved.x or moved.y:
            session.view.follow_path = False
        if imgui.is_mouse_down(imgui.MouseButton_.left):
            navigation.orbit(moved.x * _RADIANS_PER_PIXEL, -moved.y * _RADIANS_PER_PIXEL)
        elif imgui.is_mouse_down(imgui.MouseButton_.right):
            navigation.turn(-moved.x * _RADIANS_PER_PIXEL, -moved.y * _RADIANS_PER_PIXEL)
        elif imgui.is_mouse_down(imgui.MouseButton_.middle):
            navigation.pan(-moved.x / viewport.height, moved.y / viewport.height)
    if viewport.hovered and io.mouse_wheel:
        if io.key_ctrl:
            navigation.change_speed(io.mouse_wheel)
        else:
            session.view.follow_path = False
            navigation.dolly(io.mouse_wheel)


def _keyboard(session: Session) -> None:
    io = imgui.get_io()
    if io.want_text_input or not imgui.is_window_hovered(imgui.HoveredFlags_.root_and_child_windows):
        session.navigation.stop()
        return
    pressed = [direction for key, direction in _KEYS.items() if imgui.is_key_down(key)] if not io.key_ctrl else []
    if not pressed:
        session.navigation.stop()
        return
    session.view.follow_path = False
    forward, right, up = (sum(axis) for axis in zip(*pressed, strict=True))
    fast = _FAST if io.key_shift else 1.0
    # The frame in which a key went down may have begun long before: nothing moved then.
    held_s = io.delta_time if session.navigation.is_flying else 0.0
    session.navigation.fly(fast * forward, fast * right, fast * up, held_s)
