from pathlib import Path

import pytest

from gsrain_engine.evaluation.detection.description import description_names, load_description
from gsrain_engine.scene.objects import COCO_CLASSES, coco_class


def test_every_shipped_description_is_one():
    assert {"yolo_end_to_end", "yolo11", "yolox", "nanodet"} <= set(description_names())
    for name in description_names():
        description = load_description(name)
        assert description.scale in (1, pytest.approx(1 / 255))
    assert load_description("yolox").channels == "bgr"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("decode: yolo\nsize: 3", "unknown field `size`"),
        ("decode: retina", r"'retina' is none of end_to_end, .*nanodet - at `\$.decode`"),
        ("classes: coco", "missing required field `decode`"),
        ("decode: yolo\npadding: 300", r"<= 255 - at `\$.padding`"),
        ("decode: yolo\ndeviation: [1, 0, 1]", r"> 0.0 - at `\$.deviation"),
        ("decode: yolo\ninput_size_px: [640]", r"\$.input_size_px"),
        ("decode: yolo\nclasses: voc", r"\$.classes"),
    ],
)
def test_a_field_that_is_wrong_is_named(text: str, problem: str, tmp_path: Path):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"mine.yaml: .*{problem}"):
        load_description(path)


def test_errors_about_unknown_names_list_the_known_ones():
    with pytest.raises(ValueError, match="yolov99: no such file.*nanodet, .*yolox"):
        load_description("yolov99")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Pedestrian", "person"),
        ("human.pedestrian.adult", "person"),
        ("vehicle.bus.rigid", "bus"),
        ("TYPE_VEHICLE", "car"),
        ("Van", "car"),
        ("traffic_light", "traffic light"),
        ("movable_object.trafficcone", "trafficcone"),
        ("Cyclist", "cyclist"),
    ],
)
def test_data_sets_names_become_cocos(name: str, expected: str):
    assert coco_class(name) == expected


def test_cocos_names_stay():
    assert len(set(COCO_CLASSES)) == 80
    assert [coco_class(name) for name in COCO_CLASSES] == list(COCO_CLASSES)
    assert (COCO_CLASSES[2], COCO_CLASSES[7], COCO_CLASSES[79]) == ("car", "truck", "toothbrush")
