"""First steps over the viewport: start card, hint of three steps, news after an update, and the bar of a new scene."""

import math
from functools import cache
from importlib.metadata import version
from typing import get_args

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gsrain_engine.choices import Axis
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.level import set_ground_height
from gsrain_engine.editor.scene_setup import SETUP_MM_H
from gsrain_engine.fields import short_number

from ..commands.table import command_named
from ..widgets.draw import EDGE_MARGIN, FreeEdges
from ..widgets.fields import button
from ..widgets.text import label
from .notices import card, notice_room

# Start card without a scene

_WIDTH_EM = 30.0
_OFFERED = {
    "Open...": icons.ICON_FA_FOLDER_OPEN, "Open built-in street": icons.ICON_FA_ROAD,
    "Open capture folder...": icons.ICON_FA_IMAGES, "What's new": icons.ICON_FA_GIFT,
}  # fmt: skip
_TITLES = {"Open capture folder...": "From images: open a capture, then reconstruct it..."}
_MAX_RECENT = 6


def draw_start_card(editor: Editor, corner: ImVec2, width: int, height: int) -> None:
    """Draw what can be opened, in the middle of the viewport."""
    wide = min(_WIDTH_EM * imgui.get_font_size(), width - 20.0)
    imgui.set_cursor_screen_pos(ImVec2(corner.x + (width - wide) / 2, corner.y + 0.2 * height))
    imgui.set_next_window_size_constraints(ImVec2(0, 0), ImVec2(wide, 0.8 * height - 10.0))
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("empty", ImVec2(wide, 0), flags):
        imgui.text_wrapped("No scene is open. Drop a scene file or folder here, or begin with one of these.")
        imgui.spacing()
        for name, icon in _OFFERED.items():
            command = command_named(name)
            if button(f"{icon}  {_TITLES.get(name, name)}###{name}", command.help, width=-1):
                command.perform(editor)
        recent = editor.files.recent[:_MAX_RECENT]
        if recent:
            imgui.separator_text("Recent")
        for path in recent:
            name = f"{icons.ICON_FA_CLOCK_ROTATE_LEFT}  {label(path.name, str(path))}"
            if imgui.button(name, ImVec2(-1, 0)):
                editor.files.open(str(path))
            imgui.set_item_tooltip(str(path))
    imgui.end_child()


# Card in the lower left corner: three steps, until they were done once, or what is new after an update

_HINT_EM = 15.0
_LINES_EM = 12.0  # width that is left for lines of text at the lower edge


def draw_corner_card(editor: Editor, corner: ImVec2, edges: FreeEdges, width: int, height: int) -> None:
    """Draw the first steps, or after an update, once, an offer to read what is new; newcomers see the first steps.

    A small view, in whose middle it would be, goes without, and so does a narrow one while there are notices.
    """
    preferences = editor.preferences
    has_news = preferences.value.known_version != _version()
    if preferences.value.hint:
        rows, draw = 3, _draw_hint
        if has_news:
            preferences.set(known_version=_version())
        if all(is_done for *_, is_done in _steps(editor)):
            preferences.set(hint=False)
            return
    elif has_news:
        rows, draw = 1, _draw_update
    else:
        return
    wide, padding = _HINT_EM * imgui.get_font_size(), imgui.get_style().window_padding
    tall = imgui.get_text_line_height_with_spacing() + rows * imgui.get_frame_height_with_spacing() + 2 * padding.y
    needed = max(_LINES_EM * imgui.get_font_size(), notice_room(editor)[0])
    if tall + 2 * EDGE_MARGIN > height / 2 or width - edges.left - wide - 2 * EDGE_MARGIN < needed:
        return
    imgui.set_cursor_screen_pos(ImVec2(corner.x + edges.left, corner.y + height - tall - EDGE_MARGIN))
    with card("hint", wide, imgui.Col_.popup_bg, 0.94, imgui.ChildFlags_.borders):
        draw(editor)
    edges.left += wide


def _steps(editor: Editor) -> tuple[tuple[str, str, str, bool], ...]:
    """Return title, command and help of each step, and whether it was done."""
    document, files, jobs = editor.document, editor.files, editor.jobs
    rains = document.rain_now.intensity_mm_h > 0 and not (editor.viewport.is_preparing or editor.awaits_first_picture)
    has_recorded = any(each.kind == "export" for each in jobs.all)
    return (
        ("Open a scene", "Open...", "Choose a file or folder of Gaussians.", files.source not in (None, "street")),
        ("Let it rain", "Moderate 5 mm/h", "Set 5 mm/h.", rains),
        ("Record a video", "Record timeline...", "Choose a place for the video.", has_recorded),
    )


def _draw_hint(editor: Editor) -> None:
    """Draw the three steps; done ones have a check mark, the last one ends the hint."""
    imgui.text_disabled("First steps")
    imgui.same_line((_HINT_EM - 1.4) * imgui.get_font_size() - imgui.get_style().window_padding.x)
    if imgui.small_button("x###end hint"):
        editor.preferences.set(hint=False)
    imgui.set_item_tooltip("Don't show this any more.")
    for number, (title, name, help_text, is_done) in enumerate(_steps(editor), start=1):
        mark = icons.ICON_FA_CHECK if is_done else str(number)
        command = command_named(name)
        keys = f" ({command.key_names})" if command.key_names else ""
        if button(f"{mark}  {title}###step {number}", help_text + keys, width=-1):
            command.perform(editor)


def _draw_update(editor: Editor) -> None:
    """Offer to read what is new."""
    imgui.text(f"GSRAIN was updated to {_version()}.")
    if is_read := button(f"{icons.ICON_FA_GIFT}  What's new###read news", "Show the changes in a few lines."):
        editor.viewport.options.dialog = "news"
    imgui.same_line()
    if button("Close###close update", "Help > What's new shows them later.") or is_read:
        editor.preferences.set(known_version=_version())


@cache
def _version() -> str:
    return version("gsrain")


# Bar of a new scene: up axis, scale, ground, rain


_ROW_EM = 30.0  # a narrower bar is one row, which scrolls


def draw_setup_bar(editor: Editor, corner: ImVec2, left: float, width: int, top: float, max_height: float) -> float:
    """Draw the steps from a file of Gaussians to rain, `top` below the upper edge, where the options of a tool end.

    Returns the distance of its end from the upper edge.
    """
    setup, document, viewport = editor.scene_setup, editor.document, editor.viewport
    scene, em = document.scene, imgui.get_font_size()
    imgui.set_cursor_screen_pos(ImVec2(corner.x + left, corner.y + top))
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(8, 5))
    wide = max(width - left - 8, 50)
    is_row = wide < _ROW_EM * em
    scrolls = imgui.WindowFlags_.horizontal_scrollbar if is_row else 0
    color, borders = imgui.Col_.window_bg, imgui.ChildFlags_.borders
    with card("set-up", wide, color, 0.82, borders, window_flags=scrolls, max_height=max_height):
        end = math.inf if is_row else imgui.get_cursor_screen_pos().x + imgui.get_content_region_avail().x
        help_text = "Find the ground and which way is up, and from a camera path the scale. Undo restores the scene."
        if button(f"{icons.ICON_FA_WAND_MAGIC_SPARKLES}  Guess###guess", help_text):
            setup.guess()
        _next(end, 8 * em)
        _caption("Up")
        imgui.set_next_item_width(5.5 * em)
        if imgui.begin_combo("##up", setup.axis or "leveled"):
            for axis in get_args(Axis):
                if imgui.selectable(axis, axis == setup.axis)[0]:
                    setup.turn(axis)
            imgui.end_combo()
        imgui.set_item_tooltip("Axis of the file that points up.")
        _next(end, 11 * em)
        _caption(f"1 unit = {short_number(scene.metres_per_unit)} m{' ?' if scene.unit_is_assumed else ''}")
        if button("Measure...###measure", "Click the two ends of a known length, and type how long it truly is."):
            viewport.options.tool = "" if viewport.options.tool == "Measure" else "Measure"
        _next(end, 11 * em)
        _caption("Ground")
        imgui.set_next_item_width(6 * em)
        changed, ground_m = imgui.drag_float("##ground", scene.ground_m or 0.0, 0.01, -1000, 1000, "%.2f m")
        imgui.set_item_tooltip("Height of the ground in the world: rain falls down to it.")
        if changed:
            document.edit("Ground height", set_ground_height, ground_m, gesture="ground height")
        if imgui.is_item_deactivated():
            document.end_gesture()
        _next(end, 10 * em)
        title = f"{icons.ICON_FA_CLOUD_RAIN}  Rain {SETUP_MM_H:g} mm/h###rain"
        if editor.document.rain_now.intensity_mm_h == 0:
            if button(title, "Let it rain, which ends the set-up."):
                setup.rain()
            imgui.same_line()
        if button(
            "Close###close set-up", "Close this bar; the tools Level, Measure, and Set origin or ego start do the same."
        ):
            setup.is_open = False
    imgui.pop_style_var()
    return top + imgui.get_item_rect_size().y


def _caption(text: str) -> None:
    imgui.align_text_to_frame_padding()
    imgui.text(text)
    imgui.same_line()


def _next(end: float, needed: float) -> None:
    """Go on in the same line if the next step has room there."""
    if imgui.get_item_rect_max().x + imgui.get_style().item_spacing.x + needed < end:
        imgui.same_line()
