"""Published detectors on real pictures: what they find is known."""

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("onnxruntime")

from gsrain_engine.evaluation.detection.detector import Detection, Detector, open_detector
from gsrain_engine.evaluation.detection.metrics import match_detections

INT8 = 0.06
"""Confidences of whole-number weights differ so much between processors."""
CARS = [(3, 188, 217, 515), (279, 296, 446, 399), (507, 280, 635, 390), (684, 301, 792, 366)]
"""In the clear frame of img2img-turbo."""
RAIN_CAR, RAIN_PERSON = (1154, 553, 1544, 841), (855, 542, 927, 729)
"""In RainSense's torrential frame; the person is labelled there."""


def _opened(test_data: Path, name: str) -> Detector:
    path = test_data / "detectors" / f"{name}.onnx"
    if not path.is_file():
        pytest.skip(f"no detector at {path}")
    return open_detector(path)


def _seen(detector: Detector, picture: Path, class_name: str) -> list[Detection]:
    image = cv2.cvtColor(cv2.imread(str(picture)), cv2.COLOR_BGR2RGB)
    return [each for each in detector.detect(image) if each.class_name == class_name]


def _labels(class_name: str, *boxes: tuple[int, ...]) -> list[Detection]:
    return [Detection(class_name, 1.0, tuple(map(float, box))) for box in boxes]


def _torrential(test_data: Path) -> Path:
    return next(iter(sorted((test_data / "weather/rainsense/torriential_rain").rglob("image_000.jpg"))))


def test_yolo26n_in_clear_weather_and_transferred_to_rain(test_data: Path):
    detector = _opened(test_data, "yolo26n_int8")
    folder = test_data / "weather/img2img_turbo"
    clear = _seen(detector, folder / "clear2rainy_input.png", "car")
    rainy = _seen(detector, folder / "clear2rainy_output.png", "car")
    labels = _labels("car", *CARS)
    assert [each.confidence for each in clear[:4]] == pytest.approx([0.89, 0.81, 0.58, 0.48], abs=INT8)
    assert clear[4].confidence < 0.25
    found = match_detections(labels, clear)
    assert all(match.iou > 0.9 for match in found)
    in_rain = [match.confidence for match in match_detections(labels, rainy)]
    assert in_rain[:3] == pytest.approx([0.86, 0.61, 0.53], abs=INT8)
    assert in_rain[3] < 0.25  # one lost


def test_both_find_the_car_and_the_person_in_torrential_rain(test_data: Path):
    for name, confidence in (("yolo26n_int8", 0.91), ("yolox_nano", 0.88)):
        detector = _opened(test_data, name)
        cars, people = (_seen(detector, _torrential(test_data), each) for each in ("car", "person"))
        (car,) = match_detections(_labels("car", RAIN_CAR), cars)
        assert car.confidence == pytest.approx(confidence, abs=INT8)
        assert car.iou > 0.9
        assert sum(each.confidence > 0.5 for each in people) == 2
        (person,) = match_detections(_labels("person", RAIN_PERSON), people)
        assert person.confidence > 0.6 and person.iou > 0.75


def test_yolox_is_told_from_its_grids(test_data: Path):
    detector = _opened(test_data, "yolox_nano")
    assert (detector.description.decode, detector.description.channels) == ("yolox", "bgr")
    assert detector.input_size_px == (416, 416)
    cars = _seen(detector, test_data / "weather/img2img_turbo/clear2rainy_input.png", "car")
    found = match_detections(_labels("car", *CARS), cars)
    assert all(match.confidence > 0.5 and match.iou > 0.6 for match in found)


def test_the_same_picture_gives_the_same_numbers(test_data: Path):
    picture = cv2.imread(str(test_data / "weather/img2img_turbo/clear2rainy_input.png"))
    image = np.ascontiguousarray(picture[..., ::-1])
    first, second = (_opened(test_data, "yolox_nano") for _ in range(2))
    assert first.detect(image) == second.detect(image) == first.detect(image)
