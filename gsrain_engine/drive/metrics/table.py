"""The table of results, as in the paper: one row a scenario, agent and intensity, with the definitions below it."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from gsrain_engine.evaluate.mean_interval import MeanInterval
from gsrain_engine.untrusted.printable import escaped

from .comparison import Comparison, WeatherRuns

NOT_SAID = "--"
"""What the paper prints for C and S after a collision: such runs end early, and their rates are of other roads."""


@dataclass(frozen=True, slots=True)
class ResultsTable:
    """Words for every cell; numbers are in `DriveMetrics`."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    definitions: tuple[str, ...]
    """A sentence for each column that needs one."""

    @property
    def markdown(self) -> str:
        rule = ["---" if each in _WORDS else "---:" for each in self.columns]
        lines = [self.columns, rule, *self.rows]
        table = "\n".join("| " + " | ".join(_plain(cell) for cell in line) + " |" for line in lines)
        return table + "\n\n" + "\n".join(f"* {each}" for each in self.definitions) + "\n"

    @property
    def text(self) -> str:
        """The table and its definitions, in columns of characters."""
        lines = [self.columns, *(tuple(map(escaped, row)) for row in self.rows)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.columns))]
        is_word = [each in _WORDS for each in self.columns]
        shown = [
            "  ".join(
                f"{cell:<{w}}" if word else f"{cell:>{w}}" for cell, w, word in zip(line, widths, is_word, strict=True)
            )
            for line in lines
        ]
        rule = "  ".join("-" * width for width in widths)
        told = [textwrap.fill(each, max(_NARROWEST, len(rule)), subsequent_indent="  ") for each in self.definitions]
        return "\n".join(line.rstrip() for line in (shown[0], rule, *shown[1:], "", *told)) + "\n"


_NARROWEST = 80
"""Characters in a line of the definitions, where the table has not more."""
_WORDS = ("Scenario", "Agent")
_C, _S_PLANNED, _S_EXECUTED = "C", "S (planned)", "S (executed)"
_FRAMES = "C (frames)"


def results_table(comparisons: Sequence[Comparison]) -> ResultsTable:
    """Make the table. Rows of several seeds have means, with 95 % bootstrap intervals in brackets."""
    has_seeds = any(len(weather.runs) > 1 for each in comparisons for weather in each.weathers)
    columns = (*_WORDS, "R (mm/h)", "Coll.", "Min. TTC (s)", _C, _FRAMES, _S_PLANNED, _S_EXECUTED)
    rows = [
        (each.scenario, each.agent, *_cells(weather, has_seeds)) for each in comparisons for weather in each.weathers
    ]
    return ResultsTable(columns, tuple(rows), _definitions(comparisons, has_seeds))


def _cells(weather: WeatherRuns, has_seeds: bool) -> tuple[str, ...]:
    rain = "Clear" if weather.intensity_mm_h == 0 else f"{weather.intensity_mm_h:g}"
    hits = weather.collisions
    collided = f"{hits} of {len(weather.runs)}" if has_seeds else ("Yes" if hits else "No")
    return (
        rain,
        collided,
        _number(weather.mean("min_ttc_s")),
        _percent(weather.mean("planned_point_collision_rate", without_collision=True)),
        _percent(weather.mean("planned_frame_collision_rate_hugsim", without_collision=True)),
        _number(weather.mean("comfort_planned", without_collision=True)),
        _number(weather.mean("comfort_executed", without_collision=True)),
    )


def _number(value: MeanInterval | None) -> str:
    if value is None:
        return NOT_SAID
    return f"{value.mean:.3f}" if value.low == value.high else f"{value.mean:.3f} ({value.low:.3f}..{value.high:.3f})"


def _percent(value: MeanInterval | None) -> str:
    if value is None:
        return NOT_SAID
    mean, low, high = (100 * each for each in value)
    return f"{mean:.1f} %" if low == high else f"{mean:.1f} ({low:.1f}..{high:.1f}) %"


def _definitions(comparisons: Sequence[Comparison], has_seeds: bool) -> tuple[str, ...]:
    metrics = [run.metrics for each in comparisons for run in each.runs]
    points = " or ".join(str(each) for each in sorted({each.planned_points for each in metrics}))
    background = all(each.with_background for each in metrics)
    against = "road users or the background" if background else "road users (the background was not tested)"
    seeds = (
        "Several seeds: means with 95 % bootstrap intervals; C and S over the runs without a collision. "
        if has_seeds else ""
    )  # fmt: skip
    return (
        "Coll.: whether the ego vehicle's box touches a road user's or the background.",
        "Min. TTC: the least over the run of min(d_x / (v_SUT - v_BV), 10 s), d_x the gap from the front bumper to who "
        "is in the vehicle's lane; 10 s where nobody slower is ahead, 0 at a touch.",
        f"C: share of all planned points (N = {points} a frame) at which the vehicle would touch {against}, at the "
        "places where road users really were at that time.",
        "C (frames): share of frames with any such point, the last of each plan left out (HUGSIM: 1 - mean nc).",
        "S (planned): share of frames whose plan keeps all comfort limits (HUGSIM: acceleration -4.05..2.40 m/s2, jerk "
        "8.37 m/s3, yaw rate 0.95 rad/s, yaw acceleration 1.93 rad/s2; the lateral one is never felt).",
        "S (executed): share of driven steps that keep them, with 4.89 m/s2 to the side.",
        f"{seeds}{NOT_SAID}: not said after a collision, as in the paper; the numbers are in the CSV and JSON files.",
    )


def _plain(cell: str) -> str:
    return escaped(cell).replace("|", "\\|")
