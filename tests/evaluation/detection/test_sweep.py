"""Detectors over views, rains and seeds."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from boxy_scene import boxy_scene
from gsrain_engine.appearance.scene_views import PlacedCamera
from gsrain_engine.datasets.capture import Capture, CaptureFrame, TrackedBox
from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.ground_truth import LabeledObject, is_same_class, label_class
from gsrain_engine.evaluation.detection.run import (
    Condition,
    ConditionRenderer,
    EvaluatedFrame,
    conditions_of,
    evaluate_detections,
    evaluate_images,
    object_rows,
    recorded_frames,
    render_view_of,
    scene_frames,
)
from gsrain_engine.evaluation.detection.summary import scores
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import RenderView
from gsrain_engine.render.sky_color import SkyColor
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import PoseTrack, Scene
from small_scene import small_scene

SKY = SkyColor((0.8, 0.8, 0.8), True)
SEEDS = (0, 1)
AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
"""World to camera of one 1.5 m above the origin that looks along +x."""


@dataclass
class Believer:
    """Finds each truth of a view as exactly the object that it is, as confidently as the picture is dark."""

    truths: tuple[LabeledObject, ...]
    name: str = "believer"
    classes: tuple[str, ...] = ()

    def detect(self, image):
        confidence = 1 - float(image.mean()) / 255
        return [Detection(each.class_name, confidence, each.box_xyxy) for each in self.truths]


@pytest.fixture(scope="module")
def frame():
    scene = boxy_scene()
    camera = rig_camera(scene, "one", "FRONT", 0.0).resized(144, 96)
    return scene_frames(CpuRenderer(), scene, [PlacedCamera("first", camera)])[0]


@pytest.fixture(scope="module")
def pictures():
    return ConditionRenderer(CpuRenderer(), boxy_scene(), RainSettings(), SKY)


def test_every_rain_has_every_seed_and_what_is_clear_stands_for_all():
    trials = conditions_of((0.0, 1.2, 8.5), SEEDS, originals=True, scene=True)
    assert trials[:2] == [Condition("original", 0.0, SEEDS), Condition("clear", 0.0, SEEDS)]
    assert trials[2:] == [Condition("rainy", rate, (seed,)) for rate in (1.2, 8.5) for seed in SEEDS]
    assert conditions_of((8.5,), (0,), originals=True, scene=False)[0].kind == "original"


def test_rows_pair_seeds_across_intensities(pictures, frame):
    trials = conditions_of((12.0,), SEEDS, originals=False, scene=True)
    shown = list(evaluate_images(pictures, [Believer(frame.truths)], [frame], trials))
    rows = [row for each in shown for row in object_rows(each.judgements["believer"])]
    keys = {(row.intensity_mm_h, row.seed, row.object) for row in rows}
    asked = [each.id for each in frame.truths if each.counts]
    assert keys == {(rate, seed, name) for rate in (0.0, 12.0) for seed in SEEDS for name in asked}
    assert len(rows) == len(keys) == 4 * len(asked) >= 4
    assert all(row.iou == pytest.approx(1.0) for row in rows)
    clear = [row.confidence for row in rows if row.intensity_mm_h == 0]
    assert len(set(clear)) == 1
    assert len({row.confidence for row in rows if row.intensity_mm_h == 12}) == 2  # two seeds, two pictures
    line = rows[0].plain()
    wanted = {"detector", "intensity_mm_h", "seed", "frame", "object", "class", "confidence", "iou"}
    assert wanted <= line.keys()
    assert line["class"] == "car"


def test_pictures_are_the_same_every_time_and_wetter_with_the_rain(pictures, frame):
    rainy = Condition("rainy", 50.0, (3,))
    first, again = pictures.take(frame, rainy), pictures.take(frame, rainy)
    np.testing.assert_array_equal(first, again)
    clear = pictures.take(frame, Condition("clear", 0.0, SEEDS)).astype(int)
    light = pictures.take(frame, Condition("rainy", 1.2, (3,))).astype(int)
    assert 0 < np.abs(light - clear).mean() < np.abs(first - clear).mean()


def test_rain_falls_in_front_of_a_taken_picture():
    background = np.full((48, 64, 3), 40, np.uint8)
    camera = Camera(64, 48, 60.0, 60.0, 32.0, 24.0, AHEAD)
    frame = EvaluatedFrame("taken", RenderView(camera), (), lambda: background)
    pictures = ConditionRenderer(CpuRenderer(), Scene("nothing"), RainSettings(), SKY, is_in_front=True)
    np.testing.assert_array_equal(pictures.take(frame, Condition("original", 0.0, (0,))), background)
    rainy = pictures.take(frame, Condition("rainy", 100.0, (0,))).astype(int)
    assert (rainy >= 39).all()  # drops are brighter than this
    assert rainy.mean() > 40.5
    assert rainy.max() < 0.8 * 255 + 1


def test_a_camera_that_rides_along_has_the_vehicles_speed():
    scene = small_scene()
    camera = rig_camera(scene, "one", "FRONT", 1.5)
    np.testing.assert_allclose(render_view_of(scene, PlacedCamera("a", camera, 1.5)).velocity_m_s, [2, 0, 0], atol=1e-6)
    np.testing.assert_array_equal(render_view_of(Scene("none"), PlacedCamera("a", camera)).velocity_m_s, np.zeros(3))


def test_recorded_views_have_their_pictures_and_what_is_in_them():
    camera = Camera(80, 40, 40.0, 40.0, 40.0, 20.0, AHEAD)
    image = np.full((40, 80, 3), 90, np.uint8)
    where = PoseTrack(np.zeros(1), np.array([[5.0, 0, 0]]), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))
    box = TrackedBox("a", "Car", (2.0, 2.0, 1.5), where)
    capture = Capture("drive", (CaptureFrame("front/000.jpg", camera, image),), boxes=(box,))
    placed = [PlacedCamera("front/000.jpg", camera).at_width(40)]
    (frame,) = recorded_frames(Scene("world"), placed, capture)
    assert frame.original().shape == (20, 40, 3)
    assert [each.id for each in frame.truths] == ["a"]
    np.testing.assert_allclose(frame.truths[0].box_xyxy, (15, 10, 25, 17.5), atol=1e-3)
    labels = {"000.jpg": (LabeledObject("b", "bus", (0, 0, 9, 9)),), "001.jpg": ()}
    (other,) = recorded_frames(Scene("world"), placed, capture, labels)
    assert [each.id for each in other.truths] == ["b"]
    with pytest.raises(ValueError, match="no 3D boxes"):
        recorded_frames(Scene("world"), placed, replace(capture, boxes=()))


def detection(box, name="car", confidence=0.9):
    return Detection(name, confidence, box)


def test_finding_what_is_not_asked_for_is_no_mistake():
    large = LabeledObject("large", "car", (0.0, 0.0, 40.0, 40.0))
    small = LabeledObject("small", "car", (60.0, 0.0, 70.0, 10.0))
    frame = EvaluatedFrame("f", RenderView(Camera(100, 100, 50.0, 50.0, 50.0, 50.0)), (large, small))
    on_large, on_small, wrong = detection(large.box_xyxy), detection(small.box_xyxy), detection((60, 60, 90, 90))
    found = evaluate_detections("d", frame, Condition("clear", 0.0, (0,)), [on_large, on_small, wrong])
    assert found.truths == (large,)
    assert found.detections == (on_large, wrong)
    assert found.matches[0].confidence == 0.9


def test_misses_and_flips_are_rows_too():
    car = LabeledObject("a", "car", (0.0, 0.0, 40.0, 40.0))
    frame = EvaluatedFrame("f", RenderView(Camera(100, 100, 50.0, 50.0, 50.0, 50.0)), (car,))
    (flipped,) = object_rows(
        evaluate_detections("d", frame, Condition("clear", 0.0, (0,)), [detection(car.box_xyxy, "truck", 0.7)])
    )
    assert (flipped.confidence, flipped.iou, flipped.class_seen) == (0.0, 0.0, "truck")
    assert (flipped.confidence_any_class, flipped.iou_any_class) == (0.7, 1.0)
    (missed,) = object_rows(evaluate_detections("d", frame, Condition("clear", 0.0, (0,)), []))
    assert (missed.confidence, missed.class_seen) == (0.0, None)


SIGN, CAR, WAYMO = (
    LabeledObject("s", "sign", (0.0, 0.0, 20.0, 40.0)),
    LabeledObject("c", "car", (100.0, 0.0, 140.0, 40.0)),
    LabeledObject("v", "vehicle", (200.0, 0.0, 240.0, 40.0)),
)


@pytest.mark.parametrize(
    ("detected", "labelled", "right"),
    [
        ("car", "car", True), ("Car", "car", True), ("Pedestrian", "person", True), ("bus", "truck", False),
        ("car", "vehicle", True), ("truck", "vehicle", True), ("bus", "vehicle", True), ("Van", "vehicle", True),
        ("trailer", "vehicle", True), ("vehicle", "vehicle", True), ("vehicle", "truck", True),
        ("person", "vehicle", False), ("bicycle", "vehicle", False), ("vehicle", "person", False),
        ("TYPE_VEHICLE", "bus", True), ("sign", "stop sign", False),
    ],
)  # fmt: skip
def test_words_of_a_detector_name_classes_of_labels(detected, labelled, right):
    assert is_same_class(detected, labelled) == right


def test_labels_of_data_sets_fall_into_classes():
    names = ["TYPE_VEHICLE", "vehicle", "vehicle.car", "vehicle.bus.rigid", "Van", "human.pedestrian.adult", "Cyclist"]
    assert [label_class(each) for each in names] == ["vehicle", "vehicle", "car", "bus", "car", "person", "cyclist"]


def test_what_a_detector_has_no_word_for_is_listed_apart():
    frame = EvaluatedFrame("f", RenderView(Camera(300, 100, 50.0, 50.0, 150.0, 50.0)), (SIGN, CAR, WAYMO))
    seen = [
        Detection("truck", 0.9, WAYMO.box_xyxy), Detection("car", 0.8, CAR.box_xyxy),
        Detection("person", 0.7, SIGN.box_xyxy),
    ]  # fmt: skip
    trial = Condition("clear", 0.0, (0,))
    found = evaluate_detections("d", frame, trial, seen, ("person", "car", "truck"))
    assert found.truths == (CAR, WAYMO) and found.not_named == (SIGN,)
    assert [each.confidence for each in found.matches] == [0.8, 0.9]
    assert [each.flipped_to for each in found.matches] == [None, None]
    assert [each.class_name for each in found.detections] == ["truck", "car"]  # nobody is wrong about the sign
    assert {row.class_name for row in object_rows(found)} == {"car", "vehicle"}
    (score,) = scores(list(object_rows(found)), [found])
    assert (score.recall.mean, score.flips.mean, score.map50.mean) == (1.0, 0.0, pytest.approx(1.0))
    everything = evaluate_detections("d", frame, trial, seen)
    assert everything.not_named == () and len(everything.truths) == 3
