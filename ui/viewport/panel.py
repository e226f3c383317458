"""The viewport: image, navigation by mouse and keys, region outlines, and bars."""

from collections.abc import Sequence

import moderngl
from imgui_bundle import ImVec2, ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.rain_regions import region_outlines
from gsrain_engine.editor.viewport_state import ViewportState

from ..commands.keys import chord_name
from ..commands.table import RENDER_MODE_HELP, SPLIT_HELP
from ..folding import FoldedPanels
from ..parts import bind_parts
from ..tools import TOOLS
from ..tools.base import Tool
from ..widgets.draw import EDGE_MARGIN, Canvas, FreeEdges, draw_lines, draw_point
from ..widgets.fields import button, rows_beyond
from ..widgets.type_ahead import has_keys
from .first_run import draw_corner_card, draw_setup_bar, draw_start_card
from .notices import card, draw_notices, notice_room
from .overlays import OVERLAYS, draw_divider, draw_spinner, preview_side

_OUTLINE = {"streak region": ImVec4(0.45, 0.85, 1.0, 0.9), "haze region": ImVec4(1.0, 0.8, 0.45, 0.9)}


def viewport_panel(
    editor: Editor,
    tools: Sequence[Tool],
    picture: DrawResult,
    shown: Sequence[moderngl.Texture],
    folded: FoldedPanels,
) -> tuple[int, int]:
    """Draw the panel with what is `shown` of the last picture. Returns width and height of the next one in pixels."""
    view_bar(editor, imgui.get_content_region_avail().x - folded.width)
    size = imgui.get_content_region_avail()
    width, height = max(int(size.x - folded.width), 16), max(int(size.y), 16)
    corner = imgui.get_cursor_screen_pos()
    edges = _draw_bars(editor, tools, corner, width, height)
    imgui.set_cursor_screen_pos(corner)
    textures = [texture.glo for texture in shown]
    at = round(editor.viewport.options.divider * width) if len(textures) == 2 else 0
    if at > 0:
        imgui.image(imgui.ImTextureRef(textures[0]), ImVec2(at, height), ImVec2(0, 0), ImVec2(at / width, 1))
        imgui.set_cursor_screen_pos(ImVec2(corner.x + at, corner.y))
    if textures and at < width:
        imgui.image(imgui.ImTextureRef(textures[-1]), ImVec2(width - at, height), ImVec2(at / width, 0), ImVec2(1, 1))
    labels = preview_side(editor.viewport, editor.wet_look, corner, width, height)
    panes = editor.split_panes if len(textures) < 2 or picture.frame is None else picture.frame.panes
    if len(panes) == 2:
        labels = panes[0].label, panes[1].label
    if labels is not None:
        draw_divider(editor.viewport, labels, corner, width, height, edges.top)
        if len(textures) < len(panes):  # the last picture is on both sides
            draw_spinner(ImVec2(corner.x + editor.viewport.options.divider * width / 2, corner.y + height / 2))
    imgui.set_cursor_screen_pos(corner)
    imgui.set_next_item_allow_overlap()
    flags = imgui.ButtonFlags_.mouse_button_left | imgui.ButtonFlags_.mouse_button_right
    imgui.invisible_button("view", ImVec2(width, height), flags | imgui.ButtonFlags_.mouse_button_middle)
    hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
    canvas = Canvas(corner, width, height, editor.viewport.canvas_view(width, height), hovered, active, edges)
    imgui.get_window_draw_list().push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height), True)
    use_button = [bind_parts(overlay, editor, canvas=canvas)() for overlay in OVERLAYS]
    tool = _active_tool(editor.viewport, tools)
    uses_button = any(use_button) or (tool is not None and tool.draw(canvas))
    for name, lines_px in region_outlines(
        editor.viewport, editor.rollouts.displayed_scene, editor.live_rain.displayed, width, height
    ).items():
        draw_lines(canvas, lines_px.tolist(), _OUTLINE[name], 1.5)
    imgui.get_window_draw_list().pop_clip_rect()
    _navigate_by_mouse(editor.viewport, canvas, uses_button)
    _navigate_by_keys(editor.viewport)
    draw_notices(editor, canvas)
    folded.draw(ImVec2(corner.x + width, corner.y), height)
    return width, height


def _active_tool(viewport: ViewportState, tools: Sequence[Tool]) -> Tool | None:
    return next((each for each in tools if each.name == viewport.options.tool), None)


_MAX_BARS = 0.45  # height of the bars at the upper edge, as a share of the viewport's


def _draw_bars(editor: Editor, tools: Sequence[Tool], corner: ImVec2, width: int, height: int) -> FreeEdges:
    """Draw bars and cards at the edges of the viewport; returns the room that they leave."""
    edges = FreeEdges(left=tool_bar(editor.viewport, corner, height))
    tool = _active_tool(editor.viewport, tools)
    if tool is not None:
        edges.top = tool_options(tool, corner, edges.left, width, _MAX_BARS * height)
    if not editor.document.scene.members and editor.busy is None:
        draw_start_card(editor, corner, width, height)
    elif editor.scene_setup.is_open:
        top = edges.top or _MARGIN
        room = _MAX_BARS * height - top
        if tool is None or room > 2 * imgui.get_frame_height():  # else it waits until the tool is left
            edges.top = draw_setup_bar(editor, corner, edges.left, width, top, room)
    draw_corner_card(editor, corner, edges, width, height)
    edges.max_bottom = height / 2 - EDGE_MARGIN - notice_room(editor)[1]
    return edges


_RADIANS_PER_PIXEL = 0.005
_PAN_PER_STEP = 0.05  # share of the image height
_FAST = 4.0
_KEYS = {
    imgui.Key.w: (1, 0, 0), imgui.Key.s: (-1, 0, 0), imgui.Key.d: (0, 1, 0), imgui.Key.a: (0, -1, 0),
    imgui.Key.e: (0, 0, 1), imgui.Key.q: (0, 0, -1),
}  # fmt: skip


def _navigate_by_mouse(viewport: ViewportState, canvas: Canvas, uses_left: bool) -> None:
    navigation, io = viewport.navigation, imgui.get_io()
    if canvas.hovered and not uses_left and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        viewport.set_pivot(*canvas.mouse_px, canvas.width, canvas.height)
    if canvas.active:
        moved = io.mouse_delta
        if uses_left and imgui.is_mouse_down(imgui.MouseButton_.left):
            return
        if moved.x or moved.y:
            viewport.stop_riding()
            navigation = viewport.navigation
        if imgui.is_mouse_down(imgui.MouseButton_.left):
            viewport.orbit(moved.x * _RADIANS_PER_PIXEL, -moved.y * _RADIANS_PER_PIXEL)
            if navigation.pivot is not None:
                draw_point(canvas, navigation.pivot)
        elif imgui.is_mouse_down(imgui.MouseButton_.right):
            navigation.turn(-moved.x * _RADIANS_PER_PIXEL, -moved.y * _RADIANS_PER_PIXEL)
        elif imgui.is_mouse_down(imgui.MouseButton_.middle):
            navigation.pan(-moved.x / canvas.height, moved.y / canvas.height)
    if canvas.hovered and io.mouse_wheel:
        if io.key_ctrl:
            navigation.change_speed(io.mouse_wheel)
        else:
            viewport.stop_riding()
            viewport.dolly(io.mouse_wheel)
    if canvas.hovered and io.mouse_wheel_h:  # of a tilting wheel, or two fingers on a trackpad
        viewport.stop_riding()
        viewport.navigation.pan(-_PAN_PER_STEP * io.mouse_wheel_h, 0.0)


def _navigate_by_keys(viewport: ViewportState) -> None:
    io, navigation = imgui.get_io(), viewport.navigation
    is_here = imgui.is_window_hovered(imgui.HoveredFlags_.root_and_child_windows)
    listens = is_here and not (io.want_text_input or io.key_ctrl or io.key_alt or has_keys())
    pressed = [direction for key, direction in _KEYS.items() if listens and imgui.is_key_down(key)]
    if not pressed:
        navigation.stop()
        return
    viewport.stop_riding()
    fast = _FAST if io.key_shift else 1.0
    # The frame in which a key was pressed may have begun long before: don't move in that one.
    held_s = io.delta_time if navigation.is_flying else 0.0
    directions = (fast * sum(axis) for axis in zip(*pressed, strict=True))
    navigation.fly(*directions, held_s, across=viewport.options.orthographic)


# Bars: tools, settings of the active tool, and view options

_GAP, _MARGIN, _PADDING = 3.0, 8.0, 8.0
_MAX_COLUMNS, _MENU_COLUMNS = 2, 4  # of tools over the view; where more are needed, a button opens them as a menu


def tool_bar(viewport: ViewportState, corner: ImVec2, height: float) -> float:
    """Draw the bar over the viewport; a click activates a tool or deactivates it. Returns its right edge."""
    side = 1.9 * imgui.get_font_size()
    columns = -(-(len(TOOLS) + 1) // max(int((height - 24) / (side + _GAP)), 1))
    imgui.set_cursor_screen_pos(ImVec2(corner.x + _MARGIN, corner.y + _MARGIN))
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(4, 4))
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(_GAP, _GAP))
    with card("tools", 0, imgui.Col_.window_bg, 0.82, imgui.ChildFlags_.auto_resize_x):
        if columns <= _MAX_COLUMNS:
            _tool_buttons(viewport, columns, side)
        else:
            columns = 1
            icon = next((tool.icon for tool in TOOLS if tool.name == viewport.options.tool), _NAVIGATE)
            if imgui.button(f"{icon}###tools", ImVec2(side, side)):
                imgui.open_popup("tools")
            imgui.set_item_tooltip("Tools: what a left drag and a click in the view do.")
            if imgui.begin_popup("tools"):
                if _tool_buttons(viewport, _MENU_COLUMNS, side):
                    imgui.close_current_popup()
                imgui.end_popup()
    imgui.pop_style_var(2)
    return _MARGIN + columns * (side + _GAP) + _MARGIN


_NAVIGATE = icons.ICON_FA_ARROW_POINTER


def _tool_buttons(viewport: ViewportState, columns: int, side: float) -> bool:
    """Draw the button of each tool; returns True if one is clicked."""
    before = viewport.options.tool
    if is_chosen := _tool_button(_NAVIGATE, "Navigate", before == "", side):
        viewport.options.tool = ""
    imgui.set_item_tooltip("Navigate: the left button orbits (Esc).")
    for number, tool in enumerate(TOOLS, start=1):
        if number % columns:
            imgui.same_line()
        if _tool_button(tool.icon, tool.name, before == tool.name, side):
            viewport.options.tool, is_chosen = "" if before == tool.name else tool.name, True
        key = f" ({chord_name(int(tool.key))})" if tool.key is not None else ""
        imgui.set_item_tooltip(f"{tool.name}{key}: {tool.help}")
    return is_chosen


def _tool_button(icon: str, name: str, is_on: bool, side: float) -> bool:
    color = imgui.Col_.button_active if is_on else imgui.Col_.child_bg
    imgui.push_style_color(imgui.Col_.button, imgui.get_style_color_vec4(color))
    clicked = imgui.button(f"{icon}##{name}", ImVec2(side, side))
    imgui.pop_style_color()
    return clicked


def tool_options(tool: Tool, corner: ImVec2, left: float, width: float, max_height: float) -> float:
    """Draw the bar of the active tool over the viewport, from `left` on; returns the distance of its end from the top.

    It is as wide as its content, so that what is right of it can be seen and dragged; its rows break at the viewport's
    edge. In a small view it scrolls.
    """
    imgui.set_cursor_screen_pos(ImVec2(corner.x + left, corner.y + _MARGIN))
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(_PADDING, 5))
    widths, key = imgui.get_state_storage(), imgui.get_id(f"width of {tool.name}")
    room = max(width - left - _MARGIN, 50)
    wide = widths.get_float(key, room)
    scrolls = imgui.WindowFlags_.horizontal_scrollbar if wide > room else imgui.WindowFlags_.none
    high = max_height - _MARGIN - _GAP
    color, width = imgui.Col_.window_bg, min(wide, room)
    with card("tool options", width, color, 0.82, window_flags=scrolls, max_height=high), rows_beyond(room - width):
        imgui.begin_group()
        imgui.align_text_to_frame_padding()
        imgui.text(tool.name)
        imgui.set_item_tooltip(tool.help)
        imgui.same_line(0, 12)
        tool.options()
        imgui.end_group()
        widths.set_float(key, imgui.get_item_rect_size().x + 2 * _PADDING)
    imgui.pop_style_var()
    return _MARGIN + imgui.get_item_rect_size().y + _GAP


def view_bar(editor: Editor, width: float) -> None:
    """Draw the bar above the viewport, so many pixels wide; what has no room there is in the menu View."""
    right = imgui.get_cursor_screen_pos().x + width
    clock, viewport = editor.playback.clock, editor.viewport
    frame_help = "Move back until the selection, else the chosen layers and actors, else the scene is visible (F)."
    for icon, name, help_text, act in (
        (icons.ICON_FA_PAUSE if clock.playing else icons.ICON_FA_PLAY, "Play", "Start or stop time (Space).",
         clock.toggle),
        (icons.ICON_FA_EXPAND, "Frame", frame_help, viewport.frame_scene),
        (icons.ICON_FA_HOUSE, "Home", "Return to the initial view of the scene (R).", viewport.go_home),
        (icons.ICON_FA_CAMERA, "Screenshot", "Save the viewport as PNG (F12); the log has its path.",
         editor.take_screenshot),
    ):  # fmt: skip
        if button(f"{icon}###{name}", f"{name}: {help_text}"):
            act()
        imgui.same_line()
    _, editor.viewport.options.follow_path = imgui.checkbox("Follow path", editor.viewport.options.follow_path)
    imgui.set_item_tooltip(
        "Follow the camera path: your own keyframes, else the recording vehicle's drive, or a swing (V)."
    )
    for field, title, choices, width_em, help_text in (
        ("look", "Mode", RENDER_MODE_HELP, 9, "Render mode of the viewport."),
        ("split", "Compare", SPLIT_HELP, 11, "Compare two images side by side."),
    ):
        imgui.same_line()
        if imgui.get_cursor_screen_pos().x + width_em * imgui.get_font_size() > right:
            imgui.new_line()
            return
        imgui.set_next_item_width(width_em * imgui.get_font_size())
        present = getattr(editor.viewport.options, field)
        if imgui.begin_combo(f"##{field}", f"{title}: {present}"):
            for each in choices:
                if imgui.selectable(each, each == present)[0]:
                    setattr(editor.viewport.options, field, each)
                imgui.set_item_tooltip(choices[each])
            imgui.end_combo()
        else:
            imgui.set_item_tooltip(f"{help_text}\n{choices[present]}")
    imgui.same_line()
    words = f"{editor.playback.clock.time_s:.2f} s   Fly speed {editor.viewport.navigation.speed_m_s:.3g} m/s"
    if imgui.calc_text_size(words).x < imgui.get_content_region_avail().x:
        imgui.text_disabled(words)
        imgui.set_item_tooltip("Time in the scene, and speed of W A S D (Ctrl+wheel). F1 shows all keys.")
    else:
        imgui.new_line()
