"""Selecting by a range of an attribute that is dragged over its histogram."""

from typing import get_args

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, implot

from gsrain_engine.session.selection.attributes import ATTRIBUTES, in_range, layer_names
from gsrain_engine.session.selection.combine import Mode
from gsrain_engine.session.selection.histogram import Histogram
from gsrain_engine.session.selection.steps import select
from gsrain_engine.session.session import Session

_SIZE = 16
"""Any size: attributes depend on where the camera is, not on its pixels."""

_HEIGHT_EM = 8.0
_SHOWN, _SELECTED = ImVec4(0.55, 0.6, 0.68, 1.0), ImVec4(1.0, 0.72, 0.2, 1.0)
_LINE, _INSIDE = ImVec4(0.3, 0.75, 1.0, 1.0), (0.3, 0.75, 1.0, 0.18)
_HELP: dict[Mode, str] = {
    "set": "Select what lies in the range, and nothing else.",
    "add": "Add what lies in the range.",
    "remove": "Take away what lies in the range.",
    "intersect": "Keep only what was selected and lies in the range.",
}


def attribute_range(session: Session) -> None:
    """Draw the choice of an attribute, its histogram, and what to do with the range."""
    options, shot = session.selecting, session.shot(_SIZE, _SIZE)
    names = list(ATTRIBUTES)
    imgui.set_next_item_width(-1)
    changed, picked = imgui.combo("##attribute", names.index(options.attribute), [_title(name) for name in names])
    imgui.set_item_tooltip(ATTRIBUTES[options.attribute].help)
    if changed:
        options.attribute, options.range = names[picked], None
    histogram = options.histogram.of(session.scene, shot, options.attribute)
    low, high = options.range or (float(histogram.edges[0]), float(histogram.edges[-1]))
    dragged = _plot(options.attribute, histogram, low, high)
    chosen = _numbers(options.attribute, histogram, dragged)
    if chosen != (low, high):
        options.range = low, high = min(chosen), max(chosen)
    if options.attribute == "layer":
        names_within = [name for number, name in layer_names(session.scene).items() if low <= number <= high]
        imgui.push_text_wrap_pos(0.0)
        imgui.text_disabled(", ".join(names_within))
        imgui.pop_text_wrap_pos()
    for number, mode in enumerate(get_args(Mode)):
        if number:
            imgui.same_line()
        if imgui.button(f"{mode.capitalize()}##range"):
            found = in_range(session.scene, shot.time_s, shot.camera, options.attribute, *histogram.opened(low, high))
            select(session, found, mode, options.attribute)
        imgui.set_item_tooltip(_HELP[mode])


def _title(name: str) -> str:
    unit = ATTRIBUTES[name].unit
    return f"{name} ({unit})" if unit else name


def _plot(name: str, histogram: Histogram, low: float, high: float) -> tuple[float, float]:
    """Draw the bars with the range over them; returns the range as it was dragged."""
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
    left, right = _with_margin(first, last, ATTRIBUTES[name].logarithmic)
    implot.setup_axes_limits(left, right, 0, 1.5 * max(int(histogram.shown.max()), 1), imgui.Cond_.always)
    _bars("shown", histogram, histogram.shown, _SHOWN)
    _bars("selected", histogram, histogram.selected, _SELECTED)
    low, high = _dragged(low, high, first, last)
    implot.end_plot()
    imgui.set_item_tooltip(
        "Grey: all that are shown; orange: selected ones (heights are logarithmic).\n"
        "Drag over the bars, or drag the two lines, to choose a range."
    )
    return low, high


def _with_margin(first: float, last: float, logarithmic: bool) -> tuple[float, float]:
    """Limits of the axis: lines at the outer edges stay whole."""
    if logarithmic:
        ratio = (last / first) ** 0.02
        return first / ratio, last * ratio
    return first - 0.02 * (last - first), last + 0.02 * (last - first)


def _bars(label: str, histogram: Histogram, counts: np.ndarray, color: ImVec4) -> None:
    spec = implot.Spec()
    spec.fill_color, spec.line_color, spec.fill_alpha = color, color, 0.75
    spec.flags = implot.StairsFlags_.shaded
    heights = np.append(counts, counts[-1]).astype(np.float64)
    implot.plot_stairs(label, np.ascontiguousarray(histogram.edges), heights, spec)


def _dragged(low: float, high: float, first: float, last: float) -> tuple[float, float]:
    """Shade the range, and let it be dragged: by its lines, or anew over the bars."""
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
    if not (over_low or over_high) and _is_in_plot(pressed) and imgui.is_mouse_dragging(imgui.MouseButton_.left):
        ends = implot.pixels_to_plot(pressed).x, implot.pixels_to_plot(at).x
        return max(min(ends), first), min(max(ends), last)
    return low, high


def _is_in_plot(at: ImVec2) -> bool:
    corner, size = implot.get_plot_pos(), implot.get_plot_size()
    return corner.x <= at.x <= corner.x + size.x and corner.y <= at.y <= corner.y + size.y


def _numbers(name: str, histogram: Histogram, chosen: tuple[float, float]) -> tuple[float, float]:
    low, high = chosen
    speed = max(float(histogram.edges[-1] - histogram.edges[0]) / 500, 1e-6)
    unit = f" {ATTRIBUTES[name].unit}".rstrip()
    imgui.set_next_item_width(-1)
    changed, typed_low, typed_high = imgui.drag_float_range2(
        "##range", low, high, speed, 0.0, 0.0, f"from %.4g{unit}", f"to %.4g{unit}"
    )
    imgui.set_item_tooltip(
        "The range in the attribute's unit; Ctrl+click to type. At an outer edge of the plot it goes on without end."
    )
    if changed:  # only then: the widget rounds to single precision
        low, high = typed_low, typed_high
    imgui.text_disabled(f"about {histogram.count_within(low, high):,} within")
    return low, high
