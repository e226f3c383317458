"""Runs side by side, and the table of results as the paper prints it."""

from msgspec.structs import replace

from gsrain_engine.simulation.metrics.summary import NOT_MEASURED, ScoredRun, compare_drives, results_table
from small_rollout import approach


def _runs():
    hit, free = {"moments": 20}, {"moments": 9}
    return [
        ScoredRun.of(approach(intensity_mm_h=12.0, **hit)),
        ScoredRun.of(approach(intensity_mm_h=0.0, **free)),
        ScoredRun.of(approach(intensity_mm_h=1.2, **free)),
    ]


def test_rows_go_by_intensity_and_seed():
    runs = [
        ScoredRun.of(approach(intensity_mm_h=r, seed=s, moments=5)) for r, s in ((8.5, 1), (0.0, 1), (8.5, 0), (0.0, 0))
    ]
    (only,) = compare_drives(runs)
    assert [each.intensity_mm_h for each in only.weathers] == [0.0, 8.5]
    assert [run.metrics.seed for run in only.runs] == [0, 1, 0, 1]
    assert only.title == "made-up, hand"


def test_scenarios_and_agents_stay_apart():
    runs = _runs()
    other = ScoredRun(replace(runs[0].metrics, agent="other"))
    assert [(each.agent, len(each.runs)) for each in compare_drives([*runs, other])] == [("hand", 3), ("other", 1)]


def test_the_table_is_the_papers():
    table = results_table(compare_drives(_runs()))
    assert table.columns[2:6] == ("R (mm/h)", "Coll.", "Min. TTC (s)", "C")
    clear, light, heavy = table.rows
    assert clear[2:4] == ("Clear", "No") and light[2] == "1.2"
    # At the end of 9 moments it is at 20 m: 15 m of gap at 10 m/s.
    assert clear[4] == "1.500"
    assert heavy[2:] == ("12", "Yes", "0.000", *(4 * (NOT_MEASURED,)))
    assert any("N = 6" in each for each in table.definitions)


def test_rates_are_per_cent():
    run = ScoredRun.of(approach(moments=9))
    rate = run.metrics.planned_point_collision_rate
    assert rate is not None and 0 < rate < 1
    assert results_table(compare_drives([run])).rows[0][5] == f"{100 * rate:.1f} %"


def test_seeds_become_means_with_bands():
    speeds = [ScoredRun.of(approach(speed=v, seed=i, moments=9)) for i, v in enumerate((8.0, 9.0, 10.0))]
    hit = ScoredRun.of(approach(seed=3, moments=20))
    (only,) = compare_drives([*speeds, hit])
    (weather,) = only.weathers
    assert weather.collisions == 1
    interval = weather.mean("min_ttc_s")
    assert interval is not None and interval.low < interval.mean < interval.high
    free = weather.mean("min_ttc_s", without_collision=True)
    assert free is not None and free.mean > interval.mean
    row = results_table(compare_drives([*speeds, hit])).rows[0]
    assert row[3] == "1 of 4" and ".." in row[4]


def test_markdown_and_text_have_all_cells():
    table = results_table(compare_drives(_runs()))
    lines = table.markdown.splitlines()
    assert lines[0].startswith("| Scenario | Agent |") and len({line.count("|") for line in lines[:5]}) == 1
    assert table.text.splitlines()[2].split()[:4] == ["made-up", "hand", "Clear", "No"]
    assert all(each in " ".join(table.text.split()) and each in table.markdown for each in table.definitions)
    widest = max(80, len(table.text.splitlines()[1]))
    assert max(map(len, table.text.splitlines())) <= widest, "definitions wrap"


def test_names_do_not_break_markdown():
    run = ScoredRun(replace(_runs()[1].metrics, scenario="a|b"))
    assert "a\\|b" in results_table(compare_drives([run])).markdown
