"""`gsrain bench` on tiny scenes: every row, every number, and what follows from them."""

import json
from functools import partial

import pytest

from app import bench as bench_command
from app.main import run
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene

SMALL = {"sizes": "48x32", "frames": 2, "backends": "cpu"}
ROW = {
    *("scene", "backend", "width", "height", "splats", "intensity_mm_h", "frame_ms_median", "stages_ms"),
    *("gaussians", "frames", "frame_ms_min", "frame_ms_max", "processor_ms_min", "ns_per_splat"),
    *("drops_drawn", "haze_drawn"),
}
"""Of each row, at least; the first eight are the contract."""


@pytest.fixture
def small(tmp_path):
    write_scene(small_scene(), tmp_path / "small")
    return str(tmp_path / "small")


def words(**options):
    return ["bench", "render", *(f"--{name}={value}" for name, value in (SMALL | options).items())]


def test_rows_costs_of_rain_and_lines_over_gaussians(small, reported, capsys):
    scenes = ("random-500", "random-2k", "random-6k", small)
    report = reported(*words(scenes=",".join(scenes), rain="0,8.5"))
    rows = report["rows"]
    names = ["random-500", "random-2k", "random-6k", "small"]
    assert [(row["scene"], row["intensity_mm_h"]) for row in rows] == [
        (name, mm_h) for name in names for mm_h in (0, 8.5)
    ]
    for row in rows:
        assert set(row) >= ROW and {"project", "sort", "draw", "read"} <= set(row["stages_ms"])
        assert (row["backend"], row["width"], row["height"], row["frames"]) == ("cpu", 48, 32, 2)
        assert 0 < row["frame_ms_min"] <= row["frame_ms_median"] <= row["frame_ms_max"]
        assert row["ns_per_splat"] == pytest.approx(1e6 * row["frame_ms_median"] / row["splats"])
    clear, rainy = rows[2:4]
    assert clear["gaussians"] == rainy["gaussians"] == 2000 and 1500 < clear["splats"] <= 2000 < rainy["splats"]
    assert clear["drops_drawn"] == clear["haze_drawn"] == 0 < rainy["haze_drawn"]
    assert [(cost["scene"], cost["intensity_mm_h"]) for cost in report["rain_costs"]] == [(name, 8.5) for name in names]
    assert report["rain_costs"][1]["share"] == pytest.approx(rainy["frame_ms_median"] / clear["frame_ms_median"] - 1)
    (fit,) = report["fits"]  # of the random scenes: three of one SH degree
    assert (fit["backend"], fit["width"], fit["scenes"]) == ("cpu", 48, 3) and 0 <= fit["r2"] <= 1
    middle = fit["intercept_ms"] + 1e-6 * fit["slope_ns_per_gaussian"] * (500 + 2000 + 6000) / 3
    assert middle == pytest.approx(sum(row["frame_ms_median"] for row in rows[0:6:2]) / 3)
    assert set(report["machine"]["devices"]) == {"cpu"}
    assert "random-2k" in capsys.readouterr().out


def test_a_dash_prints_the_json_alone(capsys):
    assert run(words(scenes="random-500", rain=0, json="-")) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["rows"][0]["gaussians"] == 500
    assert "random-500" in printed.err


def test_loading_times_each_format(reported):
    report = reported("bench", "loading", "--scenes", "random-2k", "--repeats", "2")
    rows = {row["format"]: row for row in report["rows"]}
    assert list(rows) == ["folder", ".ply", ".splat", ".spz"]
    for row in rows.values():
        assert (row["scene"], row["gaussians"], row["sh_degree"]) == ("random-2k", 2000, 0)
        assert row["bytes_ms_min"] > 0 and 0 < row["read_ms_min"] <= row["read_ms_median"] and row["write_ms"] > 0
        assert row["ns_per_gaussian"] == pytest.approx(1e6 * row["read_ms_median"] / 2000)
    assert rows[".splat"]["megabytes"] == pytest.approx(2000 * 32e-6)  # 32 bytes each
    assert rows["folder"]["megabytes"] > rows[".ply"]["megabytes"] > rows[".splat"]["megabytes"]


def test_all_benchmarks_in_one_command(small, reported, monkeypatch):
    monkeypatch.setattr(bench_command, "render", partial(bench_command.render, **SMALL))
    monkeypatch.setattr(bench_command, "recoloring", partial(bench_command.recoloring, views=2, size="48x32"))
    numbers = reported("bench", "--scenes", f"random-2k,{small}")
    assert set(numbers) == {"render", "loading", "recoloring"}
    assert {row["scene"] for each in numbers.values() for row in each["rows"]} == {"random-2k", "small"}
    assert {row["intensity_mm_h"] for row in numbers["render"]["rows"]} == {0, 8.5}
    for row in numbers["recoloring"]["rows"]:
        assert (row["views"], row["width"]) == (2, 48)
        assert row["seconds"] == pytest.approx(sum(row["stages_s"].values()))
        assert row["iteration_ms"] == pytest.approx(1000 * row["stages_s"]["solving"] / row["iterations"])
        assert 0 < row["seen"] <= row["gaussians"] and row["psnr_db"] > row["psnr_before_db"]
