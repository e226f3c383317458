"""The Drive plots: speed, acceleration, time to collision and gap over time; a click in one goes to its moment."""

from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, implot
from jaxtyping import Float64

from gsrain_engine.session.drive.curves import Curves
from gsrain_engine.session.drive.opened_rollout import OpenedRollout
from gsrain_engine.session.session import Session

from ..widgets.colors import PLAYHEAD
from .drive_colors import curve_colors

_WIDE = 1.6
"""From so many times wider than high on, plots stand side by side."""
_LEAST_EM, _HIGHEST_EM = 8.0, 14.0
_MARGIN = 0.08
_RIGHT = 0.03
"""Of the longest drive, free at its end: a collision is marked there."""
_HIT = ImVec4(0.95, 0.33, 0.28, 1.0)


@dataclass(frozen=True)
class _Plot:
    field: str
    """Of `Curves`."""
    title: str
    unit: str
    help: str
    low: float
    high: float
    """What is seen at least."""

    def of(self, curves: Curves) -> Float64[np.ndarray, " n"]:
        return getattr(curves, self.field)


_PLOTS = (
    _Plot("speed_m_s", "Speed", "m/s", "Of the ego vehicle.", 0.0, 5.0),
    _Plot("acceleration_m_s2", "Acceleration", "m/s\u00b2", "Of the ego vehicle, over the step before.", -3.0, 1.0),
    _Plot("ttc_s", "TTC", "s", "Time to collision: bumper gap over closing speed, capped at 10 s.", 0.0, 10.0),
    _Plot("gap_m", "Gap", "m", "From the front bumper to who is ahead in the lane.", 0.0, 10.0),
)


def drive_plots(session: Session) -> None:
    drives = session.drives
    if drives.playing is None:
        imgui.text_wrapped("No roll-out is open: drive, or open one, in the Drive panel.")
        return
    room, em, gap = imgui.get_content_region_avail(), imgui.get_font_size(), imgui.get_style().item_spacing
    is_wide = room.x > _WIDE * room.y
    columns = 1 if not is_wide else (4 if room.x > 45 * em else 2)
    rows = -(-len(_PLOTS) // columns)
    width = (room.x - (columns - 1) * gap.x) / columns
    most = room.y if rows == 1 else _HIGHEST_EM * em
    height = float(np.clip((room.y - (rows - 1) * gap.y) / rows, _LEAST_EM * em, max(most, _LEAST_EM * em)))
    for number, plot in enumerate(_PLOTS):
        if number % columns:
            imgui.same_line()
        imgui.begin_group()
        _plot(session, plot, ImVec2(width, height))
        imgui.end_group()


def _plot(session: Session, plot: _Plot, size: ImVec2) -> None:
    drives = session.drives
    playing, shown = drives.playing, drives.shown_in(session)
    assert playing is not None
    now_s = session.clock.time_s - (shown.start_s if shown is not None else 0.0)
    now = float(np.interp(now_s, playing.curves.times_s, plot.of(playing.curves)))
    imgui.text(plot.title)
    imgui.same_line()
    imgui.text_disabled("nobody ahead" if np.isnan(now) else f"{now:z.2f} {plot.unit}")
    imgui.set_item_tooltip(f"{plot.help} Click or drag in the plot: go to a moment.")
    flags = implot.Flags_.no_menus | implot.Flags_.no_box_select | implot.Flags_.no_mouse_text
    flags |= implot.Flags_.no_legend | implot.Flags_.no_title
    height = size.y - imgui.get_text_line_height_with_spacing()
    implot.push_style_var(implot.StyleVar_.plot_padding, ImVec2(4, 5))
    if implot.begin_plot(f"##{plot.title}", ImVec2(size.x, height), flags):
        _axes(drives.opened, plot)
        for opened, hue in zip(drives.opened, curve_colors(drives.opened), strict=True):
            _curve(opened, plot, hue, is_playing=opened is playing)
        _cursor(now_s)
        if implot.is_plot_hovered() and imgui.is_mouse_down(imgui.MouseButton_.left):
            drives.seek(session, float(np.clip(implot.get_plot_mouse_pos().x, 0.0, playing.duration_s)))
        implot.end_plot()
    implot.pop_style_var()


def _axes(opened: list[OpenedRollout], plot: _Plot) -> None:
    flags = implot.AxisFlags_.no_highlight | implot.AxisFlags_.lock | implot.AxisFlags_.no_menus
    implot.setup_axes("", "", flags, flags)
    longest = max(each.duration_s for each in opened)
    values = np.concatenate([plot.of(each.curves) for each in opened])
    values = values[np.isfinite(values)]
    low, high = min([plot.low, *values]), max([plot.high, *values])
    margin = _MARGIN * (high - low)
    implot.setup_axis_limits(implot.ImAxis_.x1, 0.0, max((1 + _RIGHT) * longest, 0.1), imgui.Cond_.always)
    below = low - margin if low < 0 else 0.0
    implot.setup_axis_limits(implot.ImAxis_.y1, below, high + margin, imgui.Cond_.always)
    implot.setup_axis_format(implot.ImAxis_.x1, "%g s")


def _curve(opened: OpenedRollout, plot: _Plot, hue: ImVec4, *, is_playing: bool) -> None:
    times, values = opened.curves.times_s, np.ascontiguousarray(plot.of(opened.curves))
    spec = implot.Spec(line_color=hue, line_weight=2.5 if is_playing else 1.2)
    implot.plot_line(f"{id(opened)}", times, values, spec=spec)
    hit = opened.collision_s
    if hit is not None and np.isfinite(values[-1]):
        size = 5.0 if is_playing else 3.5
        mark = implot.Spec(
            marker=implot.Marker_.cross,
            marker_size=size,
            marker_line_color=_HIT,
            line_weight=2.0,
            flags=implot.ScatterFlags_.no_clip,
        )
        implot.plot_scatter(f"hit {id(opened)}", np.array([hit]), values[-1:].copy(), spec=mark)


def _cursor(now_s: float) -> None:
    spec = implot.Spec(line_color=PLAYHEAD, line_weight=1.5)
    implot.plot_inf_lines("now", np.array([now_s]), spec=spec)
