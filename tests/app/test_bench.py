"""`gsrain bench` on tiny scenes: every row, every number, what follows from them, and bad input."""

import json
from functools import partial

import pytest

from app import bench as bench_command
from app.main import run
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene

SMALL_CALL = {"sizes": "48x32", "frames": 2, "backends": "cpu"}
SMALL = {f"--{name}": str(value) for name, value in SMALL_CALL.items()}
ROW = {
    *("scene", "backend", "width", "height", "splats", "intensity_mm_h", "frame_ms_median", "stages_ms"),
    *("gaussians", "frames", "frame_ms_min", "frame_ms_max", "ns_per_splat", "drops_drawn", "haze_drawn"),
}
"""Of each row, at least; the first eight are the contract."""


def bench(**options):
    named = SMALL | {f"--{name}": str(value) for name, value in options.items()}
    return run(["bench", "render", *(word for option in named.items() for word in option)])


def benched(tmp_path, **options):
    file = tmp_path / "bench.json"
    assert bench(**options, json=file) == 0
    return json.loads(file.read_text())


def test_rows_say_what_was_timed(tmp_path, capsys):
    scene = tmp_path / "small"
    write_scene(small_scene(), scene)
    report = benched(tmp_path, scenes=f"random-2k,{scene}", rain="0,8.5")
    rows = report["rows"]
    assert [(row["scene"], row["intensity_mm_h"]) for row in rows] == [
        ("random-2k", 0), ("random-2k", 8.5), ("small", 0), ("small", 8.5)]  # fmt: skip
    for row in rows:
        assert set(row) >= ROW
        assert (row["backend"], row["width"], row["height"], row["frames"]) == ("cpu", 48, 32, 2)
        assert 0 < row["frame_ms_min"] <= row["frame_ms_median"] <= row["frame_ms_max"]
        assert {"project", "sort", "draw", "read"} <= set(row["stages_ms"])
        assert row["ns_per_splat"] == pytest.approx(1e6 * row["frame_ms_median"] / row["splats"])
    clear, rainy = rows[:2]
    assert clear["gaussians"] == rainy["gaussians"] == 2000
    assert 1500 < clear["splats"] <= 2000
    assert clear["drops_drawn"] == clear["haze_drawn"] == 0 < rainy["haze_drawn"]
    assert rainy["splats"] > clear["splats"]
    assert report["fits"] == []
    assert [(cost["scene"], cost["intensity_mm_h"]) for cost in report["rain_costs"]] == [
        ("random-2k", 8.5), ("small", 8.5)]  # fmt: skip
    expected = rainy["frame_ms_median"] / clear["frame_ms_median"] - 1
    assert report["rain_costs"][0]["share"] == pytest.approx(expected)
    assert set(report["machine"]["devices"]) == {"cpu"}
    assert "random-2k" in capsys.readouterr().out


def test_a_line_goes_through_three_scenes_of_a_size(tmp_path):
    scenes = "random-500,random-2k,random-6k"
    report = benched(tmp_path, scenes=scenes, rain=0, sizes="48x32,24x16")
    assert [(row["width"], row["gaussians"]) for row in report["rows"]] == [
        (48, 500), (24, 500), (48, 2000), (24, 2000), (48, 6000), (24, 6000)]  # fmt: skip
    assert [(fit["backend"], fit["width"], fit["scenes"]) for fit in report["fits"]] == [("cpu", 24, 3), ("cpu", 48, 3)]
    for fit in report["fits"]:
        assert 0 <= fit["r2"] <= 1
        middle = fit["intercept_ms"] + 1e-6 * fit["slope_ns_per_gaussian"] * (500 + 2000 + 6000) / 3
        times = [row["frame_ms_median"] for row in report["rows"] if row["width"] == fit["width"]]
        assert middle == pytest.approx(sum(times) / 3)


def test_a_dash_prints_the_json_alone(capsys):
    assert bench(scenes="random-500", rain=0, json="-") == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["rows"][0]["gaussians"] == 500
    assert "random-500" in said.err


def test_loading_says_how_long_each_format_takes(tmp_path):
    file = tmp_path / "loading.json"
    assert run(["bench", "loading", "--scenes", "random-2k", "--repeats", "2", "--json", str(file)]) == 0
    rows = {row["format"]: row for row in json.loads(file.read_text())["rows"]}
    assert list(rows) == ["folder", ".ply", ".splat", ".spz"]
    for row in rows.values():
        assert (row["scene"], row["gaussians"], row["sh_degree"]) == ("random-2k", 2000, 0)
        assert row["bytes_ms_min"] > 0 and 0 < row["read_ms_min"] <= row["read_ms_median"] and row["write_ms"] > 0
        assert row["ns_per_gaussian"] == pytest.approx(1e6 * row["read_ms_median"] / 2000)
    assert rows[".splat"]["megabytes"] == pytest.approx(2000 * 32e-6)  # 32 bytes each
    assert rows["folder"]["megabytes"] > rows[".ply"]["megabytes"] > rows[".splat"]["megabytes"]


def test_recoloring_says_how_long_each_stage_takes(tmp_path):
    file = tmp_path / "recoloring.json"
    write_scene(small_scene(), tmp_path / "small")
    words = ["--scenes", f"random-2k,{tmp_path / 'small'}", "--views", "2", "--size", "48x32", "--iterations", "4"]
    assert run(["bench", "recoloring", *words, "--json", str(file)]) == 0
    rows = json.loads(file.read_text())["rows"]
    assert [(row["scene"], row["views"], row["width"], row["iterations"]) for row in rows] == [
        ("random-2k", 2, 48, 4), ("small", 2, 48, 4)]  # fmt: skip
    for row in rows:
        assert row["seconds"] == pytest.approx(sum(row["stages_s"].values()))
        assert row["iteration_ms"] == pytest.approx(250 * row["stages_s"]["solving"])
        assert 0 < row["seen"] <= row["gaussians"]
        assert row["psnr_db"] > row["psnr_before_db"]


def test_alone_it_times_all_there_is(tmp_path, monkeypatch):
    file = tmp_path / "all.json"
    monkeypatch.setattr(bench_command, "render", partial(bench_command.render, **SMALL_CALL))
    monkeypatch.setattr(bench_command, "recoloring", partial(bench_command.recoloring, views=2, size="48x32"))
    write_scene(small_scene(), tmp_path / "small")
    assert run(["bench", "--scenes", str(tmp_path / "small"), "--json", str(file)]) == 0
    numbers = json.loads(file.read_text())
    assert set(numbers) == {"render", "loading", "recoloring"}
    assert {row["scene"] for each in numbers.values() for row in each["rows"]} == {"small"}
    assert {row["intensity_mm_h"] for row in numbers["render"]["rows"]} == {0, 8.5}
