"""The viewport: image, navigation by mouse and keys, region outlines, notices, and the start page."""

from collections.abc import Callable

from imgui_bundle import ImVec2, ImVec4, icons_fontawesome_6, imgui

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.rain_regions import region_outlines

from ..commands.registry import ACTIONS
from ..tools.registry import TOOLS
from ..widgets.draw import Viewport
from ..widgets.text import label
from .overlays import OVERLAYS, draw_divider, preview_side
from .toolbar import tool_bar, tool_options, view_bar

TexturesOf = Callable[[int, int], list[int]]
"""Draws the session in a size in pixels and returns the OpenGL names of its sides, from left to right."""

_OUTLINE = {"streak region": ImVec4(0.45, 0.85, 1.0, 0.9), "haze region": ImVec4(1.0, 0.8, 0.45, 0.9)}
_RADIANS_PER_PIXEL = 0.005
_FAST = 4.0

_KEYS = {
    imgui.Key.w: (1, 0, 0), imgui.Key.s: (-1, 0, 0), imgui.Key.d: (0, 1, 0), imgui.Key.a: (0, -1, 0),
    imgui.Key.e: (0, 0, 1), imgui.Key.q: (0, 0, -1),
}  # fmt: skip


def viewport_panel(session: Editor, textures_of: TexturesOf) -> None:
    view_bar(session)
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
    labels = preview_side(session, corner, width, height)
    if len(textures) == 2:
        labels = session.split_panes[0].label, session.split_panes[1].label
    if labels is not None:
        draw_divider(session, labels, corner, width, height)
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
    left = tool_bar(session, corner, height)
    tool_options(session, corner, left, width)
    empty_state(session, corner, width, height)
    draw_notice(session, corner, width, height)


def _outlines(session: Editor, corner: ImVec2, width: int, height: int) -> None:
    draw = imgui.get_window_draw_list()
    for name, lines_px in region_outlines(session, width, height).items():
        color = imgui.get_color_u32(_OUTLINE[name])
        for (x0, y0), (x1, y1) in lines_px.tolist():
            draw.add_line(ImVec2(corner.x + x0, corner.y + y0), ImVec2(corner.x + x1, corner.y + y1), color, 1.5)


def _mouse(session: Editor, viewport: Viewport, is_taken: bool) -> None:
    navigation, io = session.navigation, imgui.get_io()
    if viewport.active:
        moved = io.mouse_delta
        if is_taken and imgui.is_mouse_down(imgui.MouseButton_.left):
            return
        if moved.x or moved.y:
            session.stop_riding()
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
            session.stop_riding()
            session.dolly(io.mouse_wheel)


def _keyboard(session: Editor) -> None:
    io = imgui.get_io()
    if io.want_text_input or not imgui.is_window_hovered(imgui.HoveredFlags_.root_and_child_windows):
        session.navigation.stop()
        return
    pressed = [direction for key, direction in _KEYS.items() if imgui.is_key_down(key)] if not io.key_ctrl else []
    if not pressed:
        session.navigation.stop()
        return
    session.stop_riding()
    forward, right, up = (sum(axis) for axis in zip(*pressed, strict=True))
    fast = _FAST if io.key_shift else 1.0
    # The frame in which a key was pressed may have begun long before: don't move in that one.
    held_s = io.delta_time if session.navigation.is_flying else 0.0
    session.navigation.fly(fast * forward, fast * right, fast * up, held_s)


# Start page without a scene

_WIDTH_EM = 30.0
_OFFERED = ("Open...", "Open the built-in street")
_MAX_RECENT = 6


def empty_state(session: Editor, corner: ImVec2, width: int, height: int) -> None:
    """Draw the offers if no scene is open or loading."""
    if session.scene.members or session.busy is not None:
        return
    wide = min(_WIDTH_EM * imgui.get_font_size(), width - 20.0)
    imgui.set_cursor_screen_pos(ImVec2(corner.x + (width - wide) / 2, corner.y + 0.25 * height))
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("empty", ImVec2(wide, 0), flags):
        imgui.text_wrapped("No scene is open. Drop a scene file or folder here, or begin with one of these.")
        imgui.spacing()
        for action in ACTIONS:
            if action.name in _OFFERED and imgui.button(action.name, ImVec2(-1, 0)):
                action.perform(session)
        recent = session.files.recent[:_MAX_RECENT]
        if recent:
            imgui.separator_text("Recent")
        for path in recent:
            if imgui.button(
                label(f"{icons_fontawesome_6.ICON_FA_CLOCK_ROTATE_LEFT}  {path.name}", str(path)), ImVec2(-1, 0)
            ):
                session.open(str(path))
            imgui.set_item_tooltip(str(path))
    imgui.end_child()


# Notices

_NOTICE_WIDTH_EM = 34.0
_MARGIN = 10.0


def draw_notice(session: Editor, corner: ImVec2, width: int, height: int) -> None:
    """Draw an animated bar while a scene loads, and the last error."""
    if session.busy is not None:
        _busy(session.busy, corner, width, height)
    if session.problem is not None:
        _problem(session, session.problem, corner, width, height)


def _busy(words: str, corner: ImVec2, width: int, height: int) -> None:
    wide = min(_NOTICE_WIDTH_EM * imgui.get_font_size(), width - 2 * _MARGIN)
    imgui.set_cursor_screen_pos(ImVec2(corner.x + (width - wide) / 2, corner.y + 0.4 * height))
    if _begin("busy", wide):
        imgui.text_wrapped(words)
        imgui.progress_bar(-imgui.get_time(), ImVec2(-1, 0), "")
    _end()


def _problem(session: Editor, problem: str, corner: ImVec2, width: int, height: int) -> None:
    wide = min(_NOTICE_WIDTH_EM * imgui.get_font_size(), width - 2 * _MARGIN)
    padding = imgui.get_style().window_padding
    words = f"{icons_fontawesome_6.ICON_FA_TRIANGLE_EXCLAMATION}  {problem}"
    text_height = imgui.calc_text_size(words, False, wide - 2 * padding.x).y
    tall = text_height + 2 * padding.y + imgui.get_frame_height_with_spacing()
    at = ImVec2(corner.x + width - wide - _MARGIN, corner.y + height - tall - _MARGIN)
    imgui.set_cursor_screen_pos(at)
    if _begin("problem", wide):
        imgui.push_style_color(imgui.Col_.text, (0.95, 0.45, 0.38, 1.0))
        imgui.text_wrapped(words)
        imgui.pop_style_color()
        if imgui.button("Close"):
            session.problem = None
        imgui.same_line()
        if imgui.button("Details"):
            imgui.set_window_focus("Log")
        imgui.set_item_tooltip("Show the log, which has the rest.")
        imgui.same_line()
        if imgui.button("Copy"):
            imgui.set_clipboard_text(problem)
        imgui.set_item_tooltip("Put the sentence on the clipboard.")
    _end()


def _begin(name: str, wide: float) -> bool:
    color = imgui.get_style_color_vec4(imgui.Col_.popup_bg)
    imgui.push_style_color(imgui.Col_.child_bg, (color.x, color.y, color.z, 0.94))
    imgui.push_style_var(imgui.StyleVar_.child_rounding, 5.0)
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.borders
    return imgui.begin_child(name, ImVec2(wide, 0), flags)


def _end() -> None:
    imgui.end_child()
    imgui.pop_style_var()
    imgui.pop_style_color()
