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

from ...report.interval import Interval
from ...safe_io.files import whole_file
from ...safe_io.text_files import figure_words
from ..geometry import PlanarBox, Route
from ..rollout import Rollout, RolloutStep
from ..vehicle import VehicleState, vehicle_box
from . import collisions
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
    count = len(comparison.weathers)
    colors = rain_colors([each.intensity_mm_h for each in comparison.weathers])
    # From bottom to top, so that coinciding lines stay visible.
    widths = np.linspace(_WIDEST, _THINNEST, count) if count > 1 else [_THINNEST]
    for panel, (quantity, title) in zip(panels, _TITLES.items(), strict=True):
        for weather, width in zip(comparison.weathers, widths, strict=True):
            _draw(panel, weather, quantity, colors[weather.intensity_mm_h], float(width))
        panel.set_title(title, loc="left", fontsize=10)
        _set_limits(panel, quantity)
        _style(panel, alpha=0.3)
    for panel in panels[2:]:
        panel.set_xlabel("Time (s)")
    _add_legend(figure, *panels[0].get_legend_handles_labels(), columns=6)
    figure.suptitle(figure_words(comparison.title, 110), fontsize=12, x=0.01, ha="left")
    return figure


def _draw(panel: Axes, weather: IntensityRuns, quantity: Quantity, color: Any, width: float) -> None:
    """Draw the curve of an intensity with its band, and collisions where their run's curve ends."""
    times, mean, low, high = curve_band(weather, quantity)
    is_stepped = quantity == "acceleration_m_s2"
    label = "clear" if weather.intensity_mm_h == 0 else f"{weather.intensity_mm_h:g} mm/h"
    if len(weather.runs) > 1:
        label += f" ({len(weather.runs)} seeds)"
        step = "pre" if is_stepped else None
        panel.fill_between(times, low, high, color=color, alpha=0.2, linewidth=0, step=step)
    style = "steps-pre" if is_stepped else "default"
    panel.plot(times, mean, color=color, linewidth=width, drawstyle=style, label=label)
    for run in weather.runs:
        if run.rollout is None or not run.metrics.collision:
            continue
        own = curve_band(IntensityRuns(weather.intensity_mm_h, (run,)), quantity)
        if np.isfinite(own.mean[-1]):
            panel.plot(
                own.times_s[-1], own.mean[-1], "X", color=color, markersize=9, markeredgecolor="white", zorder=5,
                clip_on=False,
            )  # fmt: skip


def _set_limits(panel: Axes, quantity: Quantity) -> None:
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
        panel.set_ylim(-0.25, collisions.LONGEST_S + 0.4)
    else:
        low, high = panel.get_ylim()
        panel.set_ylim(min(0.0, low), max(1.04 * high, 1.0))


def _style(panel: Axes, alpha: float) -> None:
    panel.grid(alpha=alpha)
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=9)


def _add_legend(figure: Figure, handles: Sequence[Any], labels: Sequence[Any], columns: int) -> None:
    count = min(len(labels), columns)
    figure.legend(handles, labels, loc="outside lower center", ncols=count, frameon=False, fontsize=9)


def rain_colors(intensities_mm_h: list[float]) -> dict[float, tuple[float, ...] | str]:
    """Return a color for each intensity: a separate one for clear weather, darker ones for heavier rain."""
    rainy = sorted({each for each in intensities_mm_h if each > 0})
    shades = np.linspace(0.42, 1.0, len(rainy)) if len(rainy) > 1 else np.full(len(rainy), 0.8)
    blue = colormaps["Blues"]
    return {0.0: _CLEAR, **{each: blue(shade) for each, shade in zip(rainy, shades, strict=True)}}


def write_figure(path: Path, figure: Figure) -> None:
    """Write a figure as PNG, PDF or SVG, always the same bytes. Raises ValueError for other suffixes."""
    kind = path.suffix.removeprefix(".").lower()
    if kind not in _WITHOUT_DATE:
        raise ValueError(f"{path}: expected a name that ends with .{', .'.join(_WITHOUT_DATE)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial, rc_context({"svg.hashsalt": "gsrain"}):
        figure.savefig(partial, format=kind, dpi=_DPI, metadata=_WITHOUT_DATE[kind])


class CurveBand(NamedTuple):
    """Mean and band over time, NaN where unknown."""

    times_s: Float64[np.ndarray, " n"]
    mean: Float64[np.ndarray, " n"]  # mean over the runs still driving at that time
    low: Float64[np.ndarray, " n"]  # lower end of the 95 % bootstrap interval
    high: Float64[np.ndarray, " n"]


def curve_over_time(rollout: Rollout, quantity: Quantity) -> Float64[np.ndarray, " n"]:
    """Return a quantity of a run at its steps, NaN where undefined; the acceleration is that of the previous step."""
    if quantity == "ttc_s":
        return collisions.times_to_collision_s(rollout)
    if quantity == "gap_m":
        gaps = collisions.gaps_m(rollout)
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
    known = [column[np.isfinite(column)].tolist() for column in table.T]
    bands = [Interval.bootstrap(each, "drives") if each else None for each in known]
    ends = [(np.nan,) * 3 if each is None else (each.value, each.low, each.high) for each in bands]
    return CurveBand(times, *np.transpose(ends))


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
    width, height = high - low
    panel_in = float(np.clip((_WIDTH_IN - 0.6) * height / width + 0.35, 1.3, _TALLEST_IN))
    figure = Figure(figsize=(_WIDTH_IN, len(rollouts) * panel_in + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    panels: list[Axes] = list(np.atleast_1d(figure.subplots(len(rollouts), 1, sharex=True)))
    named: dict[str, Any] = {}
    for axes, rollout in zip(panels, rollouts, strict=True):
        _draw_birds_eye(axes, rollout, route)
        axes.set_aspect("equal")
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_ylabel("left (m)")
        _style(axes, alpha=0.25)
        handles, labels = axes.get_legend_handles_labels()
        named.update(zip(labels, handles, strict=True))
    panels[-1].set_xlabel("ahead of the start (m)")
    _add_legend(figure, list(named.values()), list(named), columns=len(named))
    return figure


def _draw_birds_eye(axes: Axes, rollout: Rollout, route: Route | None) -> None:
    start = rollout.steps[0].ego.state
    apart = max(round(_EVERY_S / rollout.step_s), 1)
    steps = list(rollout.steps[::apart])
    if steps[-1] is not rollout.steps[-1]:
        steps.append(rollout.steps[-1])
    if route is not None:
        x, y = start.from_world(route.points).T
        axes.plot(x, y, color=_ROUTE, linewidth=1.6, linestyle=(0, (6, 4)), zorder=1, label="route")
    for place, step in enumerate(steps, start=1):
        weight = 0.25 + 0.75 * place / len(steps)
        for box in rollout.boxes(step):
            _box(axes, start.from_world(box.corners), _OTHER, weight)
        _box(axes, start.from_world(_own_box(rollout, step).corners), _EGO, weight)
        planned = collisions.planned_poses(step)[:, :2]
        if len(planned):
            points = start.from_world(np.concatenate([[(step.ego.x_m, step.ego.y_m)], planned]))
            axes.plot(
                *points.T, "-o", color=_PLAN, linewidth=0.8, alpha=0.7, markersize=2.6, markevery=(1, 1), zorder=5,
                label="plans, every second",
            )  # fmt: skip
    path = start.from_world(np.array([(each.ego.x_m, each.ego.y_m) for each in rollout.steps]))
    axes.plot(*path.T, color=_EGO, linewidth=1.6, zorder=4, label="ego vehicle, rear axle")
    last = -np.inf
    for step in steps:
        corners = start.from_world(_own_box(rollout, step).corners)
        x, y = float(corners[:, 0].mean()), float(corners[:, 1].min())
        if abs(x - last) >= _BETWEEN_TIMES_M:
            _annotate(axes, f"{step.time_s:g} s", (x, y), -3, "top", _EGO)
            last = x
    boxes: dict[str, PlanarBox] = {}
    for step in rollout.steps:
        ids = (each.id for each in step.road_users)
        boxes.update(zip(ids, rollout.boxes(step), strict=True))
    for name, box in boxes.items():
        corners = start.from_world(box.corners)
        place = float(corners[:, 0].mean()), float(corners[:, 1].max())
        _annotate(axes, figure_words(name, 24), place, 3, "bottom", _OTHER)
    axes.set_title(_title(rollout) + _mark_collision(axes, rollout, start), loc="left", fontsize=10)


def _annotate(axes: Axes, text: str, place: tuple[float, float], up_pt: float, align: str, color: str) -> None:
    axes.annotate(text, place, (0, up_pt), textcoords="offset points", ha="center", va=align, fontsize=8, color=color)


def _title(rollout: Rollout) -> str:
    rain = "clear" if rollout.intensity_mm_h == 0 else f"{rollout.intensity_mm_h:g} mm/h"
    names = f"{figure_words(rollout.scenario_name)}, {figure_words(rollout.agent)}"
    return f"{names}, {rain}, seed {rollout.seed}"


def _own_box(rollout: Rollout, step: RolloutStep) -> PlanarBox:
    return vehicle_box(rollout.vehicle, step.ego.state)


def _view(rollout: Rollout) -> tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, "2"]]:
    start = rollout.steps[0].ego.state
    boxes = [_own_box(rollout, step) for step in rollout.steps]
    boxes += [box for step in rollout.steps for box in rollout.boxes(step)]
    corners = np.concatenate([start.from_world(box.corners) for box in boxes])
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    low[1], high[1] = min(low[1], -_MIN_SIDE_M), max(high[1], _MIN_SIDE_M)
    return low, high


def _box(axes: Axes, corners: Float64[np.ndarray, "4 2"], color: str, weight: float) -> None:
    axes.add_patch(Polygon(corners, closed=True, facecolor=color, edgecolor="none", alpha=0.10 * weight, zorder=2))
    axes.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=color, linewidth=0.9, alpha=weight, zorder=3))


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
    for record, box in zip(step.road_users, rollout.boxes(step), strict=True):
        if record.id == step.collision and own.touches(box):
            middle: Any = own.polygon.intersection(box.polygon).centroid
            return np.array([middle.x, middle.y])
    return own.corners[[0, 3]].mean(axis=0)
