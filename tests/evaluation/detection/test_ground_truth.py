"""Ground truth for detectors: from renders, from 3D boxes, from COCO files."""

import json

import numpy as np
import pytest

from boxy_scene import boxy_scene
from gsrain_engine.datasets.capture import TrackedBox
from gsrain_engine.evaluation.detection.ground_truth import (
    LabeledObject,
    ground_truth_from_boxes,
    ground_truth_from_scene,
    is_same_class,
    label_class,
    read_coco,
)
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.objects import COCO_CLASSES, scene_objects
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import PoseTrack

AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera(200, 100, 100.0, 100.0, 100.0, 50.0, AHEAD)
"""1.5 m above the origin, looking along +x."""


def box(name, x, y, size=(2.0, 2.0, 1.5), class_name="Pedestrian"):
    where = PoseTrack(np.zeros(1), np.array([[x, y, 0.0]]), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))
    return TrackedBox(name, class_name, size, where)


def test_boxes_are_projected_and_named_as_coco_does():
    (found,) = ground_truth_from_boxes([box("a", 11, 0)], CAMERA, 0.0)
    assert found.class_name == "person"
    np.testing.assert_allclose(found.box_xyxy, (90, 50, 110, 65), atol=1e-3)
    assert found.distance_m == pytest.approx(np.hypot(11, 0.75))
    assert found.visibility == 1.0


def test_nearer_boxes_hide_farther_ones():
    behind, beside = box("behind", 21, -1.0), box("beside", 21, 12.0)
    found = ground_truth_from_boxes([behind, beside, box("front", 11, 0)], CAMERA, 0.0)
    assert [each.id for each in found] == ["front", "behind", "beside"]
    assert found[0].visibility == found[2].visibility == 1.0
    assert 0.0 <= found[1].visibility < 0.2
    assert not found[1].counts


def test_what_is_cut_off_or_gone_is_cut_off_or_gone():
    (found,) = ground_truth_from_boxes([box("edge", 11, 10), box("out", 11, 40), box("back", -9, 0)], CAMERA, 0.0)
    assert (found.id, found.box_xyxy[0]) == ("edge", 0.0)
    gone = box("gone", 11, 0)
    gone.track.valid[0] = False
    assert ground_truth_from_boxes([gone], CAMERA, 0.0) == ()


@pytest.mark.parametrize(
    ("height", "changes", "counts"),
    [(16, {}, True), (15, {}, False), (30, {"visibility": 0.2}, False), (30, {"is_ignored": True}, False)],
)
def test_small_and_hidden_objects_are_not_asked_for(height, changes, counts):
    assert LabeledObject("a", "car", (0, 0, 30, height), **changes).counts == counts


def test_a_scene_shows_its_actors_under_cocos_names():
    scene = boxy_scene()
    camera = rig_camera(scene, "one", "FRONT", 0.0).resized(288, 192)
    found = ground_truth_from_scene(CpuRenderer(), scene, scene_objects(scene), camera, 0.0)
    assert [(each.id, each.class_name) for each in found] == [("near", "car"), ("far", "car")]
    assert found[1].visibility == pytest.approx(0.5, abs=0.1)


def document(**changes):
    values = {
        "images": [{"id": 7, "file_name": "a/one.jpg"}, {"id": 8, "file_name": "two.jpg"}],
        "categories": [{"id": 3, "name": "car"}],
        "annotations": [
            {"id": 1, "image_id": 7, "category_id": 3, "bbox": [10, 20, 30, 40]},
            {"id": 2, "image_id": 7, "category_id": 3, "bbox": [0, 0, 5, 5], "iscrowd": 1, "distance_m": 9},
        ],
    }
    return values | changes


def test_coco_files_are_read_by_the_names_of_pictures(tmp_path):
    file = tmp_path / "labels.json"
    file.write_text(json.dumps(document()))
    labels = read_coco(file)
    assert labels["two.jpg"] == ()
    first, crowd = labels["a/one.jpg"]
    assert first == LabeledObject("1", "car", (10.0, 20.0, 40.0, 60.0))
    assert (crowd.is_ignored, crowd.distance_m) == (True, 9.0)


def annotation(box):
    return [{"id": 1, "image_id": 7, "category_id": 3, "bbox": box}]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("no json", "COCO"),
        ("[]", "COCO"),
        (json.dumps({"images": []}), "'categories'"),
        (json.dumps(document(categories=[])), "refers to 3"),
        (json.dumps(document(images=[])), "refers to 7"),
        (json.dumps(document(annotations=annotation([1, 2]))), "COCO"),
        (None, "can't be read"),
    ],
)
def test_files_that_are_no_coco_are_named(tmp_path, text, names):
    if text is not None:
        (tmp_path / "bad.json").write_text(text)
    with pytest.raises(ValueError, match=f"bad.json: .*{names}"):
        read_coco(tmp_path / "bad.json")


# Classes


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
    for name, expected in {
        "TYPE_VEHICLE": "vehicle", "vehicle": "vehicle", "vehicle.car": "car", "vehicle.bus.rigid": "bus", "Van": "car",
        "Pedestrian": "person", "human.pedestrian.adult": "person", "Cyclist": "cyclist",
        "traffic_light": "traffic light", "movable_object.trafficcone": "trafficcone",
    }.items():  # fmt: skip
        assert label_class(name) == expected
    assert len(set(COCO_CLASSES)) == 80 and [label_class(name) for name in COCO_CLASSES] == list(COCO_CLASSES)
    assert (COCO_CLASSES[2], COCO_CLASSES[7], COCO_CLASSES[79]) == ("car", "truck", "toothbrush")
