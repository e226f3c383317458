"""Lidar results in rain: counts of lost and false returns by range over rain rates and seeds, and their figure."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float, Float64, Int64, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from ...rain.properties import RainProperties
from ...rain.settings import RainSettings
from ...rain.simulation import RainSimulation
from ...report.charts import Color, shades
from ...water.spray import spray_of
from .rain_echoes import DropReturnModel
from .scan import LidarTurn, RainyScan, ReturnOutcome, scan_in_rain
from .sensor import Beams
from .settings import Answer

NEAR_STEP_M = 0.5  # width of the bins for drops near the sensor
_MIN_NEAR_M = 2.0  # to which fine bins reach at least
_JUST = 1 + 1e-6

# Return counts by range

RANGE_EDGES_M = (0.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0, 80.0, 120.0, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class ReturnCounts:
    """Counts of returns in each range bin; ranges are those in clear air, for false returns their own."""

    edges_m: Float64[np.ndarray, " k_and_one"]
    clear: Int64[np.ndarray, " k"]
    """Returns in clear air without those unaffected by rain."""
    kept: Int64[np.ndarray, " k"]
    dropped: Int64[np.ndarray, " k"]
    """Too weak in rain."""
    masked: Int64[np.ndarray, " k"]
    """Replaced by a drop's return."""
    false: Int64[np.ndarray, " k"]
    range_rmse_m: float
    """Root mean square of the range error that rain adds to kept returns; NaN without any."""
    untouched: int
    """Returns unaffected by rain."""

    @classmethod
    def of(cls, beams: Beams, rainy: RainyScan, edges_m: tuple[float, ...] = RANGE_EDGES_M) -> "ReturnCounts":
        edges = np.array(edges_m)
        kept, dropped, masked = (
            _binned(beams.ranges_m[(rainy.fates == fate) & beams.is_echo], edges)
            for fate in (ReturnOutcome.KEPT, ReturnOutcome.DROPPED, ReturnOutcome.MASKED)
        )
        true = ~rainy.is_false & ~beams.untouched[rainy.beams]
        away = rainy.sweep.points_m[true].astype(np.float64) - beams.origin_m
        added = np.linalg.norm(away, axis=1) - beams.ranges_m[rainy.beams[true]]
        rmse = float(np.sqrt(np.mean(added**2))) if len(added) else float("nan")
        false, untouched = _binned(rainy.false_ranges_m, edges), int(beams.untouched.sum())
        return cls(edges, kept + dropped + masked, kept, dropped, masked, false, rmse, untouched)

    def return_share(self) -> Float64[np.ndarray, " k"]:
        """Share of the clear returns that are kept, 0..1; NaN without clear returns."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.clear > 0, self.kept / self.clear, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class RainRunCounts:
    """Results of one turn in one rain, without the points, to save memory over many runs."""

    turn: str
    range_m: float
    """Of the sensor, at 10 %."""
    state: RainProperties
    seed: int
    wetness: float
    """Of the road; 0 if not simulated."""
    at_threshold: int
    """Clear returns at the detection threshold, which any rain loses."""
    tally: ReturnCounts
    near: ReturnCounts
    """In fine bins, up to the range at which drops are detected."""


@dataclass(frozen=True, slots=True, eq=False)
class RainRun:
    """One turn in one rain."""

    turn: LidarTurn
    rainy: RainyScan
    counts: RainRunCounts


def rain_runs(
    turn: LidarTurn,
    settings: RainSettings,
    intensities_mm_h: Sequence[float],
    seeds: Sequence[int],
    *,
    answer: Answer,
    wet_road: bool,
) -> Iterator[RainRun]:
    """Simulate rain, fog and spray of these settings on a turn: all seeds of the first rain rate, then of the next."""
    beams, sensor = turn.beams, turn.sensor
    rains = [msgspec.structs.replace(settings, intensity_mm_h=each) for each in intensities_mm_h]
    states = [RainSimulation.start(rain).state for rain in rains]
    reach_m = max(_MIN_NEAR_M, *(DropReturnModel(sensor, state).reach_m for state in states))
    near_edges = tuple(float(NEAR_STEP_M * k) for k in range(int(np.ceil(reach_m / NEAR_STEP_M)) + 1))
    clear = sensor.signal(beams.ranges_m[beams.is_echo], beams.reflectances[beams.is_echo], 0.0)
    at_threshold = int(np.sum(clear < _JUST))
    for rain in rains:
        for seed in seeds:
            rainfall = RainSimulation.start(msgspec.structs.replace(rain, seed=seed))
            clouds = None if turn.scene is None else spray_of(turn.scene, rainfall, beams.time_s)
            rainy = scan_in_rain(
                beams, sensor, rainfall, turn.anchor_to_world, answer=answer, wet_road=wet_road, spray=clouds
            )
            wetness = rainfall.wetness_at(beams.time_s) if wet_road else 0.0
            tallies = ReturnCounts.of(beams, rainy), ReturnCounts.of(beams, rainy, near_edges)
            state = rainfall.state
            counts = RainRunCounts(turn.name, sensor.range_m, state, seed, wetness, at_threshold, *tallies)
            yield RainRun(turn, rainy, counts)


def _binned(
    ranges_m: Float64[np.ndarray, " n"], edges_m: Float64[np.ndarray, " k"]
) -> Int64[np.ndarray, " k_less_one"]:
    counts, _ = np.histogram(ranges_m, np.where(np.isinf(edges_m), 1e9, edges_m))
    return counts.astype(np.int64)


# Figure

_SIZE_INCHES, _DPI = (13.5, 8.2), 140
_CLEAR, _DROPPED, _MASKED, _FALSE, _EGO = "#3c6e9f", "#e08a1e", "#7d3fa0", "#d3202a", "#222222"
_VIEWED_SHARE = 0.985
_ASPECT = 0.66  # height over width of the top view
_FEWEST = 20  # bins with fewer clear returns are not drawn
_FEW_ENTRIES = 8  # maximum number of entries for a legend inside its panel; a longer one is placed to its right
ByIntensity = Mapping[float, Sequence[RainRunCounts]]  # all seeds and turns at each rain rate in mm/h


def lidar_figure(run: RainRun, by_intensity: ByIntensity) -> UInt8[np.ndarray, "h w 3"]:
    """Draw one turn from above, clear and in its rain, and the counts of all turns by range."""
    figure = Figure(figsize=_SIZE_INCHES, layout="constrained", dpi=_DPI)
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.08)  # pyright: ignore
    canvas = FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.45, 1))
    beams = run.turn.beams
    echoes = beams.is_echo
    reach = float(np.quantile(beams.ranges_m[echoes], _VIEWED_SHARE))
    clear = figure.add_subplot(grid[0, 0])
    _dots(clear, _from_above(run.turn, beams.points_m[echoes]), _CLEAR)
    _frame(clear, run.turn, reach, f"clear: {int(echoes.sum()):,} returns")
    _draw_rain(figure.add_subplot(grid[0, 1]), run, reach)
    _draw_return_share(figure.add_subplot(grid[1, 0]), by_intensity)
    _draw_false(figure.add_subplot(grid[1, 1]), by_intensity)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _from_above(turn: LidarTurn, points_m: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
    """Coordinates ahead and to the left of the vehicle, in meters."""
    away = points_m.astype(np.float64) - turn.anchor_to_world[:3, 3]
    return (away @ turn.anchor_to_world[:3, :3])[:, :2]


def _draw_rain(axes: Axes, run: RainRun, reach_m: float) -> None:
    turn, rainy = run.turn, run.rainy
    true, points = ~rainy.is_false & ~turn.beams.untouched[rainy.beams], rainy.sweep.points_m
    _dots(axes, _from_above(turn, points[true]), _CLEAR, f"kept {int(true.sum()):,}")
    for fate, color, title in (
        (ReturnOutcome.DROPPED, _DROPPED, "too weak"),
        (ReturnOutcome.MASKED, _MASKED, "behind a drop"),
    ):
        lost = rainy.fates == fate
        _dots(axes, _from_above(turn, turn.beams.points_m[lost]), color, f"{title} {int(lost.sum()):,}", size=3.0)
    false = points[rainy.is_false]
    _dots(axes, _from_above(turn, false), _FALSE, f"drops {len(false):,}", size=5.0)
    count = len(rainy.beams) - int(turn.beams.untouched.sum())
    _frame(axes, turn, reach_m, f"{run.counts.state.intensity_mm_h:g} mm/h: {count:,} returns")
    axes.legend(loc="upper right", fontsize=8, framealpha=0.9, markerscale=3, handletextpad=0.2)


def _dots(axes: Axes, places: Float64[np.ndarray, "n 2"], color: str, label: str = "", size: float = 0.6) -> None:
    axes.scatter(places[:, 0], places[:, 1], s=size, c=color, linewidths=0, label=label or None, rasterized=True)


def _frame(axes: Axes, turn: LidarTurn, reach_m: float, title: str) -> None:
    sensor = _from_above(turn, turn.beams.origin_m[None])[0]
    axes.plot(*sensor, marker="^", color=_EGO, markersize=6, linestyle="none")
    axes.set_xlim(sensor[0] - reach_m, sensor[0] + reach_m)
    axes.set_ylim(sensor[1] - _ASPECT * reach_m, sensor[1] + _ASPECT * reach_m)
    axes.set_aspect("equal")
    axes.set_xlabel("ahead (m)")
    axes.set_ylabel("left (m)")
    axes.set_title(title, loc="left")


def _draw_return_share(axes: Axes, by_intensity: ByIntensity) -> None:
    for color, (intensity, runs) in zip(shades(len(by_intensity)), by_intensity.items(), strict=True):
        tallies = [run.tally for run in runs]
        edges = np.where(np.isinf(tallies[0].edges_m), 1.5 * tallies[0].edges_m[-2], tallies[0].edges_m)
        enough = sum(each.clear for each in tallies) >= _FEWEST * len(tallies)
        shares = np.stack([np.where(enough, each.return_share(), np.nan) for each in tallies])
        _band(axes, (edges[1:] + edges[:-1]) / 2, shares, color, f"{intensity:g} mm/h")
    axes.set_title("clear returns that are kept", loc="left")
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    _finish(axes, "range (m)")
    axes.set_ylim(min(axes.get_ylim()[0], 0.9), 1.005)


def _draw_false(axes: Axes, by_intensity: ByIntensity) -> None:
    for color, (intensity, runs) in zip(shades(len(by_intensity)), by_intensity.items(), strict=True):
        edges, counts = runs[0].near.edges_m, np.stack([run.near.false for run in runs]).astype(np.float64)
        if counts.any():
            label = f"{intensity:g} mm/h: {counts.sum(1).mean():.0f} in all"
            _band(axes, (edges[1:] + edges[:-1]) / 2, counts, color, label)
    axes.set_title(f"false returns: drops in a turn, per {NEAR_STEP_M:g} m", loc="left")
    _finish(axes, "range (m)")
    axes.set_ylim(bottom=0)
    if not axes.lines:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color="#888888", fontsize=12)


def _band(
    axes: Axes, x: Float64[np.ndarray, " k"], values: Float64[np.ndarray, "s k"], color: Color, label: str
) -> None:
    """Draw the mean over seeds and turns, with a band from minimum to maximum."""
    known = np.isfinite(values).all(axis=0)
    x, values = x[known], values[:, known]
    axes.fill_between(x, values.min(axis=0), values.max(axis=0), color=color, alpha=0.25, linewidth=0)
    axes.plot(x, values.mean(axis=0), color=color, marker="o", markersize=3, linewidth=1.4, label=label)


def _finish(axes: Axes, x_title: str) -> None:
    axes.set_xlabel(x_title)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    entries = len(axes.get_legend_handles_labels()[0])
    if entries > _FEW_ENTRIES:
        axes.legend(fontsize=6.5, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0), ncols=-(-entries // 20))
    elif entries:
        axes.legend(fontsize=8, frameon=False)
