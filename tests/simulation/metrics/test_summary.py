"""Metrics of a run in one value, runs side by side, the paper's table, figures and the report page."""

import csv
import math
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from msgspec.structs import replace

from gsrain_engine.report.interval import Interval
from gsrain_engine.report.page import report_page
from gsrain_engine.simulation.metrics import figures, summary
from gsrain_engine.simulation.metrics.report import drive_report_page, rollout_hash
from gsrain_engine.sweep.report import scenario_table
from gsrain_engine.sweep.results import summarized
from small_rollout import approach, ego, rollout, step, user


def test_a_run_into_a_standing_car(tmp_path):
    metrics = summary.measure_drive(approach(lead_x=40.0, moments=20, intensity_mm_h=8.5, seed=3))
    expected = {
        "collision": True, "collided_with": "lead", "collision_time_s": 3.5, "min_ttc_s": 0.0, "min_ttc_time_s": 3.5,
        "min_gap_m": 0.0, "steps": 14, "frames": 14, "planned_points": 6, "intensity_mm_h": 8.5, "seed": 3,
        "duration_s": 3.5, "distance_m": 35.0, "mean_speed_m_s": 10.0, "hardest_braking_m_s2": 0.0,
        "with_background": False, "dac": None, "agent": "hand",
    }  # fmt: skip
    assert {name: getattr(metrics, name) for name in expected} == pytest.approx(expected)
    summary.metrics_table([metrics]).write_csv(tmp_path / "runs.csv")
    (row,) = csv.DictReader((tmp_path / "runs.csv").read_text().splitlines())
    assert list(row) == list(summary.DriveMetrics.__struct_fields__) and row["collision"] == "true"
    assert {name: float(row[name]) for name in ("min_ttc_s", "distance_m")} == {"min_ttc_s": 0.0, "distance_m": 35.0}
    with pytest.raises(ValueError, match=r"none\.jsonl"):
        summary.ScoredRun(metrics).save(tmp_path / "none.jsonl")
    with pytest.raises(ValueError, match=r"scenario\.vehicle: .*length_m"):
        summary.measure_drive(replace(approach(), scenario={"vehicle": {"length_m": "long"}}))


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([step(0, ego())], {"steps": 0, "mean_speed_m_s": 0.0, "comfort_executed": None, "hdscore": None,
                            "min_ttc_s": 10.0, "min_gap_m": None}),
        ([step(i, ego(2.5 * i, acceleration=a)) for i, a in enumerate((-1.0, 2.0, -3.5, 0.5))],
         {"hardest_braking_m_s2": 3.5, "mean_speed_m_s": 10.0}),
        ([step(i, ego(2.5 * i, acceleration=a)) for i, a in enumerate((1.0, 2.0, 0.5))], {"hardest_braking_m_s2": 0.0}),
        ([step(i, ego(2.5 * i), completion=c) for i, c in enumerate((0.0, 0.3, 0.25))], {"route_completion": 0.3}),
        # A car 12 m on from the start, middle to rear axle, leaves the lane at the third moment: 12 - 2.5 - 3 - 2 m.
        ([step(i, ego(2.5 * i), [user(12.0, y=0.0 if i < 2 else 30.0)]) for i in range(4)],
         {"min_gap_m": 4.5, "min_ttc_s": 0.45, "min_ttc_time_s": 0.25, "min_ttc_center_s": 0.85}),
    ],
)  # fmt: skip
def test_single_metrics(steps, expected):
    metrics = summary.measure_drive(rollout(steps, end="agent"))
    assert {name: getattr(metrics, name) for name in expected} == pytest.approx(expected)


@settings(max_examples=15)
@given(st.floats(-math.pi, math.pi), st.floats(-500, 500), st.floats(-500, 500), st.sampled_from([0.0, 7.5]))
def test_metrics_depend_on_neither_the_worlds_origin_nor_the_clocks(turn, x, y, later_s):
    run, (cosine, sine) = approach(lead_x=33.0, moments=20), (np.cos(turn), np.sin(turn))

    def moved(record):
        return replace(
            record, x_m=float(cosine * record.x_m - sine * record.y_m + x),
            y_m=float(sine * record.x_m + cosine * record.y_m + y), yaw_rad=float(record.yaw_rad + turn),
        )  # fmt: skip

    steps = tuple(
        replace(each, ego=moved(each.ego), road_users=tuple(map(moved, each.road_users)), time_s=each.time_s + later_s)
        for each in run.steps
    )
    here, there = (msgspec.structs.asdict(summary.measure_drive(each)) for each in (run, replace(run, steps=steps)))
    here["min_ttc_time_s"] += later_s
    here["collision_time_s"] += later_s
    assert there == pytest.approx(here, abs=1e-6)


# Comparison and table


@cache
def runs():
    """Clear, light and heavy rain; the last one ends in a collision."""
    return [summary.ScoredRun.of(approach(intensity_mm_h=r, moments=m)) for r, m in ((0.0, 9), (1.2, 9), (12.0, 20))]


def test_rows_go_by_intensity_and_seed_and_agents_stay_apart():
    several = [summary.ScoredRun.of(approach(intensity_mm_h=r, seed=s, moments=5)) for r in (8.5, 0.0) for s in (1, 0)]
    other = summary.ScoredRun(replace(several[0].metrics, agent="other"))
    first, second = summary.compare_drives([*several, other])
    order = [(run.metrics.intensity_mm_h, run.metrics.seed) for run in first.runs]
    assert (first.title, order) == ("made-up, hand", [(0.0, 0), (0.0, 1), (8.5, 0), (8.5, 1)])
    assert (second.agent, len(second.runs)) == ("other", 1)


def test_the_table_is_the_papers():
    table = summary.results_table(summary.compare_drives(runs()[::-1]))
    assert [each.title for each in table.columns[2:6]] == ["R (mm/h)", "Coll.", "Min. TTC (s)", "C (all points)"]
    lines = table.text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("---")) + 1
    clear, light, heavy = (line.split() for line in lines[start : start + 3])
    rate = 100 * runs()[0].metrics.planned_point_collision_rate
    # At the end of 9 moments it is at 20 m: 15 m of gap at 10 m/s.
    assert clear[:6] == ["made-up", "hand", "0", "no", "1.500", f"{rate:.1f}%"] and light[2] == "1.2"
    assert heavy[2:] == ["12", "yes", "0.000", *(5 * [summary.NOT_MEASURED])]
    assert table.markdown.startswith("| Scenario | Agent |") and "N = 6" in table.markdown and "N = 6" in table.text
    several = [summary.ScoredRun.of(approach(speed=v, seed=i, moments=9)) for i, v in enumerate((8.0, 9.0, 10.0))]
    (only,) = summary.compare_drives([*several, summary.ScoredRun.of(approach(seed=3, moments=20))])
    (weather,) = only.weathers
    interval, free = weather.mean("min_ttc_s"), weather.mean("planned_point_collision_rate")
    assert weather.collisions == 1 and interval.low < interval.value < interval.high
    assert (interval.n, free.n, interval.over) == (4, 3, "drives")  # C is that of drives without a collision
    assert summary.results_table([only]).rows[0][3] == Interval.wilson(1, 4, "drives")


def test_drives_and_sweeps_have_the_same_columns():
    """Equal names, definitions and values, whether one command or a sweep has driven."""
    driven = [run.metrics for run in runs()]
    table = summary.results_table(summary.compare_drives(runs()))
    rows = [structs.asdict(each) | {"status": "finished"} for each in driven]
    swept = scenario_table(summarized(rows))
    shared = ["R (mm/h)", "Coll.", *(each.title for each in summary.RESULT_COLUMNS.values())]
    assert set(shared) <= {each.title for each in table.columns} & {each.title for each in swept.columns}
    assert [each for each in table.columns if each.title in shared] == [
        each for each in swept.columns if each.title in shared
    ]
    for name in shared[2:]:
        own, other = ([each.title for each in one.columns].index(name) for one in (table, swept))
        assert [row[own] for row in table.rows] == [row[other] for row in swept.rows]
    assert shared[3:6] == ["C (all points)", "C (N = 5)", "C (HUGSIM)"]


# Figures


def test_curves_of_a_run_and_bands_of_the_runs_that_go_on():
    run = approach(lead_x=40.0, moments=20)
    assert figures.curve_over_time(run, "acceleration_m_s2") == pytest.approx([np.nan, *[0.0] * 14], nan_ok=True)
    assert figures.curve_over_time(run, "gap_m")[:2] == pytest.approx([35.0, 32.5])
    assert figures.curve_over_time(run, "ttc_s")[-1] == 0.0
    several = [
        summary.ScoredRun.of(approach(speed=v, seed=i, moments=m)) for i, (v, m) in enumerate(((8.0, 5), (10.0, 9)))
    ]
    comparison = summary.compare_drives(several)[0]
    times, mean, low, high = figures.curve_band(comparison.weathers[0], "speed_m_s")
    assert times[-1] == 2.0 and mean == pytest.approx([9.0] * 5 + [10.0] * 4)
    assert (low[0], high[0], low[-1], high[-1]) == (8.0, 10.0, 10.0, 10.0)
    assert "(2 seeds)" in figures.kinematics_figure(comparison).axes[0].lines[0].get_label()
    odd = [summary.ScoredRun.of(replace(approach(seed=s, moments=5), step_s=0.25 + s / 4)) for s in (0, 1)]
    for refused, word in (([summary.ScoredRun(runs()[0].metrics)], "0 mm/h"), (odd, r"0\.25 s and of 0\.5 s")):
        with pytest.raises(ValueError, match=word):
            figures.kinematics_figure(summary.compare_drives(refused)[0])
    with pytest.raises(ValueError, match="no run"):
        figures.birds_eye_sheet([])


def test_figures_show_every_intensity_and_collision_and_are_the_same_bytes(tmp_path):
    comparison = summary.compare_drives(runs())[0]
    figure, sheet = figures.kinematics_figure(comparison), figures.birds_eye_sheet([runs()[2].rollout])
    for panel in figure.axes:
        assert sum(len(line.get_xdata()) > 2 for line in panel.lines) == 3
        (cross,) = [line for line in panel.lines if line.get_marker() == "X"]
        assert cross.get_xdata()[0] == 3.5
    assert [line.get_label() for line in figure.axes[0].lines[:2]] == ["clear", "1.2 mm/h"]
    assert "hits lead at 3.5 s with 10.0 m/s" in sheet.axes[0].get_title(loc="left")
    for name, each in (("a", figure), ("b", figures.kinematics_figure(comparison))):
        figures.write_figure(tmp_path / f"{name}.svg", each)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    with pytest.raises(ValueError, match=r"a\.gif"):
        figures.write_figure(tmp_path / "a.gif", sheet)


def test_the_page_has_results_figures_and_origins():
    rollout = replace(runs()[0].rollout, software={"gsrain": "0.0.1"})
    report = drive_report_page([runs()[0]._replace(rollout=rollout), *runs()[1:]], settings={"command": "drive <x>"})
    assert report.headlines == {"runs": "3", "collisions": "1", "least time to collision": "0.00 s"}
    assert report.settings["intensities (mm/h)"] == "0, 1.2, 12"
    assert report.settings["versions"].startswith("gsrain 0.0.1, ")
    clear, _, heavy = (row[2:9] for row in report.tables[1].rows)
    assert clear == (0.0, 0, "time", 2.0, None, 15.0, 1.5) and heavy == (12.0, 0, "collision", 3.5, "lead", 0.0, 0.0)
    page = report_page(report)
    assert page.count("<img") == 2
    for word in ("Driving in rain: made-up", "drive &lt;x&gt;", rollout_hash(rollout)[:16], "shapely"):
        assert word in page
    half = drive_report_page([runs()[0], summary.ScoredRun(runs()[1].metrics)])
    assert [each.title for each in half.figures] == ["made-up, hand, from above"]
