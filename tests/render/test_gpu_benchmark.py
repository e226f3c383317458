"""`make gpu` in small, on software OpenGL and with a stand-in for gsplat."""

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install gsrain[jobs]")

from benchmarks.gpu import PARTS, SMALL, Options, main, run_part
from benchmarks.gpu_page import BEGIN, END, figures, with_figures
from gsrain_engine.render.opengl import shaders
from gsrain_engine.render.opengl.renderer import SplatRenderer
from gsrain_engine.render.opengl.shaders import GpuTimers
from render.cpu.raster_scenes import drawn, random_gaussians

BACKENDS = {"opengl-tiles", "opengl-quads"}


@pytest.fixture
def rows_of(context, tmp_path):
    """Rows of a part, with a stand-in for gsplat or another module."""

    def measured(part, gsplat="render.gsplat_stand_in"):
        return list(PARTS[part][0](Options(SMALL, gsplat, tmp_path)))

    return measured


def test_every_part_measures_every_back_end(rows_of, tmp_path):
    results = {part: (rows_of(part), "") for part in PARTS if not part.endswith("tests")}
    rows = {part: found for part, (found, _) in results.items()}
    assert not any(row.get("errors") for found in rows.values() for row in found)
    (frame,), (image, rainy), (step,) = rows["frames"], rows["images"], rows["training"]
    assert set(frame["ms"]) == BACKENDS | {"gsplat"} and min(frame["ms"].values()) > 0
    assert set(frame["stages_ms"]) == {"project", "sort", "draw"}
    assert {row["backend"] for row in rows["rain"]} == BACKENDS
    assert all(row["rainy_ms"] > 0 and row["clear_ms"] > 0 for row in rows["rain"])
    for row in (image, rainy):
        assert row["psnr_db"].pop("cpu") == float("inf")
        assert set(row["psnr_db"]) == BACKENDS and min(row["psnr_db"].values()) > 50
    assert len(list((tmp_path / "images").iterdir())) == 6
    assert rows["sort"][0]["is_right"] and len(rows["read_back"]) == 3
    (large,) = rows["lod"]
    assert set(large["ms"]) == {"cut", "all", "ordinary"} and 0 < large["drawn"] <= large["gaussians"] == 5000
    assert step["gsrain_ms"] > 0 and step["plain_ms"] > 0 and step["gaussians"] >= 0.9 * SMALL.trained_gaussians
    assert figures(results).count("\n### ") == len(results) - 1


def test_a_back_end_that_fails_is_named_and_the_others_are_measured(rows_of):
    (row,) = rows_of("frames", gsplat="no_such_module")
    assert set(row["ms"]) == BACKENDS and set(row["errors"]) == {"gsplat"}
    text = figures({"frames": ([row], "")})
    assert "**gsplat failed** (random-500 48x32): ModuleNotFoundError" in text and "| not measured |" in text


def test_the_command_writes_the_page_part_by_part(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"# Page\n\n{BEGIN}\nold\n{END}\n\nmore\n")
    main(["--small", "--output", str(tmp_path), "--page", str(page), "--parts", "machine,build", "--gsplat", "missing"])
    text = page.read_text()
    assert text.startswith("# Page\n") and text.endswith("\nmore\n") and "old" not in text
    assert "### Machine" in text and "**gsplat failed**: ModuleNotFoundError" in text
    main(["--small", "--output", str(tmp_path), "--parts", "sort", "--seconds", "0"])
    assert "**This part is incomplete**: left out" in (tmp_path / "gpu.md").read_text()
    with pytest.raises(SystemExit):
        main(["--parts", "sort,paint"])


def test_a_part_is_stopped_at_its_limit(tmp_path):
    assert run_part("machine", ["--output", str(tmp_path)], tmp_path, 0.1) == ([], "stopped after 0 s")
    rows, error = run_part("machine", ["--output", str(tmp_path / "missing")], tmp_path, 60)
    assert rows == [] and "FileNotFoundError" in error


def test_figures_are_compared_with_their_targets():
    frames = [
        {"scene": "a", "size": [9, 6], "ms": {"opengl-tiles": took, "gsplat": 1.0}, "errors": {}} for took in (0.8, 0.9)
    ]
    rain = [
        {"scene": "a", "size": (9, 6), "backend": "b", "clear_ms": 1.0, "rainy_ms": took, "creating_ms": 1.0,
         "errors": {}} for took in (1.2, 1.3)
    ]  # fmt: skip
    reading = [{"way": "a", "size": (9, 6), "ms": took} for took in (1.5, 1.6)]
    training = [{"size": (9, 6), "gsrain_ms": took, "plain_ms": 1.0, "errors": {}} for took in (1.4, 1.5)]
    for part, rows in (("frames", frames), ("rain", rain), ("read_back", reading), ("training", training)):
        lines = [line for line in figures({part: (rows, "")}).splitlines() if line.startswith("| ")]
        assert [line.endswith(" not met |") for line in lines[2:]] == [False, True]
        assert lines[2].endswith(" met |")


def test_a_page_without_marks_becomes_the_figures():
    assert with_figures("anything", "figures") == "figures"


@pytest.mark.parametrize("is_software", [True, False])
def test_a_stage_around_a_frame_measures_the_whole(context, monkeypatch, is_software):
    monkeypatch.setattr(shaders, "is_software", lambda _: is_software)
    timers = GpuTimers(context)
    renderer = SplatRenderer(context, rasterizer="tiles", timers=timers)
    with timers.stage("frame"):
        drawn(renderer, random_gaussians(100, 1, 0))
    assert set(timers.collect()) == {"frame"}
    drawn(renderer, random_gaussians(100, 1, 0))
    renderer.finish()
    assert {name for name, took in renderer.statistics.stages_ms.items() if took >= 0} == {"project", "sort", "draw"}
    assert timers.collect() == {}
