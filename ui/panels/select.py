"""Select panel: selection commands, selection by attribute range, and selection sets."""

import numpy as np
from imgui_bundle import ImVec2, ImVec4, icons_fontawesome_6, imgui, implot

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.selection.attributes import ATTRIBUTES, Histogram, layer_names, select_attribute_range
from gsrain_engine.editor.selection.candidates import Mode, selectable_count, selected_count
from gsrain_engine.editor.selection.commands import SelectionTool, unused_set_name
from gsrain_engine.editor.viewport_state import ViewportState

from ..widgets.fields import (
    LOGARITHMIC,
    button,
    checkbox,
    combo,
    disabled,
    same_line_if_fits,
    same_line_if_room,
    share_of_width,
)
from ..widgets.numbers import plain_form, slide
from ..widgets.text import inline_text, label

_SET_HELP: dict[Mode, tuple[str, str]] = {
    "set": (icons_fontawesome_6.ICON_FA_ARROW_POINTER, "Select the Gaussians of this set."),
    "add": (icons_fontawesome_6.ICON_FA_PLUS, "Add the Gaussians of this set to the selection."),
    "remove": (icons_fontawesome_6.ICON_FA_MINUS, "Remove the Gaussians of this set from the selection."),
    "intersect": (icons_fontawesome_6.ICON_FA_CIRCLE_HALF_STROKE, "Intersect the selection with this set."),
}
_RANGE_HELP: dict[Mode, tuple[str, str]] = {
    "set": ("Replace", "Select the Gaussians in the range, and no others."),
    "add": ("Add", "Add the Gaussians in the range to the selection."),
    "remove": ("Remove", "Remove the Gaussians in the range from the selection."),
    "intersect": ("Intersect", "Leave only what of the selection is in the range."),
}


def select_panel(document: Document, viewport: ViewportState, selection: SelectionTool) -> None:
    count = selected_count(document.scene)
    imgui.align_text_to_frame_padding()
    imgui.text(f"{count:,} of {selectable_count(document.scene):,} selected")
    imgui.set_item_tooltip("Visible Gaussians of layers and actors that are not locked.")
    _buttons(viewport, selection, count > 0)
    imgui.separator_text("By attribute")
    _attribute_range(document, viewport, selection)
    imgui.separator_text("Selection sets")
    _selection_sets(document, selection, count > 0)


def _buttons(viewport: ViewportState, selection: SelectionTool, is_selected: bool) -> None:
    if button("All", "Select all visible Gaussians (Ctrl+A)."):
        selection.select_all()
    imgui.same_line()
    if button("None", "Clear the selection (Ctrl+Shift+A).", enabled=is_selected):
        selection.select_none()
    imgui.same_line()
    if button("Invert", "Select all visible Gaussians that were not selected (Ctrl+I)."):
        selection.invert()
    same_line_if_fits("Highlight", imgui.get_frame_height())
    help_text = "Tint the selected Gaussians, and mark the centers of those too faint or small for it (Shift+S)."
    viewport.options.show_selection = checkbox("Highlight", viewport.options.show_selection, help_text)
    if button("Grow", "Add Gaussians within this distance of the selection (Ctrl+]).", enabled=is_selected):
        selection.grow()
    imgui.same_line()
    if button("Shrink", "Deselect Gaussians within this distance of unselected ones (Ctrl+[).", enabled=is_selected):
        selection.shrink()
    same_line_if_room(8.0)
    inline_text("by")
    imgui.set_next_item_width(-1)
    _, selection.distance_m = slide("##distance_m", selection.distance_m, 0.001, 10.0, "%.3g m", LOGARITHMIC, unit="m")
    imgui.set_item_tooltip("Distance between centers in meters. Double click: type.")


# Selection sets


def _selection_sets(document: Document, selection: SelectionTool, is_selected: bool) -> None:
    with disabled(not is_selected):
        imgui.set_next_item_width(-4.5 * imgui.get_font_size())
        flags, hint = imgui.InputTextFlags_.enter_returns_true, unused_set_name(document.scene)
        entered, selection.set_name = imgui.input_text_with_hint("##set name", hint, selection.set_name, flags)
        imgui.set_item_tooltip("Name of the set; a set of the same name is replaced.")
        imgui.same_line()
        is_saved = button("Save", "Store the selection under this name in the scene's file.", width=-1)
        if (is_saved or entered) and selection.save_set():
            selection.set_name = ""
    if not document.scene.selections:
        imgui.text_disabled("No sets yet: save a selection.")
        return
    if imgui.begin_table("sets", 3, imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_fixed_fit):
        imgui.push_text_wrap_pos(-1.0)  # columns fit their words
        imgui.table_setup_column("name", imgui.TableColumnFlags_.width_stretch)
        for number, (name, masks) in enumerate(document.scene.selections.items()):
            imgui.push_id(number)
            _row(selection, name, sum(mask.size for mask in masks.values()))
            imgui.pop_id()
        imgui.pop_text_wrap_pos()
        imgui.end_table()


def _row(selection: SelectionTool, name: str, size: int) -> None:
    imgui.table_next_row()
    imgui.table_next_column()
    _name(selection, name)
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    imgui.text_disabled(f"{size:,}")
    imgui.set_item_tooltip("Gaussians in this set.")
    imgui.table_next_column()
    for mode, (icon, help_text) in _SET_HELP.items():
        if imgui.small_button(f"{icon}###recall {mode}"):
            selection.recall_set(name, mode)
        imgui.set_item_tooltip(help_text)
        imgui.same_line(0, 3)
    if imgui.small_button(f"{icons_fontawesome_6.ICON_FA_TRASH}###delete"):
        selection.remove_set(name)
    imgui.set_item_tooltip("Delete this set; the selection does not change.")


def _name(selection: SelectionTool, name: str) -> None:
    """Draw the name; a double click edits it."""
    if selection.renamed_set != name:
        imgui.align_text_to_frame_padding()
        imgui.selectable(label(name), False)
        imgui.set_item_tooltip(f"{name}: double-click to rename.")
        if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            selection.renamed_set = selection.new_name = name
        return
    imgui.set_next_item_width(-1)
    if imgui.is_window_appearing() or not imgui.is_any_item_active():
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, selection.new_name = imgui.input_text("##new name", selection.new_name, flags)
    imgui.set_item_tooltip("Enter applies the name, Esc cancels.")
    if entered:
        selection.rename_set(name, selection.new_name)
    if entered or imgui.is_item_deactivated():
        selection.renamed_set = ""


# Attribute range over a histogram

_SIZE = 16  # any size: attributes depend on the camera's position, not on its pixels
_HEIGHT_EM = 8.0
_HISTOGRAM_COLOR, _SELECTED_COLOR = ImVec4(0.55, 0.6, 0.68, 1.0), ImVec4(1.0, 0.72, 0.2, 1.0)
_LINE, _INSIDE = ImVec4(0.3, 0.75, 1.0, 1.0), (0.3, 0.75, 1.0, 0.18)


def _attribute_range(document: Document, viewport: ViewportState, selection: SelectionTool) -> None:
    """Draw the choice of an attribute, its histogram, and the buttons that apply the range."""
    shot = viewport.shot(_SIZE, _SIZE)
    titles = {name: f"{name} ({each.unit})" if each.unit else name for name, each in ATTRIBUTES.items()}
    imgui.set_next_item_width(-1)
    attribute = combo("##attribute", selection.attribute, titles, ATTRIBUTES[selection.attribute].help)
    if attribute != selection.attribute:
        selection.attribute, selection.range = attribute, None
    histogram = selection.histogram.of(document.scene, shot, attribute)
    low, high = selection.range or (float(histogram.edges[0]), float(histogram.edges[-1]))
    chosen = _numbers(attribute, histogram, *_plot(attribute, histogram, low, high))
    if chosen != (low, high):
        selection.range = low, high = min(chosen), max(chosen)
    if attribute == "layer":
        imgui.push_text_wrap_pos(0.0)
        imgui.text_disabled(
            ", ".join(name for number, name in layer_names(document.scene).items() if low <= number <= high)
        )
        imgui.pop_text_wrap_pos()
    half = share_of_width(2)
    for mode, (title, help_text) in _RANGE_HELP.items():
        if mode in ("add", "intersect"):
            imgui.same_line()
        if button(f"{title}##range", help_text, width=half):
            limits = histogram.opened(low, high)
            view = shot.time_s, shot.camera
            selection.select(mode, attribute, select_attribute_range, *view, attribute, *limits)


def _plot(name: str, histogram: Histogram, low: float, high: float) -> tuple[float, float]:
    """Draw the bars with the range over them; returns the dragged range."""
    flags = implot.Flags_.no_menus | implot.Flags_.no_box_select | implot.Flags_.no_legend | implot.Flags_.no_title
    width = imgui.get_content_region_avail().x  # -1 would mean at least 200 pixels
    size = ImVec2(width, _HEIGHT_EM * imgui.get_font_size())
    if not implot.begin_plot("##attribute plot", size, flags | implot.Flags_.no_mouse_text):
        return low, high
    fixed = implot.AxisFlags_.lock | implot.AxisFlags_.no_highlight | implot.AxisFlags_.no_side_switch
    bare = implot.AxisFlags_.no_tick_labels | implot.AxisFlags_.no_grid_lines
    implot.setup_axes("", "", fixed, fixed | bare)
    if ATTRIBUTES[name].logarithmic:
        implot.setup_axis_scale(implot.ImAxis_.x1, implot.Scale_.log10)
    implot.setup_axis_scale(implot.ImAxis_.y1, implot.Scale_.sym_log)
    first, last = float(histogram.edges[0]), float(histogram.edges[-1])
    left, right = first - 0.02 * (last - first), last + 0.02 * (last - first)  # lines at the outer edges stay visible
    if ATTRIBUTES[name].logarithmic:
        ratio = (last / first) ** 0.02
        left, right = first / ratio, last * ratio
    implot.setup_axes_limits(left, right, 0, 1.5 * max(int(histogram.shown.max()), 1), imgui.Cond_.always)
    _bars("shown", histogram, histogram.shown, _HISTOGRAM_COLOR)
    _bars("selected", histogram, histogram.selected, _SELECTED_COLOR)
    low, high = _dragged(low, high, first, last)
    implot.end_plot()
    imgui.set_item_tooltip(
        "Gray: visible; orange: selected (heights are logarithmic).\n"
        "Drag over the bars, or drag the two lines, to choose a range."
    )
    return low, high


def _bars(label: str, histogram: Histogram, counts: np.ndarray, color: ImVec4) -> None:
    spec = implot.Spec()
    spec.fill_color, spec.line_color, spec.fill_alpha = color, color, 0.75
    spec.flags = implot.StairsFlags_.shaded
    heights = np.append(counts, counts[-1]).astype(np.float64)
    implot.plot_stairs(label, np.ascontiguousarray(histogram.edges), heights, spec)


def _dragged(low: float, high: float, first: float, last: float) -> tuple[float, float]:
    """Draw the range, and drag its lines or a new range."""
    low, high = min(max(low, first), last), min(max(high, first), last)
    limits = implot.get_plot_limits()
    draw = implot.get_plot_draw_list()
    implot.push_plot_clip_rect()
    upper_left, lower_right = implot.plot_to_pixels(low, limits.y.max), implot.plot_to_pixels(high, limits.y.min)
    draw.add_rect_filled(upper_left, lower_right, imgui.get_color_u32(_INSIDE))
    implot.pop_plot_clip_rect()
    _, new_low, _, over_low, holds_low = implot.drag_line_x(0, low, _LINE, 2, 0, False, False, False)
    _, new_high, _, over_high, holds_high = implot.drag_line_x(1, high, _LINE, 2, 0, False, False, False)
    if holds_low or holds_high:
        return min(max(new_low, first), last), min(max(new_high, first), last)
    at, moved = imgui.get_mouse_pos(), imgui.get_mouse_drag_delta(imgui.MouseButton_.left)
    pressed = ImVec2(at.x - moved.x, at.y - moved.y)
    corner, size = implot.get_plot_pos(), implot.get_plot_size()
    is_inside = corner.x <= pressed.x <= corner.x + size.x and corner.y <= pressed.y <= corner.y + size.y
    if not (over_low or over_high) and is_inside and imgui.is_mouse_dragging(imgui.MouseButton_.left):
        ends = implot.pixels_to_plot(pressed).x, implot.pixels_to_plot(at).x
        return max(min(ends), first), min(max(ends), last)
    return low, high


def _numbers(name: str, histogram: Histogram, low: float, high: float) -> tuple[float, float]:
    speed = max(float(histogram.edges[-1] - histogram.edges[0]) / 500, 1e-6)
    unit = f" {ATTRIBUTES[name].unit}".rstrip()
    imgui.set_next_item_width(-1)
    changed, typed_low, typed_high = imgui.drag_float_range2(
        "##range", low, high, speed, 0.0, 0.0, f"from {plain_form(low)}{unit}", f"to {plain_form(high)}{unit}"
    )
    imgui.set_item_tooltip(
        "The range in the attribute's unit; Ctrl+click to type. At an outer edge of the plot it is unbounded."
    )
    if changed:  # because the widget rounds to single precision
        low, high = typed_low, typed_high
    imgui.text_disabled(f"about {histogram.count_within(low, high):,} within")
    return low, high
