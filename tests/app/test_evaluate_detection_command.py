"""`gsrain evaluate detection` with a detector that finds the whole picture as a car, as surely as its middle is red."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from boxy_scene import boxy_scene
from colmap_files import write_binary, write_pictures
from gsrain_engine.evaluation.detection.detector import Detector
from gsrain_engine.scene.formats.scene_files import write_scene
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
    return write_red_finder(tmp_path_factory.mktemp("detectors") / "red.onnx", NAMES)


def words(source, detector, *options):
    command = ["evaluate", "detection", str(source), "--detector", str(detector), "--width", "64", "--backend", "cpu"]
    return [*command, *map(str, options)]


def write_truth(file, picture, classes, boxes):
    annotations = [
        {"id": number, "image_id": 1, "category_id": category, "bbox": box}
        for number, (category, box) in enumerate(boxes)
    ]
    categories = [{"id": number, "name": name} for number, name in classes.items()]
    images = [{"id": 1, "file_name": picture}]
    file.write_text(json.dumps({"images": images, "categories": categories, "annotations": annotations}))
    return file


def test_rows_scores_figures_report_and_video(project, detector, tmp_path, reported, capsys):
    out, video = tmp_path / "out", tmp_path / "views.mp4"
    options = ("--rain", "0,50", "--seeds", "2", "--frames", "2", "-o", out, "--video", video)
    report = reported(*words(project, detector, *options))
    printed = capsys.readouterr().out
    assert "red" in printed and "rPC" not in printed
    rows = report["rows"]
    assert sorted((row["intensity_mm_h"], row["seed"]) for row in rows) == [
        (mm_h, seed) for mm_h in (0, 50) for seed in (0, 1) for _ in range(2)]  # fmt: skip
    clear, rainy = (np.mean([row["confidence"] for row in rows if row["intensity_mm_h"] == rain]) for rain in (0, 50))
    assert 0.5 < clear < 1
    assert rainy != pytest.approx(clear, abs=1e-4)  # drops before the car change its red
    assert all(row["iou"] > 0.5 and row["class"] == "car" and row["object"] == "near" for row in rows)
    scores = {each["intensity_mm_h"]: each for each in report["scores"]}
    assert scores[50]["change"]["mean"] == pytest.approx(rainy - clear)
    assert scores[0]["confidence"]["low"] == scores[0]["confidence"]["high"]
    with (out / "rows.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == len(rows)
    assert json.loads((out / "detection.json").read_text()) == report
    pictures = ("view_0.png", "view_1.png", "truth_0.png", "truth_1.png")
    for name in ("confidence.png", "iou.png", "precision.png", *pictures):
        assert np.asarray(Image.open(out / name)).shape[1] >= 64
    page, settings = (out / "report.html").read_text(), report["settings"]
    assert settings["seeds"] == [0, 1] and settings["versions"]["gsrain"]
    assert settings["detectors"]["red"]["file"] == "red.onnx"
    hashes = [*settings["inputs"].values(), settings["detectors"]["red"]["sha256"]]
    assert all(each in page for each in (settings["command"], *hashes, "Recall by distance"))
    assert (page.count("data:image/png"), page.count("data:image/jpeg")) == (3, 2)
    assert video.stat().st_size > 500


DETECT = Detector.detect


def counted(monkeypatch, stop_after=None):
    """Count how often detectors are asked; after so many times the run ends with an error."""
    asked = []

    def detect(self, image):
        if len(asked) == stop_after:
            raise RuntimeError("stopped")
        asked.append(self.name)
        return DETECT(self, image)

    monkeypatch.setattr(Detector, "detect", detect)
    return asked


def test_a_stopped_sweep_resumes_to_the_same_bytes_and_only_new_views_are_evaluated(
    project, detector, tmp_path, monkeypatch, capsys
):
    def evaluate(folder, *options, seeds=3, rain="12"):
        base = ("--frames", "2", "--seeds", seeds, "--rain", rain, "-o", tmp_path / folder)
        return run(words(project, detector, *base, *options))

    assert evaluate("whole") == 0
    counted(monkeypatch, stop_after=4)
    with pytest.raises(RuntimeError, match="stopped"):
        evaluate("stopped")
    assert not (tmp_path / "stopped" / "rows.csv").exists()
    asked = counted(monkeypatch)
    assert evaluate("stopped") == 0
    assert len(asked) == 2 * (1 + 3) - 4
    for name in ("rows.csv", "rows.parquet", "finished.jsonl", "confidence.png", "view_0.png", "truth_1.png"):
        assert (tmp_path / "stopped" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
    asked.clear()
    assert evaluate("whole", seeds=4, rain="12,50") == 0
    assert len(asked) == 2 * (1 + 4)  # 12 mm/h with seed 3, 50 mm/h with all
    asked.clear()
    assert evaluate("whole", "--detector", write_red_finder(tmp_path / "other.onnx", NAMES)) == 0
    assert len(asked) == 2 * (1 + 3)  # those of the other detector


def test_the_rain_is_taken_apart_and_drop_sizes_are_compared(
    project, detector, tmp_path, reported, monkeypatch, capsys
):
    out = tmp_path / "out"
    options = ("--rain", "50", "--seeds", "2", "--frames", "1", "--attribute=all", "--diameter-scale", "1,2", "-o", out)
    asked = counted(monkeypatch)
    report = reported(*words(project, detector, *options))
    assert len(asked) == 1 + 2 + (1 + 2 * 2) + 2  # clear, rainy; no factor, each of two with two seeds; larger drops
    printed = capsys.readouterr().out
    assert "whole effect" in printed and "diameters x" in printed
    scores = {each["intensity_mm_h"]: each["confidence"]["mean"] for each in report["scores"]}
    confidence, recall, near = report["attribution"]
    assert (confidence["measure"], recall["measure"], near["object"]) == ("confidence", "recall", "near (car)")
    assert [each["factor"] for each in confidence["shares"]] == ["streaks", "medium"]
    assert sum(each["mean"] for each in confidence["shares"]) == pytest.approx(scores[50] - scores[0], abs=1e-12)
    assert sum(each["part_of_whole"] for each in confidence["shares"]) == pytest.approx(1)
    assert (confidence["coalitions"], confidence["seeds"]) == (4, [0, 1])
    assert [each["diameter_scale"] for each in report["drop_sizes"]] == [1, 2]
    for name in ("attribution.png", "attribution_steps.png", "drop_sizes.png"):
        assert np.asarray(Image.open(out / name)).shape[1] > 64
    with (out / "attribution.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == 3 * 2 * 2  # measures, seeds, factors
    assert "Shares of the factors" in (out / "report.html").read_text()
    before = {name: (out / name).read_bytes() for name in ("attribution.csv", "attribution.png", "finished.jsonl")}
    asked.clear()
    reported(*words(project, detector, *options))
    assert not asked and {name: (out / name).read_bytes() for name in before} == before
    command = words(project, detector, "--rain", "50", "--seeds", "1", "--frames", "1", "--attribute", "wet")
    assert run(command) == BAD_INPUT and "--attribute wet: " in capsys.readouterr().err  # it has no wet colors


def test_pictures_of_a_folder_by_a_coco_file(detector, tmp_path, reported, capsys):
    (tmp_path / "pictures").mkdir()
    Image.fromarray(np.full((32, 64, 3), (200, 20, 20), np.uint8)).save(tmp_path / "pictures" / "one.png")
    boxes = [(number, [10 * number, 0, 10, 30]) for number in range(5)]
    classes = dict(enumerate(["car", "truck", "person", "vehicle", "sign"]))
    truth = write_truth(tmp_path / "truth.json", "one.png", classes, boxes)
    command = words(tmp_path / "pictures", detector, "--rain", "50", "--seeds", "2")
    blue = write_red_finder(tmp_path / "blue.onnx", NAMES)
    blue.with_suffix(".yaml").write_text("decode: end_to_end\nchannels: bgr\n")
    report = reported(*command, "--detector", blue, "--truth", truth, "-o", tmp_path / "out")
    printed, page = capsys.readouterr().out, (tmp_path / "out" / "report.html").read_text()
    assert report["finds_nothing"] == ["blue"]
    (warning,) = (line for line in " ".join(printed.split()).split("Warning: ")[1:])
    assert all(word in warning for word in ("blue", "channels", "scale", "fit", "padding")) and "blue finds" in page
    kinds = {(row["picture"], row["intensity_mm_h"], row["seed"]) for row in report["rows"]}
    assert kinds == {("original", 0, 0), ("original", 0, 1), ("rainy", 50, 0), ("rainy", 50, 1)}
    assert {row["class"] for row in report["rows"]} == {"car", "truck", "person", "vehicle"}
    assert report["not_named"] == {"red": {"sign": 1}, "blue": {"sign": 1}}
    assert "sign (1)" in printed and "sign (1)" in page
    assert run(command) == BAD_INPUT
    assert "--truth" in capsys.readouterr().err
    assert run([*command, "--truth", str(write_truth(truth, "one.png", classes, boxes[4:]))]) == BAD_INPUT
    assert "red has no word for sign (1)" in capsys.readouterr().err


@pytest.mark.street
def test_all_missing_files_are_named_before_any_work(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["evaluate", "detection", "street", "--detector", "a.onnx", "--detector", "b.onnx", "--capture", "drive"]
    assert run([*command, "--truth", "coco.json", "-o", "out"]) == BAD_INPUT
    first, *lines = capsys.readouterr().err.strip().splitlines()
    assert first == "gsrain: 4 inputs are missing or do not fit:"
    beginnings = ("  --detector a.onnx", "  --detector b.onnx", "  --truth coco.json", "  drive: no such")
    assert all(line.startswith(each) for line, each in zip(lines, beginnings, strict=True))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("source", "error"),
    [("empty", "has no actors"), ("far", "an object of 16 px or more"), ("photos", "its unit of length is unknown")],
)
def test_a_source_without_anything_to_find_is_refused(detector, tmp_path, capsys, source, error):
    write_scene(small_scene(), tmp_path / "empty")
    write_scene(boxy_scene(), tmp_path / "far")
    write_binary(tmp_path / "photos" / "sparse" / "0")
    write_pictures(tmp_path / "photos")
    assert run(words(tmp_path / source, detector, "--seeds", "1", "--rain", "0")) == BAD_INPUT
    assert error in capsys.readouterr().err
