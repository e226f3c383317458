"""Jobs of the Python API: each program of the page runs, and what jobs refuse."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gsrain as gr
from app.main import run
from boxy_scene import boxy_scene
from extension_package import titled_blocks
from gsrain_engine.scene.formats.scene_files import write_scene
from repository import REPOSITORY

PROGRAMS = titled_blocks(REPOSITORY / "docs" / "python.md")
JOBS = {
    "detection": "evaluate_detection", "attribution": "attribute", "lidar": "evaluate_lidar", "transfer": "transfer",
    "recolor": "recolor", "reconstruct": "reconstruct", "export_rain": "export_rain", "dataset": "dataset",
    "publish": "publish", "sweep": "sweep",
}  # fmt: skip
NEEDS = {"detection": "pycocotools", "attribution": "pycocotools", "reconstruct": "torch"}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a small scene called street, in which the programs run."""
    folder = tmp_path_factory.mktemp("programs")
    write_scene(boxy_scene("street"), folder / "street")
    return folder


@pytest.mark.parametrize("name", JOBS)
def test_each_program_of_the_page_runs(place, tmp_path, monkeypatch, name):
    program = PROGRAMS[f"{name}.py"]
    place = tmp_path if name == "sweep" else place  # drives need the built-in street
    assert f"gr.{JOBS[name]}(" in program and len([line for line in program.splitlines() if line]) <= 10
    pytest.importorskip(NEEDS.get(name, "numpy"))
    monkeypatch.chdir(place)
    if '"rainy' in program and name != "transfer" and not (place / "rainy").is_dir():
        exec(compile(PROGRAMS["transfer.py"], "transfer.py", "exec"), {})
    values = {}
    exec(compile(program, f"{name}.py", "exec"), values)
    (result,) = (each for each in values.values() if hasattr(each, "save") and hasattr(each, "table"))
    written = result.save(f"numbers of {name}")
    assert all((place / f"numbers of {name}" / each).stat().st_size for each in written)
    assert result.table.text and str(result.table) in result.table.text and "<table" in result.table.html
    assert np.asarray(result.figure).std() > 1


def test_results_are_those_of_the_commands(place, monkeypatch):
    pytest.importorskip("onnxruntime"), pytest.importorskip("pycocotools"), pytest.importorskip("onnx")
    from evaluation.detection.tiny_onnx import NAMES, write_red_finder

    monkeypatch.chdir(place)
    write_red_finder(place / "red.onnx", NAMES)
    report = gr.evaluate_detection("street", "red.onnx", intensities=(50,), seeds=2, frames=1, width=320, backend="cpu")
    words = "evaluate detection street --detector red.onnx --rain 50 --seeds 2 --frames 1 --width 320 --backend cpu"
    assert run([*words.split(), "--json", "told.json"]) == 0
    told = json.loads(Path("told.json").read_text())
    assert report.plain["rows"] == told["rows"] and report.plain["scores"] == told["scores"]


class InSpace:
    """A detector that finds the nearest car only, and matches by itself."""

    name = "in space"

    def confidences(self, image, frame):
        nearest = min(frame.truths, key=lambda each: each.distance_m)
        return {nearest.id: image[..., 0].mean() / 255}


def test_detectors_may_match_by_themselves(place, monkeypatch, tmp_path):
    pytest.importorskip("pycocotools")
    monkeypatch.chdir(place)
    report = gr.evaluate_detection("street", InSpace(), intensities=(50,), seeds=2, frames=1, width=320)
    by_object = {row.object: row.confidence for row in report.rows if row.picture == "rainy"}
    assert by_object["near"] > 0 and by_object["far"] == 0
    clear = report.plain["scores"][0]
    assert clear["map"]["mean"] is None and clear["iou"]["mean"] is None and clear["confidence"]["mean"] > 0
    assert "report.html" in report.save(tmp_path) and "NaN" not in (tmp_path / "detection.json").read_text()

    def points_ahead(sweep):
        return {"ahead": float(np.mean(sweep.points_m[:, 0] > sweep.origin_m[0]))}

    lidar = gr.evaluate_lidar("street", sensor="32", intensities=(0, 12), seeds=2, detector=points_ahead)
    assert [row[:2] for row in lidar.tables[-1].rows] == [(0, "ahead"), (12, "ahead")]
    assert len(lidar.plain["objects"]) == 4 and 0 < lidar.plain["objects"][0]["confidences"]["ahead"] <= 1


def test_cameras_shift_along_their_own_axes():
    camera = gr.home_camera(boxy_scene())
    right, ahead = (camera.camera_to_world[:3, k] for k in (0, 2))
    shifted = camera.shifted(right=1.5, ahead=2.0)
    np.testing.assert_allclose(shifted.position, camera.position + 1.5 * right + 2.0 * ahead)
    assert replace(shifted, world_to_camera=camera.world_to_camera).width == camera.width


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda: gr.evaluate_detection("street", 3), "detectors"),
        (lambda: gr.evaluate_detection("street", lambda image: image, seeds=0), "seeds"),
        (lambda: gr.evaluate_lidar("street", sensor="none"), "sensor"),
        (lambda: gr.publish(boxy_scene(), "page.txt"), "output"),
        (lambda: gr.evaluate_lidar("street", gr.Rain(glass="lens")), "^glass: a lidar"),
        (lambda: gr.export_rain(boxy_scene(), "rain.ply", gr.Rain(5, glass="lens")), "^glass: a file of Gaussians"),
        (lambda: gr.transfer("street", "out", method="magic"), "magic"),
        (lambda: gr.export_rain("pictures", "pictures/copy", gr.Rain(8)), "output"),
        (lambda: gr.sweep("no such sweep", "out"), "no such sweep"),
    ],
    ids=["detector", "seeds", "sensor", "page", "glass of a lidar", "glass of Gaussians", "method", "copy", "sweep"],
)
def test_bad_input_is_named(place, monkeypatch, call, names):
    monkeypatch.chdir(place)
    (place / "pictures").mkdir(exist_ok=True)
    Image.new("RGB", (32, 32)).save(place / "pictures" / "one.png")
    with pytest.raises(ValueError, match=names):
        call()
