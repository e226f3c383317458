"""Published detectors on real pictures and on the street: what they find is known."""

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("onnxruntime")

from gsrain_engine.evaluation.detection.detector import Detection, open_detector
from gsrain_engine.evaluation.detection.metrics import match_detections
from gsrain_engine.rain.simulation import OVERCAST as SKY
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.draw import draw
from gsrain_engine.render.frame_input import FrameInput
from gsrain_engine.render.view import RenderView
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.open import load_built_in

INT8 = 0.06
"""Confidences of whole-number weights differ so much between processors."""
CARS = [(3, 188, 217, 515), (279, 296, 446, 399), (507, 280, 635, 390), (684, 301, 792, 366)]
"""In the clear frame of img2img-turbo."""
RAIN_CAR, RAIN_PERSON = (1154, 553, 1544, 841), (855, 542, 927, 729)
"""In RainSense's torrential frame; the person is labelled there."""


def _found(test_data: Path, name: str, picture: Path, class_name: str) -> list[Detection]:
    path = test_data / "detectors" / f"{name}.onnx"
    if not path.is_file():
        pytest.skip(f"no detector at {path}")
    detector, image = open_detector(path), np.ascontiguousarray(cv2.imread(str(picture))[..., ::-1])
    found = detector.detect(image)
    assert found == open_detector(path).detect(image)
    return [each for each in found if each.class_name == class_name]


def _labels(class_name: str, *boxes: tuple[int, ...]) -> list[Detection]:
    return [Detection(class_name, 1.0, tuple(map(float, box))) for box in boxes]


def test_cars_in_clear_weather_and_transferred_to_rain(test_data: Path):
    folder, labels = test_data / "weather/img2img_turbo", _labels("car", *CARS)
    clear, rainy = (
        match_detections(labels, _found(test_data, "yolo26n_int8", folder / f"clear2rainy_{name}.png", "car"))
        for name in ("input", "output")
    )
    assert [each.confidence for each in clear] == pytest.approx([0.89, 0.81, 0.58, 0.48], abs=INT8)
    assert all(match.iou > 0.9 for match in clear)
    assert [each.confidence for each in rainy[:3]] == pytest.approx([0.86, 0.61, 0.53], abs=INT8)
    assert rainy[3].confidence < 0.25  # one lost
    found = match_detections(labels, _found(test_data, "yolox_nano", folder / "clear2rainy_input.png", "car"))
    assert all(match.confidence > 0.5 and match.iou > 0.6 for match in found)


@pytest.mark.parametrize(("name", "confidence"), [("yolo26n_int8", 0.91), ("yolox_nano", 0.88)])
def test_car_and_person_in_torrential_rain(test_data: Path, name: str, confidence: float):
    picture = sorted((test_data / "weather/rainsense/torriential_rain").rglob("image_000.jpg"))[0]
    (car,) = match_detections(_labels("car", RAIN_CAR), _found(test_data, name, picture, "car"))
    assert car.confidence == pytest.approx(confidence, abs=INT8) and car.iou > 0.9
    people = _found(test_data, name, picture, "person")
    assert sum(each.confidence > 0.5 for each in people) == 2
    (person,) = match_detections(_labels("person", RAIN_PERSON), people)
    assert person.confidence > 0.6 and person.iou > 0.75


VIEWS = {
    "bus": ((33.0, -1.5, 1.6), (44.0, 3.0, 1.5)),
    "bicycle": ((36.0, -1.7, 1.6), (41.2, -5.3, 0.9)),
    "person": ((31.0, -3.0, 1.6), (35.0, -6.8, 0.9)),
    "traffic light": ((23.0, -1.7, 1.6), (32.3, -2.5, 5.0)),
    "stop sign": ((138.0, -2.5, 1.6), (147.6, -5.9, 2.0)),
}
"""Places of the street from which something is visible, and it."""


@pytest.mark.parametrize("name", ["yolo26n_int8", "yolox_nano"])
def test_detectors_know_what_is_on_the_street(test_data: Path, name: str) -> None:
    path, street, missed = test_data / "detectors" / f"{name}.onnx", load_built_in(), list[str]()
    if not path.is_file():
        pytest.skip(f"no detector at {path}")
    detector, renderer = open_detector(path), CpuRenderer()
    for class_name, (eye, target) in VIEWS.items():
        ahead = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
        right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.stack([right, np.cross(ahead, right), ahead], axis=1), eye
        camera = Camera(640, 480, 1000.0, 1000.0, 320.0, 240.0, np.linalg.inv(pose))
        draw(renderer, FrameInput.of(street, None, SKY, RenderView(camera, 0.0)))
        found = detector.detect(renderer.read_uint8())
        best = max((each.confidence for each in found if each.class_name == class_name), default=0.0)
        missed += [] if best > 0.45 else [f"{class_name} {best:.2f}"]
    assert not missed
