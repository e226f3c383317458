"""Drive plots, table of metrics, and rig camera mosaic.

The plots show speed, acceleration, time to collision and gap over time; a click goes to that time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, implot
from jaxtyping import Float64

from gsrain_engine.editor.drive import mosaic_rows
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.jobs.drive import LoadedRollout, RolloutCurves
from gsrain_engine.scene.scene import RigCamera
from gsrain_engine.simulation.metrics.summary import DriveMetrics

from ..widgets.draw import BACKGROUND, OUTLINE, PLAYHEAD, color

_WIDE = 1.6  # aspect ratio from which the plots are side by side
_MIN_EM, _HIGHEST_EM = 8.0, 14.0
_MARGIN = 0.08
_RIGHT = 0.03  # free share at the end of the time axis: a collision is marked there
_HIT = ImVec4(0.95, 0.33, 0.28, 1.0)


@dataclass(frozen=True)
class _Plot:
    field: str
    """Field of `RolloutCurves`."""
    title: str
    unit: str
    help: str
    low: float
    high: float
    """Minimum range of the axis."""

    def of(self, curves: RolloutCurves) -> Float64[np.ndarray, " n"]:
        return getattr(curves, self.field)


_PLOTS = (
    _Plot("speed_m_s", "Speed", "m/s", "Of the ego vehicle.", 0.0, 5.0),
    _Plot("acceleration_m_s2", "Acceleration", "m/s\u00b2", "Of the ego vehicle, over the step before.", -3.0, 1.0),
    _Plot("ttc_s", "TTC", "s", "Time to collision: bumper gap over closing speed, capped at 10 s.", 0.0, 10.0),
    _Plot("gap_m", "Gap", "m", "From the front bumper to who is ahead in the lane.", 0.0, 10.0),
)


def drive_plots(session: Editor) -> None:
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
    height = float(np.clip((room.y - (rows - 1) * gap.y) / rows, _MIN_EM * em, max(most, _MIN_EM * em)))
    for number, plot in enumerate(_PLOTS):
        if number % columns:
            imgui.same_line()
        imgui.begin_group()
        _plot(session, plot, ImVec2(width, height))
        imgui.end_group()


def _plot(session: Editor, plot: _Plot, size: ImVec2) -> None:
    drives = session.drives
    playing, shown = drives.playing, drives.placed_in(session.scene)
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


def _axes(opened: list[LoadedRollout], plot: _Plot) -> None:
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


def _curve(opened: LoadedRollout, plot: _Plot, hue: ImVec4, *, is_playing: bool) -> None:
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


# Colors of roll-outs by rain, from amber (dry) to violet (12 mm/h and more)

_STOPS = ((0.0, (0.98, 0.74, 0.25)), (1.2, (0.45, 0.82, 0.45)), (8.5, (0.35, 0.68, 1.0)), (12.0, (0.78, 0.52, 1.0)))
_DARKER = 0.72  # factor for each further roll-out in the same rain
_FEW = 3


def curve_colors(opened: Sequence[LoadedRollout]) -> list[ImVec4]:
    colors: list[ImVec4] = []
    for number, each in enumerate(opened):
        alike = sum(other.intensity_mm_h == each.intensity_mm_h for other in opened[:number])
        red, green, blue = (part * _DARKER ** (alike % _FEW) for part in _rain_color(each.intensity_mm_h))
        colors.append(ImVec4(red, green, blue, 1.0))
    return colors


def _rain_color(intensity_mm_h: float) -> tuple[float, ...]:
    for (low, first), (high, second) in pairwise(_STOPS):
        if intensity_mm_h <= high:
            part = max(intensity_mm_h - low, 0.0) / (high - low)
            return tuple((1 - part) * a + part * b for a, b in zip(first, second, strict=True))
    return _STOPS[-1][1]


# Table of metrics, a column per roll-out

_MAX_COLUMNS = 5
_NONE = "-"


def _number(value: float | None, form: str = "{:.2f}") -> str:
    return _NONE if value is None else form.format(value)


def _percent(value: float | None) -> str:
    return _NONE if value is None else f"{100 * value:.1f} %"


_ROWS: tuple[tuple[str, str, Callable[[DriveMetrics], str]], ...] = (
    ("End", "Why the drive ended.", lambda m: m.end),
    ("Hit", "Who was hit; background is anything of the scene.", lambda m: m.collided_with or _NONE),
    ("at (s)", "When it was hit, seconds since the scenario began.", lambda m: _number(m.collision_time_s)),
    ("at (m/s)", "Speed of the ego vehicle then.", lambda m: _number(m.collision_speed_m_s)),
    ("Min. TTC (s)", "Least time to collision, bumper gap over closing speed, capped at 10 s.",
     lambda m: _number(m.min_ttc_s)),
    ("Min. gap (m)", "Least bumper gap to who is ahead in the lane.", lambda m: _number(m.min_gap_m)),
    ("C, points", "Planned points that collide, of all planned points (the paper's C).",
     lambda m: _percent(m.planned_point_collision_rate)),
    ("C, frames", "Moments whose plan has any point that collides.",
     lambda m: _percent(m.planned_frame_collision_rate)),
    ("S, driven", "Share of moments within the paper's comfort limits, of the motion as driven.",
     lambda m: _number(m.comfort_executed, "{:.3f}")),
    ("S, planned", "The same of the plans: HUGSIM's comfort.", lambda m: _number(m.comfort_planned, "{:.3f}")),
    ("Braking (m/s\u00b2)", "Hardest deceleration of a step.", lambda m: _number(m.hardest_braking_m_s2)),
    ("Distance (m)", "Driven.", lambda m: _number(m.distance_m, "{:.1f}")),
    ("Route", "Share of the route ahead of the start that was driven.", lambda m: _percent(m.route_completion)),
    ("HD-score", "HUGSIM's score; none where it can't be measured.", lambda m: _number(m.hdscore, "{:.3f}")),
)  # fmt: skip


def drive_metrics(session: Editor) -> None:
    drives = session.drives
    runs = sorted(zip(drives.opened, curve_colors(drives.opened), strict=True), key=lambda each: each[0].intensity_mm_h)
    runs = runs[:_MAX_COLUMNS]
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
    if not imgui.begin_table("metrics", 1 + len(runs), flags):
        return
    imgui.table_next_row()
    imgui.table_next_column()
    imgui.text_disabled("mm/h")
    for opened, hue in runs:
        imgui.table_next_column()
        mark = " *" if opened is drives.playing and len(runs) > 1 else ""
        imgui.text_colored(hue, f"{opened.intensity_mm_h:g}{mark}")
        imgui.set_item_tooltip(f"{opened.title}{'; it plays' if opened is drives.playing else ''}.")
    for title, help_text, value in _ROWS:
        imgui.table_next_row()
        imgui.table_next_column()
        imgui.text(title)
        imgui.set_item_tooltip(help_text)
        for opened, _ in runs:
            imgui.table_next_column()
            imgui.text(value(opened.metrics))
    imgui.end_table()
    if not all(opened.metrics.with_background for opened, _ in runs):
        imgui.text_disabled("C counts road users only.")
        imgui.set_item_tooltip("Planned points were not tested against the scene's background: the file has no scene.")


# Rig cameras panel

_GAP = 3.0


def camera_mosaic_panel(session: Editor) -> None:
    """Draw the panel; images are rendered only while it is visible."""
    mosaic, scene = session.drives.mosaic, session.scene
    if scene.ego is None or not scene.rigs:
        imgui.text_wrapped("This scene has no ego vehicle with cameras.")
        return
    if len(scene.rigs) > 1:
        names = list(scene.rigs)
        present = names.index(mosaic.rig) if mosaic.rig in names else 0
        imgui.set_next_item_width(-1)
        changed, at = imgui.combo("##rig", present, names)
        imgui.set_item_tooltip("The rig whose cameras are shown, from where the ego vehicle is now.")
        if changed:
            mosaic.rig = names[at]
    rows = mosaic_rows(mosaic.cameras(scene))
    width = _width(rows)
    mosaic.want(width)
    start = imgui.get_cursor_screen_pos()
    top = start.y
    for row in rows:
        height = max(width * each.height / each.width for each in row)
        for column, camera in enumerate(row):
            _image(session, camera, ImVec2(start.x + column * (width + _GAP), top), width)
        top += height + _GAP
    imgui.set_cursor_screen_pos(start)
    imgui.dummy(ImVec2(max(map(len, rows)) * (width + _GAP), top - start.y))


def _width(rows: list[list[RigCamera]]) -> float:
    room, most = imgui.get_content_region_avail(), max(map(len, rows))
    by_width = (room.x - (most - 1) * _GAP) / most
    tall = sum(max(each.height / each.width for each in row) for row in rows)
    by_height = (room.y - len(rows) * _GAP) / tall
    return max(min(by_width, by_height), 60.0)


def _image(session: Editor, camera: RigCamera, at: ImVec2, width: float) -> None:
    draw, em = imgui.get_window_draw_list(), imgui.get_font_size()
    end = ImVec2(at.x + width, at.y + width * camera.height / camera.width)
    picture = session.drives.mosaic.pictures.get(camera.name)
    if picture is None:
        draw.add_rect_filled(at, end, color(BACKGROUND))
    else:
        draw.add_image(imgui.ImTextureRef(picture.name), at, end)
    words = camera.name.removeprefix("CAM_").replace("_", " ").lower()
    size = imgui.calc_text_size(words)
    low = ImVec2(at.x + 3, at.y + 3)
    draw.push_clip_rect(at, end, True)
    draw.add_rect_filled(low, ImVec2(low.x + size.x + 0.5 * em, low.y + size.y), color(OUTLINE), 3.0)
    draw.add_text(ImVec2(low.x + 0.25 * em, low.y), imgui.get_color_u32((1.0, 1.0, 1.0, 0.95)), words)
    draw.pop_clip_rect()
    if imgui.is_window_hovered() and imgui.is_mouse_hovering_rect(at, end):
        size_px = f"{camera.width} x {camera.height} px"
        imgui.set_tooltip(f"{camera.name}, {size_px}, {1000 * camera.exposure_s:.3g} ms.")
