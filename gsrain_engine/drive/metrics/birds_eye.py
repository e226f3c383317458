"""Runs from above: where the ego vehicle and the others went, what was planned, and where they met."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from gsrain_engine.untrusted.figure_words import figure_words

from ..road.planar_box import PlanarBox
from ..road.route import Route
from ..rollouts.rollout import Rollout, RolloutStep
from ..rollouts.run_setting import run_setting
from ..vehicle.state import VehicleState
from .logged_traffic import user_boxes
from .planned_poses import ego_box, ego_pose, planned_poses

_WIDTH_IN, _TALLEST_IN = 13.0, 7.0
_EGO, _OTHER, _PLAN, _HIT, _ROUTE = "#1f5f8b", "#8a5a2b", "#2f9e5b", "#d3202a", "#b8bfc7"
_EVERY_S = 1.0
_MARGIN_M, _LEAST_SIDE_M, _BETWEEN_TIMES_M = 4.0, 5.0, 3.0


def birds_eye_sheet(rollouts: Sequence[Rollout], route: Route | None = None) -> Figure:
    """Draw runs below each other on one scale, each in the frame of its start (ahead to the right, left up).

    Boxes and plans are those of every second; boxes grow darker with time. `route` is drawn where it is known. Raises
    ValueError without a run.
    """
    if not rollouts:
        raise ValueError("no run to be drawn from above")
    views = [_view(each) for each in rollouts]
    low, high = np.min([each[0] for each in views], axis=0), np.max([each[1] for each in views], axis=0)
    figure = _canvas(high - low, len(rollouts))
    panels: list[Axes] = list(np.atleast_1d(figure.subplots(len(rollouts), 1, sharex=True)))
    for axes, rollout in zip(panels, rollouts, strict=True):
        _draw(axes, rollout, route)
        _dress(axes, low, high)
    panels[-1].set_xlabel("ahead of the start (m)")
    named: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        named.update(zip(labels, handles, strict=True))
    figure.legend(
        list(named.values()), list(named), loc="outside lower center", ncols=len(named), frameon=False, fontsize=9
    )
    return figure


def _draw(axes: Axes, rollout: Rollout, route: Route | None) -> None:
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
    boxes += [box for step in rollout.steps for box in user_boxes(step.road_users, rollout.users)]
    corners = np.concatenate([start.from_world(box.corners) for box in boxes])
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    low[1], high[1] = min(low[1], -_LEAST_SIDE_M), max(high[1], _LEAST_SIDE_M)
    return low, high


def _canvas(size_m: Float64[np.ndarray, "2"], panels: int) -> Figure:
    one = float(np.clip((_WIDTH_IN - 0.6) * size_m[1] / size_m[0] + 0.35, 1.3, _TALLEST_IN))
    figure = Figure(figsize=(_WIDTH_IN, panels * one + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _moment(axes: Axes, rollout: Rollout, step: RolloutStep, start: VehicleState, weight: float) -> None:
    for box in user_boxes(step.road_users, rollout.users):
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
    """Write the time below the ego vehicle's boxes, where there is room for it."""
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
    """Write each road user's name above where it was last."""
    last: dict[str, PlanarBox] = {}
    for step in rollout.steps:
        boxes = user_boxes(step.road_users, rollout.users)
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
    """Return where two boxes overlap; the vehicle's front where it is the background, or it has passed already."""
    own = _own_box(rollout, step)
    for record, box in zip(step.road_users, user_boxes(step.road_users, rollout.users), strict=True):
        if record.id == step.collision and own.touches(box):
            middle: Any = own.polygon.intersection(box.polygon).centroid
            return np.array([middle.x, middle.y])
    return own.corners[[0, 3]].mean(axis=0)


def _dress(axes: Axes, low: Float64[np.ndarray, "2"], high: Float64[np.ndarray, "2"]) -> None:
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_ylabel("left (m)")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
