"""`gsrain evaluate detection`, as a person types it."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from boxy_scene import boxy_scene
from colmap_files import write_binary, write_pictures
from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.evaluation.detection.detector import Detector
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.rig import rig_camera
from small_scene import small_scene

pytest.importorskip("onnxruntime")
pytest.importorskip("pycocotools")
onnx = pytest.importorskip("onnx")

from evaluation.detection.tiny_onnx import NAMES, write_red_finder  # noqa: E402


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A scene with a red car that fills most of a picture twice as wide as it is high."""
    folder = tmp_path_factory.mktemp("detection") / "red"
    scene = boxy_scene("red")
    front = replace(scene.rigs["one"][0], width=960, height=480, fx=3800.0, fy=3800.0, cx=480.0, cy=-60.0)
    write_scene(replace(scene, actors=scene.actors[:1], rigs={"one": (front,)}), folder)
    return folder


@pytest.fixture(scope="module")
def detector(tmp_path_factory):
    """Finds the whole picture as a car, as confidently as its middle is red."""
    return write_red_finder(tmp_path_factory.mktemp("detectors") / "red.onnx", NAMES)


def evaluate(project, detector, *options):
    words = ["evaluate", "detection", *([str(project)] if project else []), "--detector", str(detector)]
    return run([*words, "--width", "64", "--backend", "cpu", *options])


def test_rows_scores_figures_report_and_video(project, detector, tmp_path, capsys):
    out, numbers, video = tmp_path / "out", tmp_path / "numbers.json", tmp_path / "views.mp4"
    options = ("--rain", "0,50", "--seeds", "2", "--frames", "2", "-o", str(out), "--json", str(numbers))
    assert evaluate(project, detector, *options, "--video", str(video)) == 0
    said = capsys.readouterr().out
    assert "red" in said
    assert "rPC" not in said
    report = json.loads(numbers.read_text())
    rows = report["rows"]
    assert len(rows) == 2 * 2 * 2  # intensities, seeds, frames: one car
    assert {(row["intensity_mm_h"], row["seed"]) for row in rows} == {(0, 0), (0, 1), (50, 0), (50, 1)}
    clear = np.mean([row["confidence"] for row in rows if row["intensity_mm_h"] == 0])
    rainy = np.mean([row["confidence"] for row in rows if row["intensity_mm_h"] == 50])
    assert 0.5 < clear < 1
    assert rainy != pytest.approx(clear, abs=1e-4)  # drops before the car change its red
    assert all(row["iou"] > 0.5 and row["class"] == "car" and row["object"] == "near" for row in rows)
    assert report["settings"]["detectors"]["red"]["file"] == "red.onnx"
    scores = {each["intensity_mm_h"]: each for each in report["scores"]}
    assert scores[50]["change"]["mean"] == pytest.approx(rainy - clear)
    assert scores[0]["confidence"]["low"] == scores[0]["confidence"]["high"]
    with (out / "rows.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == len(rows)
    assert json.loads((out / "detection.json").read_text())["rows"] == rows
    for name in ("confidence.png", "iou.png", "precision.png", "view_0.png", "view_1.png"):
        assert np.asarray(Image.open(out / name)).shape[1] > 64
    page = (out / "report.html").read_text()
    settings = report["settings"]
    assert settings["seeds"] == [0, 1]
    assert settings["versions"]["gsrain"]
    hashes = [*settings["inputs"].values(), settings["detectors"]["red"]["sha256"]]
    assert all(each in page for each in (settings["command"], *hashes))
    assert page.count("data:image/png") == 3
    assert page.count("data:image/jpeg") == 2
    assert "Recall by distance" in page
    assert video.stat().st_size > 500


def test_a_sweep_that_was_stopped_goes_on_to_the_same_bytes(project, detector, tmp_path, monkeypatch, capsys):
    calls = 4
    options = ("--rain", "12", "--seeds", "3", "--frames", "2")
    assert evaluate(project, detector, *options, "-o", str(tmp_path / "whole")) == 0
    counted(monkeypatch, stop_after=calls)
    with pytest.raises(RuntimeError, match="pulled the plug"):
        evaluate(project, detector, *options, "-o", str(tmp_path / "stopped"))
    assert not (tmp_path / "stopped" / "rows.csv").exists()
    capsys.readouterr()
    asked = counted(monkeypatch)
    assert evaluate(project, detector, *options, "-o", str(tmp_path / "stopped")) == 0
    assert len(asked) == 2 * (1 + 3) - calls
    assert f"finished.jsonl: {calls} pictures judged before" in capsys.readouterr().out
    for name in ("rows.csv", "rows.parquet", "finished.jsonl", "confidence.png", "view_0.png", "view_1.png"):
        assert (tmp_path / "stopped" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def test_only_what_is_new_is_looked_at(project, detector, tmp_path, monkeypatch):
    base = ("--frames", "1", "-o", str(tmp_path))
    assert evaluate(project, detector, "--rain", "12", "--seeds", "1", *base) == 0
    asked = counted(monkeypatch)
    assert evaluate(project, detector, "--rain", "12,50", "--seeds", "2", *base) == 0
    assert len(asked) == 3  # 12 mm/h with seed 1, 50 mm/h with both
    rows = json.loads((tmp_path / "detection.json").read_text())["rows"]
    assert len(rows) == 6
    asked.clear()
    other = write_red_finder(tmp_path / "other.onnx", NAMES)
    assert evaluate(project, detector, "--rain", "12", "--seeds", "1", *base, "--detector", str(other)) == 0
    assert len(asked) == 2  # those of the other detector
    asked.clear()
    assert evaluate(project, detector, "--rain", "12", "--seeds", "1", *base, "--exposure", "0.05") == 0
    assert len(asked) == 2  # other pictures


DETECT = Detector.detect


def counted(monkeypatch, stop_after=None):
    """Count how often detectors are asked; after so many times somebody pulls the plug."""
    asked = []

    def detect(self, image):
        if len(asked) == stop_after:
            raise RuntimeError("pulled the plug")
        asked.append(self.name)
        return DETECT(self, image)

    monkeypatch.setattr(Detector, "detect", detect)
    return asked


def test_pictures_of_a_folder_are_rained_on_by_a_coco_file(detector, tmp_path, capsys):
    (tmp_path / "pictures").mkdir()
    red = np.zeros((32, 64, 3), np.uint8)
    red[:] = 200, 20, 20
    Image.fromarray(red).save(tmp_path / "pictures" / "one.png")
    truth = {
        "images": [{"id": 1, "file_name": "one.png"}],
        "categories": [{"id": 3, "name": "car"}],
        "annotations": [{"id": 1, "image_id": 1, "category_id": 3, "bbox": [0, 0, 64, 32]}],
    }
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    numbers = tmp_path / "numbers.json"
    options = ("--truth", str(tmp_path / "truth.json"), "--rain", "50", "--seeds", "2", "--json", str(numbers))
    assert evaluate(tmp_path / "pictures", detector, *options) == 0
    rows = json.loads(numbers.read_text())["rows"]
    kinds = {(row["picture"], row["intensity_mm_h"], row["seed"]) for row in rows}
    assert kinds == {("original", 0, 0), ("original", 0, 1), ("rainy", 50, 0), ("rainy", 50, 1)}
    assert rows[0]["confidence"] == pytest.approx(200 / 255, abs=0.01) or rows[0]["confidence"] > 0.2
    assert evaluate(tmp_path / "pictures", detector, "--rain", "50") == BAD_INPUT
    assert "--truth" in capsys.readouterr().err


def test_objects_of_many_classes_are_drawn_and_those_without_a_word_are_listed_apart(detector, tmp_path, capsys):
    (tmp_path / "pictures").mkdir()
    Image.fromarray(np.full((64, 128, 3), 90, np.uint8)).save(tmp_path / "pictures" / "one.png")
    names = ["car", "truck", "person", "vehicle", "sign"]
    truth = {
        "images": [{"id": 1, "file_name": "one.png"}],
        "categories": [{"id": number, "name": name} for number, name in enumerate(names)],
        "annotations": [
            {"id": number, "image_id": 1, "category_id": number, "bbox": [20 * number, 0, 20, 30]}
            for number in range(5)
        ],
    }
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    options = ("--truth", str(tmp_path / "truth.json"), "--rain", "8", "--seeds", "1", "-o", str(tmp_path / "out"))
    assert evaluate(tmp_path / "pictures", detector, *options) == 0
    assert "Not asked of red, which has no word for them: sign (1)." in capsys.readouterr().out
    numbers = json.loads((tmp_path / "out" / "detection.json").read_text())
    assert numbers["not_named"] == {"red": {"sign": 1}}
    assert {row["class"] for row in numbers["rows"]} == {"car", "truck", "person", "vehicle"}
    assert (tmp_path / "out" / "confidence.png").is_file()
    assert "no word for them: sign (1)" in (tmp_path / "out" / "report.html").read_text()
    truth["annotations"] = truth["annotations"][4:]
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    assert evaluate(tmp_path / "pictures", detector, *options) == BAD_INPUT
    assert "nothing there can be named: red has no word for sign (1)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("source", "words"),
    [("empty", "has no actors"), ("far", "an object of 16 px or more"), ("photos", "its unit of length is unknown")],
)
def test_a_source_without_anything_to_find_is_refused(detector, tmp_path, capsys, source, words):
    write_scene(small_scene(), tmp_path / "empty")
    write_scene(boxy_scene(), tmp_path / "far")
    write_binary(tmp_path / "photos" / "sparse" / "0")
    write_pictures(tmp_path / "photos")
    assert evaluate(tmp_path / source, detector, "--seeds", "1", "--rain", "0") == BAD_INPUT
    assert words in capsys.readouterr().err


def test_a_reconstruction_is_tried_beside_its_pictures(project, detector, tmp_path):
    scene = read_scene(project)
    camera = rig_camera(scene, "one", "FRONT", 0.0)
    pictures = np.zeros((480, 960, 3), np.uint8)
    pictures[:] = 120, 20, 20
    list(write_views(tmp_path / "taken", [CaptureFrame("first", camera, pictures)]))
    truth = {
        "images": [{"id": 1, "file_name": "first.png"}],
        "categories": [{"id": 3, "name": "car"}],
        "annotations": [{"id": 1, "image_id": 1, "category_id": 3, "bbox": [0, 0, 64, 32]}],
    }
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    numbers = tmp_path / "numbers.json"
    where = ("--capture", str(tmp_path / "taken"), "--truth", str(tmp_path / "truth.json"))
    assert evaluate(project, detector, *where, "--rain", "50", "--seeds", "1", "--json", str(numbers)) == 0
    report = json.loads(numbers.read_text())
    found = {row["picture"]: row["confidence"] for row in report["rows"]}
    assert list(found) == ["original", "clear", "rainy"]
    assert found["clear"] > found["original"] > 0.1  # the scene's car is a brighter red than the picture
    changes = {each["picture"]: each["change"] for each in report["scores"]}
    assert changes["original"] is None
    assert changes["rainy"]["mean"] == pytest.approx(found["rainy"] - found["clear"])
