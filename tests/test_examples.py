"""Every example runs on a small scene and has the results that it describes."""

import ast
import csv
import json
import os
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.scene.camera_path_io import read_camera_path
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.scene import Layer, PoseTrack
from gsrain_engine.simulation.rollout_io import read_rollout
from repository import REPOSITORY
from small_scene import patch, small_scene

FOLDER = REPOSITORY / "examples"


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """A scene folder with a road long enough to drive on: 80 m, in 8 s, a wall at its end."""
    times = np.arange(9.0)
    way = np.stack([10 * times, np.zeros(9), np.full(9, 1.5)], axis=1)
    scene = replace(small_scene("road"), ego=PoseTrack(times, way, np.tile([1.0, 0, 0, 0], (9, 1)), np.ones(9, bool)))
    ground = patch((0, -6, 0), np.array([100.0, 0, 0]), np.array([0, 12.0, 0]), 40, (0.35, 0.33, 0.30))
    wall = patch((100, -12, 0), np.array([0, 24.0, 0]), np.array([0, 0, 9.0]), 20, (0.7, 0.45, 0.3))
    folder = tmp_path_factory.mktemp("scene") / "road"
    write_scene(replace(scene, layers=(Layer("road", ground), Layer("wall", wall), scene.layers[2])), folder)
    return folder


def picture(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(float)


def frames(path):
    with av.open(str(path)) as video:
        return [frame.to_ndarray(format="rgb24").astype(float) for frame in video.decode(video=0)]


def change(first, second):
    return np.abs(second - first).mean()


def check_quick_start(out, printed):
    rainy, video, clear = picture(out / "rain.png"), frames(out / "rain.mp4"), frames(out / "rain.clear.mp4")
    assert rainy.shape == (320, 480, 3) and rainy.std() > 10
    assert len(video) == len(clear) == 5 and change(video[0], clear[0]) > 0
    assert printed.count("of white on average") == 5 and "stopped in time" in printed
    rate, error = (float(word) for word in printed.split("carry ")[1].split(" mm/h")[0].split(" +- "))
    assert abs(rate - 8.5) < 4 * error
    assert read_rollout(out / "run.jsonl").agent == "oracle-idm"


def check_viewer(out, printed):
    dry, light, heavy = (picture(out / f"{intensity}mm_h.png") for intensity in (0, 5, 12))
    assert 0 < change(dry, light) < change(dry, heavy) < 60
    assert "it rains 12 mm/h at" in printed


def check_open_and_rain(out, printed):
    dry, wet = picture(out / "rain_0mm_h.png"), picture(out / "rain_8.5mm_h.png")
    assert dry.shape == (640, 960, 3) and dry.std() > 10
    assert 0.1 < change(dry, wet) < 40


def check_calibrate(out, printed):
    fitted, published = load_calibration(str(out / "calibration.yaml")), load_calibration("published")
    assert [round(row.intensity_mm_h, 1) for row in fitted.rows] == [1.2, 4.0, 8.5, 12.0]
    assert fitted.velocity(np.array([1.0])) == pytest.approx(published.velocity(np.array([1.0])), rel=0.01)
    assert picture(out / "calibration.png").std() > 10
    assert "published at 8.5 mm/h" in printed and "example at 8.5 mm/h" in printed


def check_virtual_disdrometer(out, printed):
    measured = [float(line.split("asked,")[1].split("+-")[0]) for line in printed.splitlines()]
    assert measured == pytest.approx([1.2, 8.5, 12.0, 0.80, 6.59, 11.03], rel=0.01)
    assert len(list(out.glob("*.nc"))) == 6


def check_camera_path(out, printed):
    video, path = frames(out / "flight.mp4"), read_camera_path(out / "flight.json")
    assert len(video) == 20 and change(video[0], video[-1]) > 1
    assert path.end_s == 2.0 and path.positions[2, 2] == pytest.approx(path.positions[0, 2] + 5, abs=0.01)


def check_convert(out, printed):
    assert {read_scene(file).gaussian_count for file in out.iterdir()} == {1600 + 400 + 144}
    quality = {line.split(":")[0].rpartition(".")[2]: float(line.split()[-2]) for line in printed.splitlines()}
    assert quality["ply"] > 80 and quality["splat"] > 25 and quality["spz"] > 25


def check_recolor(out, printed):
    assert read_scene(out / "at_dusk").has_wet_colors
    day, dusk = picture(out / "dusk_0.png").mean(axis=(0, 1)), picture(out / "dusk_1.png").mean(axis=(0, 1))
    assert np.all(dusk < day) and (dusk / day)[0] < (dusk / day)[2]  # red loses most
    before, after = (float(part.split(" dB")[0].split()[-1]) for part in printed.split(": ")[1].split(","))
    assert after > before + 5


def check_wet(out, printed):
    assert read_scene(out / "wet").has_wet_colors
    clear, wet, rainy = (picture(out / f"{name}.png") for name in ("clear", "wet", "rainy"))
    assert change(clear, wet) > 2 and change(wet, rainy) > 0.1
    assert "100% Done" in printed


def check_custom_agent(out, printed):
    collided = {line.split()[1]: line.split()[3] for line in printed.splitlines() if line.startswith("stationary-lead")}
    assert collided == {"constant-velocity": "yes", "two-seconds": "no"}
    assert len(list(out.glob("*.jsonl"))) == 2


def check_sweep(out, printed):
    with (out / "sweep" / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8 and {row["status"] for row in rows} == {"finished"}
    assert "constant-velocity at 8.5 mm/h: 2 of 2 collide" in printed and "oracle-idm at 8.5 mm/h: 0 of 2" in printed


def check_notebook(outputs):
    assert outputs["scene"].startswith("2,144 Gaussians")
    both = np.asarray(outputs["draw"]).astype(float)
    clear, rainy = np.split(both, 2, axis=1)
    assert clear.std() > 10 and 0.1 < change(clear, rainy) < 60
    assert np.asarray(outputs["alone"]).std() > 1
    assert list(outputs["contrast"]) == ["2-10 m", "10-20 m", "20-40 m", "40-80 m"]
    assert outputs["contrast"]["10-20 m"] < outputs["contrast"]["2-10 m"] < 1


CHECKS = {
    "00_quick_start.py": check_quick_start,
    "01_open_and_rain.py": check_open_and_rain,
    "02_calibrate.py": check_calibrate,
    "03_virtual_disdrometer.py": check_virtual_disdrometer,
    "04_camera_path.py": check_camera_path,
    "05_convert.py": check_convert,
    "06_recolor.py": check_recolor,
    "07_wet.py": check_wet,
    "08_custom_agent.py": check_custom_agent,
    "09_sweep.py": check_sweep,
    "10_notebook.ipynb": check_notebook,
    "11_viewer.py": check_viewer,
}
TAKE_NO_SCENE = ("02_calibrate.py", "03_virtual_disdrometer.py")


def notebook_outputs(notebook: Path, **parameters: object) -> dict[str, object]:
    """Run a notebook's cells as Jupyter does; the value of the last line of each, by the cell's id."""
    names, outputs = {}, {}
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert not cell["outputs"] and cell["execution_count"] is None
        lines = ast.parse("".join(cell["source"]))
        last = lines.body.pop() if isinstance(lines.body[-1], ast.Expr) else None
        exec(compile(lines, cell["id"], "exec"), names)
        if "parameters" in cell["metadata"].get("tags", ()):
            names.update(parameters)
        if last is not None:
            outputs[cell["id"]] = eval(compile(ast.Expression(last.value), cell["id"], "eval"), names)
    return outputs


@pytest.mark.parametrize("name", CHECKS)
def test_examples_have_the_results_that_they_describe(name, road, tmp_path, monkeypatch, capsys):
    if name.endswith(".ipynb"):
        CHECKS[name](notebook_outputs(FOLDER / name, SCENE=str(road)))
        return
    if name == "09_sweep.py":
        pytest.importorskip("pyarrow")
    if name == "11_viewer.py" and not os.environ.get("DISPLAY"):
        pytest.skip("no display and no Xvfb (Debian: xvfb)")
    scene = () if name in TAKE_NO_SCENE else (str(road),)
    monkeypatch.setattr(sys, "argv", [name, str(tmp_path / "out"), *scene])
    runpy.run_path(str(FOLDER / name), run_name="__main__")
    CHECKS[name](tmp_path / "out", capsys.readouterr().out)


def test_every_example_is_run_and_listed():
    there = sorted(each.name for each in FOLDER.iterdir() if each.suffix in (".py", ".ipynb"))
    listed = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert there == list(CHECKS)
    for name in there:
        assert f"`{name}`" in listed
        if name.endswith(".py"):
            docstring = ast.get_docstring(ast.parse((FOLDER / name).read_text(encoding="utf-8"))) or ""
            assert docstring.startswith("Shows ") and f"python examples/{name} [OUT]" in docstring
