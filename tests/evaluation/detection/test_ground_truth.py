"""Ground truth for detectors: from renders, from 3D boxes, from COCO files."""

import json

import numpy as np
import pytest

from gsrain_engine.datasets.capture import TrackedBox
from gsrain_engine.evaluation.detection.ground_truth import (
    LabeledObject,
    ground_truth_from_boxes,
    is_same_class,
    label_class,
    read_coco,
)
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.objects import COCO_CLASSES
from gsrain_engine.scene.scene import PoseTrack

AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera(200, 100, 100.0, 100.0, 100.0, 50.0, AHEAD)
"""1.5 m above the origin, looking along +x."""


def box(name, x, y, size=(2.0, 2.0, 1.5), class_name="Pedestrian"):
    where = PoseTrack(np.zeros(1), np.array([[x, y, 0.0]]), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))
    return TrackedBox(name, class_name, size, where)


def test_boxes_are_projected_and_named_as_in_coco():
    (found,) = ground_truth_from_boxes([box("a", 11, 0)], CAMERA, 0.0)
    assert (found.class_name, found.visibility) == ("person", 1.0)
    np.testing.assert_allclose(found.box_xyxy, (90, 50, 110, 65), atol=1e-3)
    assert found.distance_m == pytest.approx(np.hypot(11, 0.75))


def test_near_boxes_occlude_far_ones():
    found = ground_truth_from_boxes([box("behind", 21, -1), box("other", 21, 12), box("front", 11, 0)], CAMERA, 0.0)
    assert [each.id for each in found] == ["front", "behind", "other"]
    assert found[0].visibility == found[2].visibility == 1.0
    assert 0.0 <= found[1].visibility < 0.2


def test_boxes_outside_the_image_or_its_time_are_omitted():
    gone = box("gone", 11, 0)
    gone.track.valid[0] = False
    boxes = [box("edge", 11, 10), box("out", 11, 40), box("back", -9, 0), gone]
    (found,) = ground_truth_from_boxes(boxes, CAMERA, 0.0)
    assert (found.id, found.box_xyxy[0]) == ("edge", 0.0)


@pytest.mark.parametrize(
    ("height", "changes", "counts"),
    [(16, {}, True), (15, {}, False), (30, {"visibility": 0.2}, False), (30, {"is_ignored": True}, False)],
)
def test_small_and_occluded_objects_do_not_count(height, changes, counts):
    assert LabeledObject("a", "car", (0, 0, 30, height), **changes).counts == counts


OBJECT = {"id": 1, "image_id": 7, "category_id": 3, "bbox": [10, 20, 30, 40]}
COCO = {
    "images": [{"id": 7, "file_name": "a/one.jpg"}, {"id": 8, "file_name": "two.jpg"}],
    "categories": [{"id": 3, "name": "car"}],
    "annotations": [OBJECT, OBJECT | {"id": 2, "bbox": [0, 0, 5, 5], "iscrowd": 1, "distance_m": 9}],
}


def test_coco_files_are_read_by_image_names(tmp_path):
    file = tmp_path / "labels.json"
    file.write_text(json.dumps(COCO))
    crowd = LabeledObject("2", "car", (0.0, 0.0, 5.0, 5.0), distance_m=9.0, is_ignored=True)
    assert read_coco(file) == {
        "a/one.jpg": (LabeledObject("1", "car", (10.0, 20.0, 40.0, 60.0)), crowd),
        "two.jpg": (),
    }


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("no json", "COCO"),
        ("[]", "COCO"),
        (json.dumps({"images": []}), "'categories'"),
        (json.dumps(COCO | {"categories": []}), "refers to 3"),
        (json.dumps(COCO | {"images": []}), "refers to 7"),
        (json.dumps(COCO | {"annotations": [OBJECT | {"bbox": [1, 2]}]}), "COCO"),
        (None, "can't be read"),
    ],
)
def test_other_files_are_refused(tmp_path, text, names):
    if text is not None:
        (tmp_path / "bad.json").write_text(text)
    with pytest.raises(ValueError, match=f"bad.json: .*{names}"):
        read_coco(tmp_path / "bad.json")


# Classes


@pytest.mark.parametrize(
    ("detected", "labelled", "is_same"),
    [
        ("Car", "car", True), ("Pedestrian", "person", True), ("bus", "truck", False), ("sign", "stop sign", False),
        *((kind, "vehicle", True) for kind in ("car", "truck", "bus", "Van", "trailer", "vehicle")),
        ("vehicle", "truck", True), ("TYPE_VEHICLE", "bus", True),
        ("person", "vehicle", False), ("bicycle", "vehicle", False), ("vehicle", "person", False),
    ],
)  # fmt: skip
def test_vehicles_match_their_kinds(detected, labelled, is_same):
    assert is_same_class(detected, labelled) == is_same


def test_labels_of_data_sets_have_classes():
    for name, expected in {
        "TYPE_VEHICLE": "vehicle", "vehicle": "vehicle", "vehicle.car": "car", "vehicle.bus.rigid": "bus", "Van": "car",
        "Pedestrian": "person", "human.pedestrian.adult": "person", "Cyclist": "cyclist",
        "traffic_light": "traffic light", "movable_object.trafficcone": "trafficcone",
    }.items():  # fmt: skip
        assert label_class(name) == expected
    assert [label_class(name) for name in COCO_CLASSES] == list(COCO_CLASSES)


def test_coco_files_of_windows_name_the_same_pictures(tmp_path):
    document = {
        "categories": [{"id": 3, "name": "car"}],
        "images": [{"id": 1, "file_name": "train\\one.jpg"}],
        "annotations": [{"id": 1, "image_id": 1, "category_id": 3, "bbox": [1, 2, 3, 4]}],
    }
    file = tmp_path / "labels.json"
    file.write_text(json.dumps(document), encoding="utf-8-sig")
    ((name, (car,)),) = read_coco(file).items()
    assert (name, car.class_name, car.box_xyxy) == ("train/one.jpg", "car", (1, 2, 4, 6))


@pytest.mark.parametrize("document", [[], "text", {"images": {}}, {"categories": ["car"]}])
def test_what_a_coco_file_must_have_is_named(document, tmp_path):
    file = tmp_path / "labels.json"
    file.write_text(json.dumps(document))
    with pytest.raises(ValueError, match="labels.json: .*(categories|images)") as error:
        read_coco(file)
    assert "indices" not in str(error.value)
