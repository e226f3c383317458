"""Figures over time and from above, and the page of runs."""

from functools import cache

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from msgspec.structs import replace

from gsrain_engine.evaluation.report import report_page
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.metrics.figures import (
    birds_eye_sheet,
    curve_band,
    curve_over_time,
    kinematics_figure,
    rain_colors,
    write_figure,
)
from gsrain_engine.simulation.metrics.report import drive_report_page, rollout_hash
from gsrain_engine.simulation.metrics.summary import ScoredRun, compare_drives
from small_rollout import approach


@cache
def _compared():
    runs = [ScoredRun.of(approach(intensity_mm_h=r, moments=m)) for r, m in ((0.0, 9), (1.2, 9), (12.0, 20))]
    return runs, compare_drives(runs)[0]


def test_curves_of_a_run():
    run = approach(lead_x=40.0, moments=20)
    assert curve_over_time(run, "speed_m_s") == pytest.approx(np.full(15, 10.0))
    assert (
        np.isnan(curve_over_time(run, "acceleration_m_s2")[0])
        and (curve_over_time(run, "acceleration_m_s2")[1:] == 0).all()
    )
    assert curve_over_time(run, "gap_m")[:2] == pytest.approx([35.0, 32.5])
    assert curve_over_time(run, "ttc_s")[-1] == 0.0


def test_bands_are_of_the_runs_that_go_on():
    runs = [ScoredRun.of(approach(speed=v, seed=i, moments=m)) for i, (v, m) in enumerate(((8.0, 5), (10.0, 9)))]
    (weather,) = compare_drives(runs)[0].weathers
    times, mean, low, high = curve_band(weather, "speed_m_s")
    assert len(times) == 9 and times[-1] == 2.0
    assert mean[:5] == pytest.approx(9.0) and mean[5:] == pytest.approx(10.0)
    assert (low[0], high[0]) == (8.0, 10.0) and low[-1] == high[-1] == 10.0


def test_without_roll_outs_there_is_nothing_over_time():
    runs, _ = _compared()
    bare = compare_drives([ScoredRun(each.metrics) for each in runs])[0]
    with pytest.raises(ValueError, match="0 mm/h have no roll-outs"):
        kinematics_figure(bare)


def test_runs_of_other_steps_have_no_common_curve():
    runs = [ScoredRun.of(approach(moments=5)), ScoredRun.of(replace(approach(seed=1, moments=5), step_s=0.5))]
    with pytest.raises(ValueError, match=r"steps of 0\.25 s and of 0\.5 s"):
        curve_band(compare_drives(runs)[0].weathers[0], "speed_m_s")


def test_all_intensities_are_in_every_panel_and_the_collision_is_marked():
    figure = kinematics_figure(_compared()[1])
    assert len(figure.axes) == 4
    for panel in figure.axes:
        crosses = [line for line in panel.lines if line.get_marker() == "X"]
        curves = [line for line in panel.lines if len(line.get_xdata()) > 2]
        assert len(curves) == 3 and len(crosses) == 1
    speed = figure.axes[0]
    assert [line.get_label() for line in speed.lines[:2]] == ["clear", "1.2 mm/h"]
    cross = next(line for line in speed.lines if line.get_marker() == "X")
    assert (cross.get_xdata()[0], cross.get_ydata()[0]) == (3.5, 10.0)


def test_heavier_rain_is_darker():
    colors = rain_colors([12.0, 0.0, 1.2])
    luma = {rain: np.dot(to_rgba(color)[:3], (0.3, 0.59, 0.11)) for rain, color in colors.items()}
    assert luma[1.2] > luma[12.0] and to_rgba(colors[0.0])[0] > to_rgba(colors[0.0])[2]


def test_the_same_runs_give_the_same_bytes(tmp_path):
    runs, comparison = _compared()
    for name in ("a", "b"):
        write_figure(tmp_path / f"{name}.png", birds_eye_sheet([runs[-1].rollout]))
        write_figure(tmp_path / f"{name}.svg", kinematics_figure(comparison))
    for kind in ("png", "svg"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


def test_other_kinds_of_figures_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"a\.gif: expected a name that ends with \.png, \.pdf, \.svg"):
        write_figure(tmp_path / "a.gif", kinematics_figure(_compared()[1]))


def test_from_above_each_run_has_a_panel_on_one_scale():
    runs, _ = _compared()
    figure = birds_eye_sheet([each.rollout for each in runs], Route(np.array([[0.0, 0], [50, 0]])))
    assert len(figure.axes) == 3 and len({each.get_xlim() for each in figure.axes}) == 1
    assert "hits lead at 3.5 s with 10.0 m/s" in figure.axes[2].get_title(loc="left")
    assert "hits" not in figure.axes[0].get_title(loc="left")
    (cross,) = [line for line in figure.axes[2].lines if line.get_marker() == "X"]
    assert cross.get_xdata()[0] == pytest.approx(38.0)  # the front at 35 + 3 m touches the rear at 38 m
    with pytest.raises(ValueError, match="no run"):
        birds_eye_sheet([])


def test_the_page_has_results_figures_and_origins():
    runs, _ = _compared()
    page = report_page(drive_report_page(runs, settings={"command": "gsrain drive <x>"}))
    assert page.count("<img") == 2
    for words in ("Driving in rain: made-up", "gsrain drive &lt;x&gt;", rollout_hash(runs[0].rollout)[:16], "shapely"):
        assert words in page
    only_numbers = report_page(drive_report_page([ScoredRun(each.metrics) for each in runs]))
    assert "<img" not in only_numbers and "Every run" in only_numbers


def test_hashes_are_of_what_happened():
    assert rollout_hash(approach(moments=5)) == rollout_hash(approach(moments=5))
    assert rollout_hash(approach(moments=5)) != rollout_hash(approach(moments=6))
