"""Small plots in panels."""

from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
from imgui_bundle import ImVec2, imgui, implot
from jaxtyping import Float64

from .names import visible_name

_HEIGHT_EM, _LEGEND_EM = 12.0, 4.5


@contextmanager
def plot(
    title: str, x: str, y: str, *, log_x: bool = False, log_y: bool = False, legend: bool = False
) -> Generator[bool]:
    """Begin a plot as wide as the panel, with what its axes show; the block draws into it when told that it is seen.

    A legend stands below it; of several plots with the same lines in the same order one legend is enough.
    """
    flags = implot.Flags_.no_menus | implot.Flags_.no_box_select | implot.Flags_.no_mouse_text
    if not legend:
        flags |= implot.Flags_.no_legend
    height = (_HEIGHT_EM + (_LEGEND_EM if legend else 0)) * imgui.get_font_size()
    seen = implot.begin_plot(title, ImVec2(-1, height), flags)
    if seen:
        fit = implot.AxisFlags_.auto_fit | implot.AxisFlags_.no_highlight
        implot.setup_axes(x, y, fit, fit)
        if legend:
            implot.setup_legend(implot.Location_.south, implot.LegendFlags_.outside)
        if log_x:
            implot.setup_axis_scale(implot.ImAxis_.x1, implot.Scale_.log10)
        if log_y:
            implot.setup_axis_scale(implot.ImAxis_.y1, implot.Scale_.log10)
    yield seen
    if seen:
        implot.end_plot()


def line(label: str, x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"]) -> None:
    implot.plot_line(visible_name(label), np.ascontiguousarray(x), np.ascontiguousarray(y))


def points(label: str, x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"]) -> None:
    implot.plot_scatter(visible_name(label), np.ascontiguousarray(x), np.ascontiguousarray(y))
