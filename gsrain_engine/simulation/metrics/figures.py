"""Figures of drives: kinematics over time by rain intensity, and bird's-eye views."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float64
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from ...evaluation.image_metrics import MeanInterval, mean_interval
from ...safe_io.text_files import figure_words
from ...scene.files import whole_file
from ..geometry import PlanarBox, Route
from ..rollout import Rollout, RolloutStep, run_setting
from ..vehicle import VehicleState
from .collisions import LONGEST_S, ego_box, ego_pose, gaps_m, planned_poses, road_user_boxes, times_to_collision_s
from .comfort import PAPER
from .summary import DriveComparison, IntensityRuns

_SIZE_INCHES, _DPI = (10.5, 6.2), 150
_WIDEST, _THINNEST = 3.0, 1.5
_CLEAR, _GRID = "#d9822b", "#9aa3ad"

# Curves over time

Quantity = Literal["speed_m_s", "acceleration_m_s2", "ttc_s", "gap_m"]

_TITLES: dict[Quantity, str] = {
    "speed_m_s": "Speed (m/s)",
    "acceleration_m_s2": "Acceleration (m/s$^2$)",
    "ttc_s": "Time to collision (s)",
    "gap_m": "Gap to the vehicle ahead (m)",
}

_WITHOUT_DATE: dict[str, dict[str, None]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""File formats, with the metadata to omit for reproducible bytes."""


def kinematics_figure(comparison: DriveComparison) -> Figure:
    """Draw the ego vehicle's motion over time, one color per intensity; a cross marks a collision.

    Several seeds appear as the mean over the runs still driving, with its 95 % bootstrap band. Raises ValueError
    without roll-outs.
    """
    figure = Figure(figsize=_SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    panels: list[Axes] = list(figure.subplots(2, 2, sharex=True).ravel())
    colors = rain_colors([each.intensity_mm_h for each in comparison.weathers])
    for panel, (quantity, title) in zip(panels, _TITLES.items(), strict=True):
        for weather, width in zip(comparison.weathers, _widths(len(comparison.weathers)), strict=True):
            _draw(panel, weather, quantity, colors[weather.intensity_mm_h], width)
        _dress(panel, quantity, title)
    for panel in panels[2:]:
        panel.set_xlabel("Time (s)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=min(len(labels), 6), frameon=False, fontsize=9
    )  # fmt: skip
    figure.suptitle(figure_words(comparison.title, 110), fontsize=12, x=0.01, ha="left")
    return figure


def rain_colors(intensities_mm_h: list[float]) -> dict[float, tuple[float, ...] | str]:
    """Return a color for each intensity: a separate one for clear weather, darker ones for heavier rain."""
    rainy = sorted({each for each in intensities_mm_h if each > 0})
    shades = np.linspace(0.42, 1.0, len(rainy)) if len(rainy) > 1 else np.full(len(rainy), 0.8)
    blue = colormaps["Blues"]
    return {0.0: _CLEAR, **{each: blue(shade) for each, shade in zip(rainy, shades, strict=True)}}


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure as PNG, PDF or SVG by suffix, atomically; the same figure gives the same bytes.

    Raises ValueError for another suffix.
    """
    kind = path.suffix.removeprefix(".").lower()
    if kind not in _WITHOUT_DATE:
        raise ValueError(f"{path}: expected a name that ends with .{', .'.join(_WITHOUT_DATE)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside, rc_context({"svg.hashsalt": "gsrain"}):
        figure.savefig(beside, format=kind, dpi=_DPI, metadata=_WITHOUT_DATE[kind])


def _widths(count: int) -> list[float]:
    """Return line widths from bottom to top, so that coinciding lines stay visible."""
    return [float(each) for each in np.linspace(_WIDEST, _THINNEST, count)] if count > 1 else [_THINNEST]


def _draw(panel: Axes, weather: IntensityRuns, quantity: Quantity, color: Any, width: float) -> None:
    times, mean, low, high = curve_band(weather, quantity)
    style = "steps-pre" if quantity == "acceleration_m_s2" else "default"
    rain = "clear" if weather.intensity_mm_h == 0 else f"{weather.intensity_mm_h:g} mm/h"
    seeds = f" ({len(weather.runs)} seeds)" if len(weather.runs) > 1 else ""
    if len(weather.runs) > 1:
        step = "pre" if quantity == "acceleration_m_s2" else None
        panel.fill_between(times, low, high, color=color, alpha=0.2, linewidth=0, step=step)
    panel.plot(times, mean, color=color, linewidth=width, drawstyle=style, label=f"{rain}{seeds}")
    _crosses(panel, weather, quantity, color)


def _crosses(panel: Axes, weather: IntensityRuns, quantity: Quantity, color: Any) -> None:
    """Mark collisions where their run's curve ends."""
    for run in weather.runs:
        if run.rollout is None or not run.metrics.collision:
            continue
        own = curve_band(IntensityRuns(weather.intensity_mm_h, (run,)), quantity)
        if np.isfinite(own.mean[-1]):
            panel.plot(
                own.times_s[-1], own.mean[-1], "X", color=color, markersize=9, markeredgecolor="white", zorder=5,
                clip_on=False,
            )  # fmt: skip


def _dress(panel: Axes, quantity: Quantity, title: str) -> None:
    panel.set_title(title, loc="left", fontsize=10)
    panel.grid(alpha=0.3)
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=9)
    panel.set_xlim(left=0)
    if quantity == "acceleration_m_s2":
        for limit in (PAPER.braking_m_s2, PAPER.acceleration_m_s2):
            panel.axhline(limit, color=_GRID, linewidth=1, linestyle=(0, (4, 3)), zorder=0)
        panel.text(
            0.995, PAPER.acceleration_m_s2, "comfort limits", transform=panel.get_yaxis_transform(), fontsize=7.5,
            color="#6b7480", ha="right", va="bottom",
        )  # fmt: skip
        low, high = panel.get_ylim()
        panel.set_ylim(min(low, PAPER.braking_m_s2 - 0.5), max(high, PAPER.acceleration_m_s2 + 0.9))
    elif quantity == "ttc_s":
        panel.set_ylim(-0.25, LONGEST_S + 0.4)
    else:
        low, high = panel.get_ylim()
        panel.set_ylim(min(0.0, low), max(1.04 * high, 1.0))


class CurveBand(NamedTuple):
    """Mean and band over time, NaN where unknown."""

    times_s: Float64[np.ndarray, " n"]
    mean: Float64[np.ndarray, " n"]
    """Mean over the runs still driving at that time."""
    low: Float64[np.ndarray, " n"]
    """Lower end of the 95 % bootstrap interval."""
    high: Float64[np.ndarray, " n"]


def curve_over_time(rollout: Rollout, quantity: Quantity) -> Float64[np.ndarray, " n"]:
    """Return a quantity of a run at its steps, NaN where undefined; the acceleration is that of the previous step."""
    if quantity == "ttc_s":
        return times_to_collision_s(rollout)
    if quantity == "gap_m":
        gaps = gaps_m(rollout)
        return np.where(np.isfinite(gaps), gaps, np.nan)
    values = np.array([getattr(each.ego, quantity) for each in rollout.steps], np.float64)
    if quantity == "acceleration_m_s2":
        values[0] = np.nan  # no previous step
    return values


def curve_band(weather: IntensityRuns, quantity: Quantity) -> CurveBand:
    """Return a quantity's mean and band over the runs of one intensity, at the times of the longest run.

    For one run the band is the run itself. Raises ValueError without roll-outs, or if steps differ.
    """
    rollouts = [run.rollout for run in weather.runs if run.rollout is not None]
    if not rollouts:
        raise ValueError(f"the runs at {weather.intensity_mm_h:g} mm/h have no roll-outs to be drawn over time")
    steps = sorted({each.step_s for each in rollouts})
    if len(steps) > 1:
        raise ValueError(f"runs in steps of {steps[0]:g} s and of {steps[-1]:g} s have no common curve")
    longest = max(rollouts, key=lambda each: len(each.steps))
    times = np.array([each.time_s for each in longest.steps])
    table = np.full((len(rollouts), len(times)), np.nan)
    for row, rollout in zip(table, rollouts, strict=True):
        row[: len(rollout.steps)] = curve_over_time(rollout, quantity)
    columns = [_interval(column[np.isfinite(column)].tolist()) for column in table.T]
    mean, low, high = (np.array(each) for each in zip(*columns, strict=True))
    return CurveBand(times, mean, low, high)


def _interval(values: Sequence[float]) -> MeanInterval:
    return mean_interval(values) if values else MeanInterval(np.nan, np.nan, np.nan)


# Bird's-eye views

_WIDTH_IN, _TALLEST_IN = 13.0, 7.0
_EGO, _OTHER, _PLAN, _HIT, _ROUTE = "#1f5f8b", "#8a5a2b", "#2f9e5b", "#d3202a", "#b8bfc7"
_EVERY_S = 1.0
_MARGIN_M, _MIN_SIDE_M, _BETWEEN_TIMES_M = 4.0, 5.0, 3.0


def birds_eye_sheet(rollouts: Sequence[Rollout], route: Route | None = None) -> Figure:
    """Draw runs below each other on one scale, each in the frame of its start (ahead to the right, left up).

    Boxes and plans are drawn once per second; boxes darken with time. `route` is optional. Raises ValueError without
    runs.
    """
    if not rollouts:
        raise ValueError("no run to be drawn from above")
    views = [_view(each) for each in rollouts]
    low, high = np.min([each[0] for each in views], axis=0), np.max([each[1] for each in views], axis=0)
    figure = _canvas(high - low, len(rollouts))
    panels: list[Axes] = list(np.atleast_1d(figure.subplots(len(rollouts), 1, sharex=True)))
    for axes, rollout in zip(panels, rollouts, strict=True):
        _draw_birds_eye(axes, rollout, route)
        _dress_birds_eye(axes, low, high)
    panels[-1].set_xlabel("ahead of the start (m)")
    named: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        named.update(zip(labels, handles, strict=True))
    figure.legend(
        list(named.values()), list(named), loc="outside lower center", ncols=len(named), frameon=False, fontsize=9
    )
    return figure


def _draw_birds_eye(axes: Axes, rollout: Rollout, route: Route | None) -> None:
    start = VehicleState(*ego_pose(rollout.steps[0].ego))
    shown = _every_second(rollout)
    if route is not None:
        x, y = start.from_world(route.points).T
        axes.plot(x, y, color=_ROUTE, linewidth=1.6, linestyle=(0, (6, 4)), zorder=1, label="route")
    for place, step in enumerate(shown):
        _moment(axes, rollout, step, start, 0.25 + 0.75 * (place + 1) / len(shown))
    way = start.from_world(np.array([(each.ego.x_m, each.ego.y_m) for each in rollout.steps]))
    axes.plot(*way.T, color=_EGO, linewidth=1.6, zorder=4, label="ego vehicle, rear axle")
    _tell_times(axes, [(each.time_s, start.from_world(_own_box(rollout, each).corners)) for each in shown])
    _name_users(axes, rollout, start)
    title = _title(rollout) + _mark_collision(axes, rollout, start)
    axes.set_title(title, loc="left", fontsize=10)


def _title(rollout: Rollout) -> str:
    setting = run_setting(rollout)
    rain = "clear" if setting.intensity_mm_h == 0 else f"{setting.intensity_mm_h:g} mm/h"
    names = f"{figure_words(setting.scenario)}, {figure_words(rollout.agent)}"
    return f"{names}, {rain}, seed {rollout.seed}"


def _own_box(rollout: Rollout, step: RolloutStep) -> PlanarBox:
    return ego_box(run_setting(rollout).vehicle, ego_pose(step.ego))


def _every_second(rollout: Rollout) -> list[RolloutStep]:
    apart = max(round(_EVERY_S / rollout.step_s), 1)
    chosen = list(rollout.steps[::apart])
    return chosen if chosen[-1] is rollout.steps[-1] else [*chosen, rollout.steps[-1]]


def _view(rollout: Rollout) -> tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, "2"]]:
    start = VehicleState(*ego_pose(rollout.steps[0].ego))
    boxes = [_own_box(rollout, step) for step in rollout.steps]
    boxes += [box for step in rollout.steps for box in road_user_boxes(step.road_users, rollout.users)]
    corners = np.concatenate([start.from_world(box.corners) for box in boxes])
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    low[1], high[1] = min(low[1], -_MIN_SIDE_M), max(high[1], _MIN_SIDE_M)
    return low, high


def _canvas(size_m: Float64[np.ndarray, "2"], panels: int) -> Figure:
    one = float(np.clip((_WIDTH_IN - 0.6) * size_m[1] / size_m[0] + 0.35, 1.3, _TALLEST_IN))
    figure = Figure(figsize=(_WIDTH_IN, panels * one + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _moment(axes: Axes, rollout: Rollout, step: RolloutStep, start: VehicleState, weight: float) -> None:
    for box in road_user_boxes(step.road_users, rollout.users):
        _box(axes, start.from_world(box.corners), _OTHER, weight)
    _box(axes, start.from_world(_own_box(rollout, step).corners), _EGO, weight)
    planned = planned_poses(step)[:, :2]
    if len(planned):
        points = start.from_world(np.concatenate([ego_pose(step.ego)[None, :2], planned]))
        axes.plot(
            *points.T, "-o", color=_PLAN, linewidth=0.8, alpha=0.7, markersize=2.6, markevery=(1, 1), zorder=5,
            label="plans, every second",
        )  # fmt: skip


def _box(axes: Axes, corners: Float64[np.ndarray, "4 2"], color: str, weight: float) -> None:
    axes.add_patch(Polygon(corners, closed=True, facecolor=color, edgecolor="none", alpha=0.10 * weight, zorder=2))
    axes.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=color, linewidth=0.9, alpha=weight, zorder=3))


def _tell_times(axes: Axes, shown: Sequence[tuple[float, Float64[np.ndarray, "4 2"]]]) -> None:
    """Label the ego vehicle's boxes with times, where there is room."""
    last = -np.inf
    for time_s, corners in shown:
        x, y = float(corners[:, 0].mean()), float(corners[:, 1].min())
        if abs(x - last) >= _BETWEEN_TIMES_M:
            axes.annotate(
                f"{time_s:g} s",
                (x, y),
                (0, -3),
                textcoords="offset points",
                ha="center",
                va="top",
                fontsize=8,
                color=_EGO,
            )
            last = x


def _name_users(axes: Axes, rollout: Rollout, start: VehicleState) -> None:
    last: dict[str, PlanarBox] = {}
    for step in rollout.steps:
        boxes = road_user_boxes(step.road_users, rollout.users)
        last.update({each.id: box for each, box in zip(step.road_users, boxes, strict=True)})
    for name, box in last.items():
        corners = start.from_world(box.corners)
        axes.annotate(
            figure_words(name, 24), (corners[:, 0].mean(), corners[:, 1].max()), (0, 3), textcoords="offset points",
            ha="center", va="bottom", fontsize=8, color=_OTHER,
        )  # fmt: skip


def _mark_collision(axes: Axes, rollout: Rollout, start: VehicleState) -> str:
    hit = next((each for each in rollout.steps if each.collision is not None), None)
    if hit is None:
        return ""
    place = start.from_world(_touch(rollout, hit)[None])
    axes.plot(*place.T, "X", color=_HIT, markersize=12, markeredgecolor="white", zorder=6, label="collision")
    return f": hits {figure_words(hit.collision, 24)} at {hit.time_s:g} s with {hit.ego.speed_m_s:.1f} m/s"


def _touch(rollout: Rollout, step: RolloutStep) -> Float64[np.ndarray, "2"]:
    """Return the center of the overlap of two boxes; the vehicle's front for the background or without overlap."""
    own = _own_box(rollout, step)
    for record, box in zip(step.road_users, road_user_boxes(step.road_users, rollout.users), strict=True):
        if record.id == step.collision and own.touches(box):
            middle: Any = own.polygon.intersection(box.polygon).centroid
            return np.array([middle.x, middle.y])
    return own.corners[[0, 3]].mean(axis=0)


def _dress_birds_eye(axes: Axes, low: Float64[np.ndarray, "2"], high: Float64[np.ndarray, "2"]) -> None:
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_ylabel("left (m)")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
