"""Detectors over views, rains and seeds, and results of an earlier run."""

from dataclasses import asdict, dataclass, replace

import numpy as np
import pytest
from PIL import Image

from app.main import run
from boxy_scene import boxy_scene
from gsrain_engine.appearance.capture_photos import CapturePhotos
from gsrain_engine.appearance.scene_views import PlacedCamera
from gsrain_engine.datasets.capture import Capture, CaptureFrame, TrackedBox
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.evaluation.detection.ground_truth import LabeledObject
from gsrain_engine.evaluation.detection.run import (
    Condition,
    ConditionRenderer,
    EvaluatedFrame,
    ResultCache,
    conditions_of,
    evaluate_detections,
    evaluate_images,
    object_rows,
    recorded_frames,
    scene_frames,
)
from gsrain_engine.rain.frame import SkyLight
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.recordings.pictures import PhotoRain
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.sky_color import SkyColor
from gsrain_engine.render.view import RenderView, ego_view
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.scene import PoseTrack, Scene
from small_scene import small_scene

SKY = SkyColor(SkyLight.uniform((0.8, 0.8, 0.8)), True)
SEEDS = (0, 1)
AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 1.5], [1, 0, 0, 0], [0, 0, 0, 1]])
"""World to camera of one 1.5 m above the origin that looks along +x."""


@dataclass
class Oracle:
    """Finds each object of a view, with a confidence that depends on the image."""

    truths: tuple[LabeledObject, ...]
    name: str = "oracle"
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


def test_every_rate_has_every_seed(pictures, frame):
    trials = conditions_of((0.0, 1.2, 8.5), SEEDS, originals=True, scene=True)
    assert trials[:2] == [Condition("original", 0.0, SEEDS), Condition("clear", 0.0, SEEDS)]
    assert trials[2:] == [Condition("rainy", rate, (seed,)) for rate in (1.2, 8.5) for seed in SEEDS]
    trials = conditions_of((12.0,), SEEDS, originals=False, scene=True)
    images = evaluate_images(pictures, [Oracle(frame.truths)], [frame], trials)
    rows = [row for each in images for row in object_rows(each.judgements["oracle"])]
    keys = {(row.intensity_mm_h, row.seed, row.object) for row in rows}
    counted = [each.id for each in frame.truths if each.counts]
    assert keys == {(rate, seed, name) for rate in (0.0, 12.0) for seed in SEEDS for name in counted}
    assert len(rows) == len(keys) >= 4
    assert all(row.iou == pytest.approx(1.0) for row in rows)
    assert [len({row.confidence for row in rows if row.intensity_mm_h == rate}) for rate in (0, 12)] == [1, 2]


def test_the_picture_of_a_recorded_jpeg_is_that_of_its_rainy_copy(tmp_path):
    folder, copy = tmp_path / "photos", tmp_path / "copy"
    folder.mkdir()
    photo = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)
    Image.fromarray(photo).save(folder / "a.jpg", quality=90)
    assert run(["export-rain", str(folder), "-o", str(copy), "--rain", "50", "--seed", "2"]) == 0
    capture = open_capture(folder)
    photos = CapturePhotos(capture)
    placed = [PlacedCamera(capture[0].name, capture[0].camera)]
    (frame,) = recorded_frames(photos.world, placed, capture, {capture[0].name: ()})
    pictures = ConditionRenderer(CpuRenderer(), photos.world, RainSettings(), SKY, photos)
    drawn = pictures.take(frame, Condition("rainy", 50.0, (2,)))
    np.testing.assert_array_equal(drawn, open_capture(copy)[0].image)
    assert not np.array_equal(drawn, capture[0].image)


@pytest.mark.parametrize("width", [64, 32])
def test_rain_over_photographs_is_that_of_their_rainy_copy(width):
    photo = np.full((48, 64, 3), 40, np.uint8)
    photo[:16] = 200
    view = CaptureFrame("a", Camera(64, 48, 60.0, 60.0, 32.0, 24.0, AHEAD), photo)
    capture = Capture("drive", (view,))
    placed = [PlacedCamera("a", view.camera).at_width(width)]
    photos = CapturePhotos(capture)
    (frame,) = recorded_frames(photos.world, placed, capture, {"a": ()})
    pictures = ConditionRenderer(CpuRenderer(), photos.world, RainSettings(), SKY, photos)
    original = undistort_frame(view, width).image
    np.testing.assert_array_equal(pictures.take(frame, Condition("original", 0.0, (0,))), original)
    rainy = pictures.take(frame, Condition("rainy", 100.0, (3,)))
    copy = PhotoRain(CpuRenderer(), capture, RainSettings(intensity_mm_h=100.0, seed=3)).rainy(view, photo)
    np.testing.assert_array_equal(rainy, undistort_frame(replace(view, image_source=copy), width).image)
    assert np.abs(rainy.astype(int) - original).mean() > 0.5


def test_mounted_cameras_have_the_vehicles_speed():
    scene = small_scene()
    camera = rig_camera(scene, "one", "FRONT", 1.5)
    np.testing.assert_allclose(ego_view(scene, camera, 1.5).velocity_m_s, [2, 0, 0], atol=1e-6)
    np.testing.assert_array_equal(ego_view(Scene("none"), camera, 0.0).velocity_m_s, np.zeros(3))


def test_recorded_views_have_images_and_labels():
    camera = Camera(80, 40, 40.0, 40.0, 40.0, 20.0, AHEAD)
    where = PoseTrack(np.zeros(1), np.array([[5.0, 0, 0]]), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))
    box = TrackedBox("a", "Car", (2.0, 2.0, 1.5), where)
    view = CaptureFrame("front/000.jpg", camera, np.full((40, 80, 3), 90, np.uint8))
    capture = Capture("drive", (view,), boxes=(box,))
    placed = [PlacedCamera("front/000.jpg", camera).at_width(40)]
    (frame,) = recorded_frames(Scene("world"), placed, capture)
    assert frame.original().shape == (20, 40, 3)
    assert [each.id for each in frame.truths] == ["a"]
    np.testing.assert_allclose(frame.truths[0].box_xyxy, (15, 10, 25, 17.5), atol=1e-3)
    labels = {"001.jpg": (), "000.jpg": (CAR,)}
    assert recorded_frames(Scene("world"), placed, capture, labels)[0].truths == (CAR,)
    assert recorded_frames(Scene("world"), placed, capture, {})[0].truths == ()
    for refused in (
        lambda: recorded_frames(Scene("world"), placed, replace(capture, boxes=())),
        lambda: scene_frames(CpuRenderer(), Scene("world"), placed),
    ):
        with pytest.raises(ValueError, match="--truth"):
            refused()


SIGN, CAR, WAYMO, SMALL = (
    LabeledObject("s", "sign", (0.0, 0.0, 20.0, 40.0)),
    LabeledObject("c", "car", (100.0, 0.0, 140.0, 40.0)),
    LabeledObject("v", "vehicle", (200.0, 0.0, 240.0, 40.0)),
    LabeledObject("small", "car", (60.0, 0.0, 70.0, 10.0)),
)


def evaluated(truths, detections, classes=()):
    frame = EvaluatedFrame("f", RenderView(Camera(300, 100, 50.0, 50.0, 150.0, 50.0)), truths)
    return evaluate_detections("d", frame, Condition("clear", 0.0, (0,)), detections, classes)


def test_misses_and_flips_are_rows_but_ignored_objects_are_not():
    boxes = (("truck", 0.7, CAR.box_xyxy), ("car", 0.9, SMALL.box_xyxy), ("car", 0.8, (60, 60, 90, 90)))
    found = [Detection(*each) for each in boxes]
    result = evaluated((CAR, SMALL), found)
    assert (result.truths, result.detections) == ((CAR,), (found[0], found[2]))
    (flipped,) = object_rows(result)
    (missed,) = object_rows(evaluated((CAR,), []))
    assert flipped.plain() == missed.plain() | {"class_seen": "truck", "confidence_any_class": 0.7, "iou_any_class": 1}
    assert (missed.plain()["class"], missed.confidence, missed.iou, missed.class_seen) == ("car", 0.0, 0.0, None)


def test_objects_that_a_detector_can_not_name_are_listed_apart():
    boxes = (("truck", 0.9, WAYMO.box_xyxy), ("car", 0.8, CAR.box_xyxy), ("person", 0.7, SIGN.box_xyxy))
    found = [Detection(*each) for each in boxes]
    result = evaluated((SIGN, CAR, WAYMO), found, ("person", "car", "truck"))
    assert result.truths == (CAR, WAYMO) and result.not_named == (SIGN,)
    assert [(each.confidence, each.flipped_to) for each in result.matches] == [(0.8, None), (0.9, None)]
    assert result.detections == tuple(found[:2])  # nothing is wrong about the sign
    everything = evaluated((SIGN, CAR, WAYMO), found)
    assert everything.not_named == () and len(everything.truths) == 3


# Results of an earlier run

CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
TRUTHS = (LabeledObject("a", "car", (4.0, 5.0, 40.0, 45.0), 0.9, np.float64(1 / 3)),)
FRAME = EvaluatedFrame("first", RenderView(CAMERA, 1.5, np.array([10.0, 0.0, 0.0])), TRUTHS)
RAINY = Condition("rainy", 8.5, (3,))
FOUND = evaluate_detections("net", FRAME, RAINY, [Detection("car", np.float64(1 / 7), (4.1, 5.0, 40.0, 44.9))])


def opened(place, inputs=None, detectors=None):
    return ResultCache(place, inputs or {"scene": "1234"}, detectors or {"net": "abcd"})


@pytest.fixture
def file(tmp_path):
    """With one result in it."""
    with opened(tmp_path / "finished.jsonl") as cache:
        cache.keep(FOUND, FRAME)
    return tmp_path / "finished.jsonl"


def test_results_are_read_as_they_were_written(file):
    cache = opened(file)
    assert cache.known("net", FRAME, RAINY) is None  # not read yet
    assert cache.read([FRAME]) == 1
    assert asdict(cache.known("net", FRAME, RAINY)) == asdict(FOUND)
    assert cache.known("net", FRAME, RAINY._replace(seeds=(4,))) is None
    assert cache.known("net", FRAME, RAINY._replace(intensity_mm_h=8.6)) is None
    with cache:
        cache.keep(replace(FOUND, trial=Condition("clear", 0.0, (0, 1))), FRAME)
    cache = opened(file)
    assert cache.read([FRAME]) == 2
    more = Condition("clear", 0.0, (0, 1, 2, 3))  # a clear image represents any seeds
    assert asdict(cache.known("net", FRAME, more)) == asdict(replace(FOUND, trial=more))


@pytest.mark.parametrize(
    "other",
    [
        {"inputs": {"scene": "1235"}},
        {"detectors": {"net": "abce"}},
        {"frame": replace(FRAME, name="second")},
        {"frame": replace(FRAME, shot=RenderView(CAMERA, 1.6, np.array([10.0, 0.0, 0.0])))},
        {"frame": replace(FRAME, shot=RenderView(CAMERA, 1.5, np.array([10.1, 0.0, 0.0])))},
        {"frame": replace(FRAME, shot=RenderView(replace(CAMERA, fx=50.1), 1.5, np.array([10.0, 0.0, 0.0])))},
        {"frame": replace(FRAME, truths=(replace(TRUTHS[0], box_xyxy=(4.0, 5.0, 40.0, 45.1)),))},
    ],
)
def test_results_of_other_inputs_and_truncated_lines_are_removed(file, other):
    whole, frame = file.read_bytes(), other.pop("frame", FRAME)
    for cut in (0, 1, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole + whole[:cut])
        assert opened(file).read([FRAME]) == 1
        assert file.read_bytes() == whole
    assert opened(file, **other).read([frame]) == 0
    assert file.read_bytes() == b""
