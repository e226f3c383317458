"""Capture panel: images and cameras of a recorded drive, and matching with another view."""

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.editor.capture_view import THUMBNAIL_PX, CaptureController, ImageRequest
from gsrain_engine.editor.document import Document
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.matching import Against, MatchingController
from gsrain_engine.editor.viewport.options import Mode

from ..commands.table import help_of
from ..widgets.draw import DIM, TEXT, color, draw_image
from ..widgets.fields import button, checkbox, combo, disabled, text_color, warning_color
from ..widgets.file_dialogs import ask_what_to_open
from ..widgets.numbers import slide
from ..widgets.text import label
from .training import reconstruct_fields

_FILES = "Captures{.json,.tfrecord,.pkl,.parquet},All files{.*}"
_ICONS = icons_fontawesome_6
_LABEL_EM = 6.5  # width of labels right of their fields
_ROW_EM = 3.6
_MAX_PROBLEMS = 50


def capture_panel(editor: Editor) -> None:
    captures = editor.captures
    if captures.busy is not None:
        imgui.progress_bar(-imgui.get_time(), (-1, 0), captures.busy)
    if (capture := captures.capture) is None:
        imgui.text_wrapped("Recorded images, cameras and points to compare the scene with.")
        if button("Open capture folder...", help_of("Open capture folder..."), width=-1):
            ask_for_capture_folder(captures)
        if button("Open capture file...", help_of("Open capture file..."), width=-1):
            ask_for_capture_file(captures)
        return
    _head(captures, capture)
    _display_options(editor.document, captures, capture)
    _steps(captures, capture)
    _problems(captures.problems)
    if imgui.tree_node("Matching"):
        matching_fields(editor.matching)
        imgui.tree_pop()
    if imgui.tree_node("Reconstruct"):
        reconstruct_fields(editor.viewport, captures, editor.training, editor.jobs)
        imgui.tree_pop()
    _list(captures, capture)


# A capture is a folder or one file, and a dialog offers only one of the two.


def ask_for_capture_folder(captures: CaptureController) -> None:
    ask_what_to_open("Open capture folder", "", lambda chosen: captures.open(chosen[0]))


def ask_for_capture_file(captures: CaptureController) -> None:
    ask_what_to_open("Open capture file", _FILES, lambda chosen: captures.open(chosen[0]))


def _head(captures: CaptureController, capture: Capture) -> None:
    width = imgui.calc_text_size(_ICONS.ICON_FA_XMARK).x + 2 * imgui.get_style().frame_padding.x
    at, room = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x - width
    # Long names of drives are clipped at the button.
    imgui.push_clip_rect(at, ImVec2(at.x + room, at.y + imgui.get_frame_height()), True)
    imgui.align_text_to_frame_padding()
    imgui.push_text_wrap_pos(-1.0)
    imgui.text(capture.name)
    imgui.pop_text_wrap_pos()
    imgui.pop_clip_rect()
    imgui.set_item_tooltip(f"{capture.name}\n{captures.path}")
    imgui.same_line(imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x - width)
    if button(f"{_ICONS.ICON_FA_XMARK}###close capture", "Close the capture; the scene stays open."):
        captures.close_capture()
        return
    parts = [f"{len(capture):,} view{'s'[: len(capture) != 1]}"]
    if len(capture.sensors) > 1:
        parts.append(f"{len(capture.sensors)} cameras")
    if captures.points is not None:
        parts.append(f"{captures.points.total:,} points")
    if not capture.is_metric:
        parts.append("unit unknown")
    imgui.text_disabled(", ".join(parts))


def _display_options(document: Document, captures: CaptureController, capture: Capture) -> None:
    help_text = "Show the poses of the images, and the nearest images themselves."
    captures.show_frustums = checkbox("Cameras", captures.show_frustums, help_text)
    imgui.same_line()
    count = 0 if captures.points is None else len(captures.points.positions)
    help_text = f"Show {count:,} of the measured points over the image; lidar is colored by height."
    with disabled(captures.points is None):
        captures.show_points = checkbox("Points", captures.show_points, help_text)
    imgui.same_line()
    help_text = "Overlay the recorded image while the camera is at its pose (Shift+P)."
    captures.show_picture = checkbox("Image###Picture", captures.show_picture, help_text)
    imgui.set_next_item_width(-_LABEL_EM * imgui.get_font_size())
    changed, percent = slide("Opacity", 100 * captures.opacity, 0.0, 100.0, "%.0f %%", unit="%")
    if changed:
        captures.opacity, captures.show_picture = percent / 100, True
    imgui.set_item_tooltip(
        "Opacity of the recorded image over the render, in percent; at 0 only the render is visible."
    )
    if not imgui.tree_node("More"):
        return
    unit = "m" if capture.is_metric else "units"
    imgui.set_next_item_width(-_LABEL_EM * imgui.get_font_size())
    flags = imgui.SliderFlags_.logarithmic
    _, captures.frustum_m = slide("Length", captures.frustum_m, 1e-3, 100.0, f"%.3g {unit}", flags, unit=unit)
    imgui.set_item_tooltip(f"Length of the cameras' pyramids, in the capture's {unit}.")
    present = captures.lies_in(document.scene)
    help_text = "On: the capture has the units and axes of the scene, which was made from it. Off: it has its own."
    if (lies_in := checkbox("In the scene's axes", present, help_text)) != present:
        captures.in_scene_axes = lies_in
    imgui.tree_pop()


def _steps(captures: CaptureController, capture: Capture) -> None:
    if len(capture.sensors) > 1:
        imgui.set_next_item_width(-_LABEL_EM * imgui.get_font_size())
        choices = {"": "all cameras"} | {each: each for each in capture.sensors}
        sensor = combo("Camera", captures.sensor, choices, "List and show the views of one camera.")
        if sensor != captures.sensor:
            captures.sensor = sensor
    if button(f"{_ICONS.ICON_FA_CHEVRON_LEFT}###previous view", "Look from the previous view (Page Up)."):
        captures.step(-1)
    imgui.same_line()
    if button(f"{_ICONS.ICON_FA_CHEVRON_RIGHT}###next view", "Look from the next view (Page Down)."):
        captures.step(1)
    imgui.same_line()
    help_text = "Move to the pose of the chosen image, with its field of view (Shift+V)."
    if button("Look from here", help_text, width=-1):
        captures.look_from(captures.chosen)


def _problems(problems: list[str]) -> None:
    if not problems:
        return
    with text_color(warning_color()):
        is_open = imgui.tree_node(f"{len(problems)} {'problem' if len(problems) == 1 else 'problems'}###problems")
    if is_open:
        for problem in problems[:_MAX_PROBLEMS]:
            imgui.text_wrapped(problem)
        if len(problems) > _MAX_PROBLEMS:
            imgui.text_disabled(f"and {len(problems) - _MAX_PROBLEMS} more, in the log")
        imgui.tree_pop()


def _list(captures: CaptureController, capture: Capture) -> None:
    listed, row = captures.listed, _ROW_EM * imgui.get_font_size()
    imgui.begin_child("views", (0, max(imgui.get_content_region_avail().y, 2.5 * row)), imgui.ChildFlags_.borders)
    clipper = imgui.ListClipper()
    clipper.begin(len(listed), row + imgui.get_style().item_spacing.y)
    while clipper.step():
        for number in range(clipper.display_start, clipper.display_end):
            _row(captures, capture, listed[number], row)
    imgui.end_child()


def _row(captures: CaptureController, capture: Capture, index: int, height: float) -> None:
    view = capture[index]
    at, line = imgui.get_cursor_screen_pos(), imgui.get_text_line_height()
    flags = imgui.SelectableFlags_.allow_double_click
    if imgui.selectable(label("", f"view {view.name}"), captures.chosen == index, flags, ImVec2(0, height))[0]:
        captures.chosen = index
        if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            captures.look_from(index)
    fault = captures.pictures.faults.get(index) if captures.pictures is not None else None
    imgui.set_item_tooltip(fault or f"{view.name}\nClick: choose it. Double click: look from there.")
    draw, camera = imgui.get_window_draw_list(), view.camera
    width = min(height * camera.width / camera.height, 2.2 * height)
    image_height = min(height, width * camera.height / camera.width)
    if captures.pictures is not None:
        captures.pictures.want(index, THUMBNAIL_PX)
    low = ImVec2(at.x, at.y + (height - image_height) / 2)
    texture = captures.textures.get(ImageRequest(index, THUMBNAIL_PX))
    draw_image(texture, low, ImVec2(low.x + width, low.y + image_height))
    left, top = at.x + 2.0 * height + imgui.get_font_size() * 0.5, at.y + (height - 2.3 * line) / 2
    draw.add_text(ImVec2(left, top), color(TEXT), view.name.rpartition("/")[2])
    moment = f"{view.time_s:.2f} s" if captures.has_times else f"{camera.width} x {camera.height} px"
    words = "unreadable" if fault is not None else f"{view.sensor}  {moment}" if view.sensor else moment
    draw.add_text(ImVec2(left, top + 1.3 * line), color(warning_color()) if fault else color(DIM), words)


# Matching with another view

_AGAINST: dict[Against, str] = {
    "next": "the next view",
    "previous": "the previous view",
    "beside": "the camera next to it",
    "chosen": "the chosen view",
}
_MODES: dict[Mode, str] = {"picture": "that view, warped", "difference": "difference", "pixels": "matching pixels"}


def matching_fields(matching: MatchingController) -> None:
    matching.is_on = checkbox(
        "Show matches", matching.is_on,
        "Find each pixel in another view, by its depth: for the recorded view at whose pose the camera "
        "is,\nelse for the live view of a scene that was made from the capture (Shift+M).",
    )  # fmt: skip
    with disabled(not matching.is_on):
        imgui.same_line()
        help_text = "Draw lines from pixels to their positions in the other view, as shares of the image."
        matching.lines = checkbox("Lines", matching.lines, help_text)
        imgui.set_next_item_width(-_LABEL_EM * imgui.get_font_size())
        matching.against = combo(
            "With", matching.against, _AGAINST,
            "A view of the same camera, or of the camera with the most similar direction at that time.\n"
            "The live view is always matched with the chosen view.",
        )  # fmt: skip
        imgui.set_next_item_width(-_LABEL_EM * imgui.get_font_size())
        matching.mode = combo(
            "As", matching.mode, _MODES,
            "The other view warped to this one; the difference, from black (none) to white (a quarter of full scale);\n"
            "or the pixels that match, and reasons why others do not.",
        )  # fmt: skip
