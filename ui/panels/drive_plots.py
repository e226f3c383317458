"""Drive plots (speed, acceleration, time to collision and gap over time), table of metrics, and Camera rig panel."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, implot
from jaxtyping import Float64
from msgspec import structs

from gsrain_engine.editor.document import Document
from gsrain_engine.editor.drive import RolloutPlayer, mosaic_rows
from gsrain_engine.editor.jobs.drive import LoadedRollout, RolloutCurves
from gsrain_engine.editor.timeline import Playback
from gsrain_engine.scene.scene import RigCamera
from gsrain_engine.simulation.metrics.summary import RESULT_COLUMNS, DriveMetrics, is_measured

from ..widgets.draw import OUTLINE, PLAYHEAD, color, draw_image, on_screen_px
from ..widgets.fields import combo

_WIDE = 1.6  # aspect ratio from which the plots are side by side
_MIN_EM, _MAX_EM = 8.0, 14.0
_MARGIN = 0.08
_RIGHT = 0.03  # free share at the end of the time axis: a collision is marked there
_HIT = ImVec4(0.95, 0.33, 0.28, 1.0)


class _Plot(NamedTuple):
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
    _Plot("gap_m", "Gap", "m", "From the front bumper to the leader in the lane.", 0.0, 10.0),
)


def drive_plots(document: Document, playback: Playback, rollouts: RolloutPlayer) -> None:
    """Draw the plots; a click goes to that time."""
    if rollouts.playing is None:
        imgui.text_wrapped("No roll-out is open: drive, or open one, in the Drive panel.")
        return
    room, em, gap = imgui.get_content_region_avail(), imgui.get_font_size(), imgui.get_style().item_spacing
    columns = 1 if room.x <= _WIDE * room.y else 4 if room.x > 45 * em else 2
    rows = -(-len(_PLOTS) // columns)
    width = (room.x - (columns - 1) * gap.x) / columns
    highest = room.y if rows == 1 else _MAX_EM * em
    height = float(np.clip((room.y - (rows - 1) * gap.y) / rows, _MIN_EM * em, max(highest, _MIN_EM * em)))
    for number, plot in enumerate(_PLOTS):
        if number % columns:
            imgui.same_line()
        imgui.begin_group()
        _plot(document, playback, rollouts, rollouts.playing, plot, ImVec2(width, height))
        imgui.end_group()


def _plot(
    document: Document, playback: Playback, rollouts: RolloutPlayer, playing: LoadedRollout, plot: _Plot, size: ImVec2
) -> None:
    placed = rollouts.placed_in(document.scene)
    now_s = playback.clock.time_s - (placed.start_s if placed is not None else 0.0)
    now = float(np.interp(now_s, playing.curves.times_s, plot.of(playing.curves)))
    imgui.text(plot.title)
    imgui.same_line()
    imgui.text_disabled("no leader" if np.isnan(now) else f"{now:z.2f} {plot.unit}")
    imgui.set_item_tooltip(f"{plot.help} Click or drag in the plot: go to a time.")
    flags = implot.Flags_.no_menus | implot.Flags_.no_box_select | implot.Flags_.no_mouse_text
    flags |= implot.Flags_.no_legend | implot.Flags_.no_title
    height = size.y - imgui.get_text_line_height_with_spacing()
    implot.push_style_var(implot.StyleVar_.plot_padding, ImVec2(4, 5))
    if implot.begin_plot(f"##{plot.title}", ImVec2(size.x, height), flags):
        _axes(rollouts.opened, plot)
        for opened, hue in zip(rollouts.opened, curve_colors(rollouts.opened), strict=True):
            _curve(opened, plot, hue, is_playing=opened is playing)
        implot.plot_inf_lines(
            "now", np.array([now_s]), spec=implot.Spec(line_color=PLAYHEAD, line_weight=on_screen_px(1.5))
        )
        if implot.is_plot_hovered() and imgui.is_mouse_down(imgui.MouseButton_.left):
            rollouts.seek(float(np.clip(implot.get_plot_mouse_pos().x, 0.0, playing.duration_s)))
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
    bottom = low - margin if low < 0 else 0.0
    implot.setup_axis_limits(implot.ImAxis_.y1, bottom, high + margin, imgui.Cond_.always)
    implot.setup_axis_format(implot.ImAxis_.x1, "%g s")


def _curve(opened: LoadedRollout, plot: _Plot, hue: ImVec4, *, is_playing: bool) -> None:
    times, values = opened.curves.times_s, np.ascontiguousarray(plot.of(opened.curves))
    spec = implot.Spec(line_color=hue, line_weight=2.5 if is_playing else 1.2)
    implot.plot_line(f"{id(opened)}", times, values, spec=spec)
    if opened.collision_s is not None and np.isfinite(values[-1]):
        mark = implot.Spec(
            marker=implot.Marker_.cross, marker_size=5.0 if is_playing else 3.5, marker_line_color=_HIT,
            line_weight=2.0, flags=implot.ScatterFlags_.no_clip,
        )  # fmt: skip
        implot.plot_scatter(f"hit {id(opened)}", np.array([opened.collision_s]), values[-1:].copy(), spec=mark)


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


def _number(field: str, form: str = ".2f", scale: float = 1.0) -> Callable[[DriveMetrics], str]:
    def text(metrics: DriveMetrics) -> str:
        value = getattr(metrics, field)
        return "-" if value is None else f"{scale * value:{form}}" + (" %" if scale == 100 else "")

    return text


def _result(metric: str) -> Callable[[DriveMetrics], str]:
    """Return the text of a metric, as the tables of `gsrain drive` and `gsrain sweep` have it."""
    column = RESULT_COLUMNS[metric]

    def text(metrics: DriveMetrics) -> str:
        drive = structs.asdict(metrics)
        return format(drive[metric], column.format) if is_measured(metric, drive) else column.missing

    return text


_ROWS: tuple[tuple[str, str, Callable[[DriveMetrics], str]], ...] = (
    ("End", "Reason for the end of the drive.", lambda m: m.end),
    ("Hit", "Collision partner; background is any Gaussian of the scene.", lambda m: m.collided_with or "-"),
    ("at (s)", "Time of the collision, in seconds since the start of the scenario.", _number("collision_time_s")),
    ("at (m/s)", "Speed of the ego vehicle at the collision.", _number("collision_speed_m_s")),
    ("Min. gap (m)", "Minimum bumper gap to the leader in the lane.", _number("min_gap_m")),
    *((each.title, f"{each.definition[0].upper()}{each.definition[1:]}", _result(metric))
      for metric, each in RESULT_COLUMNS.items()),
    ("Braking (m/s\u00b2)", "Hardest deceleration of a step.", _number("hardest_braking_m_s2")),
    ("Distance (m)", "Driven.", _number("distance_m", ".1f")),
    ("Route", "Driven share of the route ahead of the start.", _number("route_completion", ".1f", 100)),
    ("HD-score", "HUGSIM's score; none if it can't be measured.", _number("hdscore", ".3f")),
)  # fmt: skip


def drive_metrics(rollouts: RolloutPlayer) -> None:
    runs = sorted(
        zip(rollouts.opened, curve_colors(rollouts.opened), strict=True), key=lambda each: each[0].intensity_mm_h
    )
    runs = runs[:_MAX_COLUMNS]
    if not imgui.begin_table(
        "metrics", 1 + len(runs), imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
    ):
        return
    imgui.table_next_row()
    imgui.table_next_column()
    imgui.text_disabled("mm/h")
    for opened, hue in runs:
        imgui.table_next_column()
        mark = " *" if opened is rollouts.playing and len(runs) > 1 else ""
        imgui.text_colored(hue, f"{opened.intensity_mm_h:g}{mark}")
        imgui.set_item_tooltip(f"{opened.title}{'; playing' if opened is rollouts.playing else ''}.")
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
        imgui.set_item_tooltip("Planned points were not tested against the background: the file has no scene.")


# Camera rig panel

_GAP = 3.0


def camera_mosaic_panel(document: Document, rollouts: RolloutPlayer) -> None:
    """Draw the panel; images are rendered only while it is visible."""
    mosaic, scene = rollouts.mosaic, document.scene
    if scene.ego is None or not scene.rigs:
        imgui.text_wrapped("This scene has no ego vehicle with cameras.")
        return
    if len(scene.rigs) > 1:
        imgui.set_next_item_width(-1)
        help_text = "The rig whose images are shown, at the present pose of the ego vehicle."
        if (rig := combo("##rig", mosaic.rig, list(scene.rigs), help_text)) != mosaic.rig:
            mosaic.rig = rig
    rows = mosaic_rows(mosaic.cameras(scene))
    room, columns = imgui.get_content_region_avail(), max(map(len, rows))
    aspects = sum(max(each.height / each.width for each in row) for row in rows)
    width = max(min((room.x - (columns - 1) * _GAP) / columns, (room.y - len(rows) * _GAP) / aspects), 60.0)
    mosaic.want(width)
    start = imgui.get_cursor_screen_pos()
    top = start.y
    for row in rows:
        for column, camera in enumerate(row):
            if _image(rollouts, camera, ImVec2(start.x + column * (width + _GAP), top), width):
                rollouts.look_from(camera)
        top += max(width * each.height / each.width for each in row) + _GAP
    imgui.set_cursor_screen_pos(start)
    imgui.dummy(ImVec2(columns * (width + _GAP), top - start.y))


def _image(rollouts: RolloutPlayer, camera: RigCamera, at: ImVec2, width: float) -> bool:
    """Draw a camera's image with its name; returns True if it was clicked."""
    draw, em = imgui.get_window_draw_list(), imgui.get_font_size()
    end = ImVec2(at.x + width, at.y + width * camera.height / camera.width)
    draw_image(rollouts.mosaic.pictures.get(camera.name), at, end)
    words = camera.name.removeprefix("CAM_").replace("_", " ").lower()
    size, low = imgui.calc_text_size(words), ImVec2(at.x + 3, at.y + 3)
    draw.push_clip_rect(at, end, True)
    draw.add_rect_filled(low, ImVec2(low.x + size.x + 0.5 * em, low.y + size.y), color(OUTLINE), 3.0)
    draw.add_text(ImVec2(low.x + 0.25 * em, low.y), imgui.get_color_u32((1.0, 1.0, 1.0, 0.95)), words)
    draw.pop_clip_rect()
    imgui.set_cursor_screen_pos(at)
    clicked = imgui.invisible_button(f"###look from {camera.name}", ImVec2(width, end.y - at.y))
    size_px = f"{camera.width} x {camera.height} px"
    imgui.set_item_tooltip(
        f"{camera.name}, {size_px}, {1000 * camera.exposure_s:.3g} ms.\n"
        "Click: look from there. Follow path (V) rides along."
    )
    return clicked
