import math

import numpy as np
import pytest
from msgspec import msgpack

from gsrain_engine.sweep.report import scenario_figure
from gsrain_engine.sweep.results import columns_of, summarized


def row(seed, intensity, *, collision=False, ttc=2.0, failed=False, agent="one", c=0.1):
    told = dict.fromkeys(columns_of("drive"))
    told |= {"scene": "street", "scenario": "lead", "agent": agent, "seed": seed, "intensity_mm_h": intensity}
    if failed:
        return told | {"status": "failed", "error": "it broke"}
    measured = {"collision": collision, "min_ttc_s": ttc, "planned_point_collision_rate": c}
    return told | {"status": "finished"} | measured


def test_collisions_have_wilsons_interval():
    rows = [row(seed, 8.5, collision=seed < 3) for seed in range(10)]
    cell = summarized(rows)[0]
    assert (cell.runs, cell.failed, cell.collisions) == (10, 0, 3)
    z, n, p = 1.959963984540054, 10, 0.3
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert cell.collision_rate.mean == 0.3
    assert cell.collision_rate.low == pytest.approx((middle - half) / (1 + z * z / n))
    assert cell.collision_rate.high == pytest.approx((middle + half) / (1 + z * z / n))


def test_failed_runs_tell_nothing_but_are_counted():
    first, second = summarized([row(0, 1.2, failed=True), row(1, 1.2, ttc=3.0), row(0, 12.0, failed=True)])
    assert (first.runs, first.failed, first.means["min_ttc_s"].mean) == (1, 1, 3.0)
    assert (second.runs, second.failed, second.collision_rate, second.means) == (0, 1, None, {})


def test_changes_are_those_of_the_same_seed():
    """Seeds differ by seconds, rain takes a tenth: only pairs can tell."""
    clear = [row(seed, 0.0, ttc=1.0 + seed) for seed in range(8)]
    rainy = [row(seed, 8.5, ttc=0.9 + seed) for seed in range(8)][::-1]
    first, second = summarized([*rainy, *clear, row(9, 8.5, ttc=0.0)])
    assert first.changes == {}
    change = second.changes["min_ttc_s"]
    assert change.count == 8
    assert change.mean == pytest.approx(-0.1) and change.high < -0.0999 < change.low + 0.001
    assert second.means["min_ttc_s"].high - second.means["min_ttc_s"].low > 1


def test_the_order_of_rows_does_not_matter():
    rows = [row(seed, r, agent=agent, ttc=seed + r) for seed in range(3) for r in (12.0, 0.0) for agent in ("b", "a")]
    cells = summarized(rows)
    assert [(cell.agent, cell.intensity_mm_h) for cell in cells] == [("a", 0), ("a", 12), ("b", 0), ("b", 12)]
    assert msgpack.encode(cells) == msgpack.encode(summarized(rows[::-1]))


def test_the_figure_is_the_same_bytes_and_shows_every_agent():
    rows = [row(seed, r, agent=agent, ttc=1 + seed / 3, collision=seed > r / 8) for seed in range(3)
            for r in (0.0, 20.0) for agent in ("one", "two")]  # fmt: skip
    cells = summarized(rows)
    figure = scenario_figure(cells)
    assert np.array_equal(figure, scenario_figure(cells))
    blue, orange = (31, 119, 180), (255, 127, 14)
    for color in (blue, orange):
        assert (np.abs(figure.astype(int) - color).sum(axis=2) < 6).sum() > 500
    alone = scenario_figure(summarized([each for each in rows if each["agent"] == "one"]))
    assert (np.abs(alone.astype(int) - orange).sum(axis=2) < 6).sum() == 0
