"""Capture panel: images and cameras of a recorded drive, and matching with another view."""

from imgui_bundle import ImVec2, icons_fontawesome_6, imgui

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.editor.capture_view import THUMBNAIL_PX, ImageRequest
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.matching import AGAINST, Against
from gsrain_engine.editor.viewport.options import MODES, Mode

from ..widgets.draw import BACKGROUND, DIM, TEXT, color
from ..widgets.fields import ask_what_to_open
from ..widgets.text import label
from .rain import WARNING
from .training import reconstruct_fields

_ICONS = icons_fontawesome_6
_ROW_EM = 3.6


def capture_panel(session: Editor) -> None:
    captures = session.captures
    if captures.busy is not None:
        imgui.progress_bar(-imgui.get_time(), (-1, 0), captures.busy)
    if captures.capture is None:
        _nothing_open(session)
        return
    capture = captures.capture
    _head(session, capture)
    _display_options(session)
    _steps(session, capture)
    _problems(session)
    if imgui.tree_node("Matching"):
        matching_fields(session)
        imgui.tree_pop()
    if imgui.tree_node("Reconstruct"):
        reconstruct_fields(session)
        imgui.tree_pop()
    _list(session, capture)


def _nothing_open(session: Editor) -> None:
    imgui.text_wrapped("Recorded pictures, cameras and points, to compare the scene with.")
    if imgui.button("Open a capture...", (-1, 0)):
        ask_for_capture_folder(session)
    imgui.set_item_tooltip(
        "A folder of COLMAP, nerfstudio, nuScenes, DGP, KITTI, Waymo, RainSense, the street, or of pictures alone."
    )
    if imgui.button("Open a capture file...", (-1, 0)):
        ask_for_capture_file(session)
    imgui.set_item_tooltip("A capture that is one file, such as transforms.json.")


def _head(session: Editor, capture: Capture) -> None:
    captures = session.captures
    close = f"{_ICONS.ICON_FA_XMARK}###close capture"
    width = imgui.calc_text_size(_ICONS.ICON_FA_XMARK).x + 2 * imgui.get_style().frame_padding.x
    at, room = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x - width
    # Long names of drives are clipped at the button.
    imgui.push_clip_rect(at, ImVec2(at.x + room, at.y + imgui.get_frame_height()), True)
    imgui.align_text_to_frame_padding()
    imgui.text(capture.name)
    imgui.pop_clip_rect()
    imgui.set_item_tooltip(f"{capture.name}\n{captures.path}")
    imgui.same_line(imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x - width)
    if imgui.button(close):
        captures.close_capture()
        return
    imgui.set_item_tooltip("Close the capture; the scene stays.")
    parts = [f"{len(capture):,} views"]
    if len(capture.sensors) > 1:
        parts.append(f"{len(capture.sensors)} cameras")
    if captures.points is not None:
        parts.append(f"{captures.points.total:,} points")
    if not capture.is_metric:
        parts.append("unit unknown")
    imgui.text_disabled(", ".join(parts))


def _display_options(session: Editor) -> None:
    captures = session.captures
    _, captures.show_frustums = imgui.checkbox("Cameras", captures.show_frustums)
    imgui.set_item_tooltip("Show where the pictures were taken, and the nearest of them there.")
    imgui.same_line()
    imgui.begin_disabled(captures.points is None)
    _, captures.show_points = imgui.checkbox("Points", captures.show_points)
    imgui.end_disabled()
    shown = 0 if captures.points is None else len(captures.points.positions)
    imgui.set_item_tooltip(f"Show {shown:,} of the measured points over the picture; lidar is coloured by height.")
    imgui.same_line()
    _, captures.show_picture = imgui.checkbox("Picture", captures.show_picture)
    imgui.set_item_tooltip("Lay the recorded picture over the render while the eye is where it was taken (Shift+P).")
    percent = 100 * captures.opacity
    imgui.set_next_item_width(-6.5 * imgui.get_font_size())
    changed, percent = imgui.slider_float("Opacity", percent, 0.0, 100.0, "%.0f %%")
    if changed:
        captures.opacity, captures.show_picture = percent / 100, True
    imgui.set_item_tooltip("Of the recorded picture over the render, in percent: 0 is the render alone.")
    if imgui.tree_node("More"):
        _more(session)
        imgui.tree_pop()


def _more(session: Editor) -> None:
    captures = session.captures
    imgui.set_next_item_width(-6.5 * imgui.get_font_size())
    unit = "m" if captures.capture is not None and captures.capture.is_metric else "units"
    flags = imgui.SliderFlags_.logarithmic
    _, captures.frustum_m = imgui.slider_float("Length", captures.frustum_m, 1e-3, 100.0, f"%.3g {unit}", flags)
    imgui.set_item_tooltip(f"Length of the cameras' pyramids, in the capture's {unit}.")

    changed, lies_in = imgui.checkbox("In the scene's axes", captures.lies_in(session.scene))
    if changed:
        captures.in_scene_axes = lies_in
    imgui.set_item_tooltip(
        "On: the capture has the units and axes of the scene, which was made from it. Off: it has its own."
    )


def _steps(session: Editor, capture: Capture) -> None:
    captures = session.captures
    if len(capture.sensors) > 1:
        names = ["all cameras", *capture.sensors]
        at = names.index(captures.sensor) if captures.sensor in capture.sensors else 0
        imgui.set_next_item_width(-6.5 * imgui.get_font_size())
        changed, at = imgui.combo("Camera", at, names)
        imgui.set_item_tooltip("List and show the views of one camera.")
        if changed:
            captures.sensor = "" if at == 0 else names[at]
    if imgui.button(f"{_ICONS.ICON_FA_CHEVRON_LEFT}###previous view"):
        captures.step(session, -1)
    imgui.set_item_tooltip("Look from the view before (Page Up).")
    imgui.same_line()
    if imgui.button(f"{_ICONS.ICON_FA_CHEVRON_RIGHT}###next view"):
        captures.step(session, 1)
    imgui.set_item_tooltip("Look from the next view (Page Down).")
    imgui.same_line()
    if imgui.button("Look from here", (-1, 0)):
        captures.look_from(session, captures.chosen)
    imgui.set_item_tooltip("Go to where the chosen picture was taken, with its field of view (Shift+V).")


def _problems(session: Editor) -> None:
    problems = session.captures.problems
    if not problems:
        return
    imgui.push_style_color(imgui.Col_.text, WARNING)
    is_open = imgui.tree_node(f"{len(problems)} {'problem' if len(problems) == 1 else 'problems'}###problems")
    imgui.pop_style_color()
    if is_open:
        for problem in problems[:50]:
            imgui.text_wrapped(problem)
        if len(problems) > 50:
            imgui.text_disabled(f"and {len(problems) - 50} more, in the log")
        imgui.tree_pop()


def _list(session: Editor, capture: Capture) -> None:
    captures, row = session.captures, _ROW_EM * imgui.get_font_size()
    listed = captures.listed
    imgui.begin_child("views", (0, max(imgui.get_content_region_avail().y, 2.5 * row)), imgui.ChildFlags_.borders)
    clipper = imgui.ListClipper()
    clipper.begin(len(listed), row + imgui.get_style().item_spacing.y)
    while clipper.step():
        for number in range(clipper.display_start, clipper.display_end):
            _row(session, capture, listed[number], row)
    imgui.end_child()


def _row(session: Editor, capture: Capture, index: int, height: float) -> None:
    captures, view = session.captures, capture[index]
    at = imgui.get_cursor_screen_pos()
    flags = imgui.SelectableFlags_.allow_double_click
    if imgui.selectable(label("", f"view {view.name}"), captures.chosen == index, flags, ImVec2(0, height))[0]:
        captures.chosen = index
        if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            captures.look_from(session, index)
    fault = captures.pictures.faults.get(index) if captures.pictures is not None else None
    imgui.set_item_tooltip(fault or f"{view.name}\nClick: choose it. Double click: look from there.")
    draw, space = imgui.get_window_draw_list(), imgui.get_font_size() * 0.5
    camera = view.camera
    width = min(height * camera.width / camera.height, 2.2 * height)
    tall = min(height, width * camera.height / camera.width)
    _thumbnail(session, index, ImVec2(at.x, at.y + (height - tall) / 2), ImVec2(width, tall))
    left = at.x + 2.0 * height + space
    text, faint = color(TEXT), color(DIM)
    line = imgui.get_text_line_height()
    top = at.y + (height - 2.3 * line) / 2
    draw.add_text(ImVec2(left, top), text, view.name.rpartition("/")[2])
    moment = f"{view.time_s:.2f} s" if captures.has_times else f"{camera.width} x {camera.height} px"
    numbers = f"{view.sensor}  {moment}" if view.sensor else moment
    words = "can't be read" if fault is not None else numbers
    draw.add_text(ImVec2(left, top + 1.3 * line), color(WARNING) if fault else faint, words)


def _thumbnail(session: Editor, index: int, at: ImVec2, size: ImVec2) -> None:
    captures, draw = session.captures, imgui.get_window_draw_list()
    if captures.pictures is not None:
        captures.pictures.want(index, THUMBNAIL_PX)
    texture = captures.textures.get(ImageRequest(index, THUMBNAIL_PX))
    end = ImVec2(at.x + size.x, at.y + size.y)
    if texture is None:
        draw.add_rect_filled(at, end, color(BACKGROUND))
    else:
        draw.add_image(imgui.ImTextureRef(texture.name), at, end)


# Dialogs for a capture
# A capture is a folder or one file, and a dialog offers only one of the two.

_FILES = "Captures{.json,.tfrecord,.pkl,.parquet},All files{.*}"


def ask_for_capture_folder(session: Editor) -> None:
    ask_what_to_open("Open a capture (folder)", "", lambda chosen: session.captures.open(chosen[0]))


def ask_for_capture_file(session: Editor) -> None:
    ask_what_to_open("Open a capture (file)", _FILES, lambda chosen: session.captures.open(chosen[0]))


# Matching with another view

_AGAINST: dict[Against, str] = {
    "next": "the next view",
    "previous": "the view before",
    "beside": "the camera beside",
    "chosen": "the chosen view",
}

_MODES: dict[Mode, str] = {"picture": "that view, from here", "difference": "difference", "pixels": "which match"}


def matching_fields(session: Editor) -> None:
    matching = session.matching
    _, matching.is_on = imgui.checkbox("Show matches", matching.is_on)
    imgui.set_item_tooltip(
        "Find each pixel in another view, by its depth (eq. 13-15): of the recorded view that is looked from, else of "
        "the live view of a scene that was made from the capture (Shift+M)."
    )
    imgui.begin_disabled(not matching.is_on)
    imgui.same_line()
    _, matching.lines = imgui.checkbox("Lines", matching.lines)
    imgui.set_item_tooltip(
        "Draw lines from where pixels are to where the other view has them, as shares of the picture."
    )
    imgui.set_next_item_width(-6.5 * imgui.get_font_size())
    changed, at = imgui.combo("With", AGAINST.index(matching.against), [_AGAINST[each] for each in AGAINST])
    if changed:
        matching.against = AGAINST[at]
    imgui.set_item_tooltip(
        "Of the same camera, or of the one that looks most nearly the same way at that time. The live view is always "
        "matched with the chosen view."
    )
    imgui.set_next_item_width(-6.5 * imgui.get_font_size())
    changed, at = imgui.combo("As", MODES.index(matching.mode), [_MODES[each] for each in MODES])
    if changed:
        matching.mode = MODES[at]
    imgui.set_item_tooltip(
        "That view warped onto this one; or how much they differ, from black (not at all) to white (a quarter of full "
        "scale); or only which pixels match, and why others do not."
    )
    imgui.end_disabled()
