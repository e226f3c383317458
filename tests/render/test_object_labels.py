"""Labels of objects in pictures: which are visible, boxes in the image, and masks in COCO's run lengths."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from boxy_scene import FAR_M, NEAR_M, boxy_scene
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.export import export_sequences
from gsrain_engine.render.export_settings import ExportSettings
from gsrain_engine.render.label_export import encode_rle, write_object_labels
from gsrain_engine.render.object_labels import (
    area_px,
    bounding_rectangle,
    convex_outline,
    cut_at_edges,
    visible_objects,
)
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.geometry import box_corners
from gsrain_engine.scene.objects import scene_objects
from gsrain_engine.scene.progress import run_to_end
from gsrain_engine.scene.rig import rig_camera
from oracles.run_lengths import unpacked


def camera_of(scene):
    return rig_camera(scene, "one", "FRONT", 0.0).resized(288, 192)


def seen(scene, camera=None):
    objects = visible_objects(CpuRenderer(), scene, scene_objects(scene), camera or camera_of(scene))
    return {each.object.id: each for each in objects}


@pytest.fixture(scope="module")
def both():
    return seen(boxy_scene())


def test_boxes_and_visibility_are_those_of_visible_pixels(both):
    assert list(both) == ["near", "far"]  # the nearest first
    assert both["near"].visibility == pytest.approx(1.0, abs=0.02)
    assert both["far"].visibility == pytest.approx(0.5, abs=0.1)
    assert not (both["near"].mask & both["far"].mask).any()
    near, far = both["near"].box_xyxy, both["far"].box_xyxy
    f = 240.0
    np.testing.assert_allclose(near, (144 - 0.1 * f, 96, 144 + 0.1 * f, 96 + 0.15 * f), atol=2.5)
    # The far car reaches from 0.05 to 0.15 of the tangent; up to 0.1 the near one stands before it.
    np.testing.assert_allclose(far, (144 + 0.1 * f, 96, 144 + 0.15 * f, 96 + 0.075 * f), atol=2.5)


def test_distance_and_size_are_in_metres(both):
    assert both["near"].distance_m == pytest.approx(np.hypot(NEAR_M, 0.75), abs=1e-6)
    assert both["far"].center_m == pytest.approx([2.0, 0.75, FAR_M])
    scaled = replace(boxy_scene(), metres_per_unit=2.0)
    doubled = seen(scaled, camera_of(scaled))["near"]
    assert doubled.size_lwh_m == (8.0, 4.0, 3.0)
    assert doubled.distance_m == pytest.approx(2 * both["near"].distance_m)


def test_what_leaves_the_picture_is_truncated():
    scene = boxy_scene()
    camera = camera_of(scene)
    cut = seen(scene, replace(camera, cx=camera.cx - 144.0))["near"]
    assert cut.truncation == pytest.approx(0.5, abs=0.1)
    assert cut.visibility == pytest.approx(1.0, abs=0.02)  # the picture's edge hides nothing
    assert cut.box_xyxy[0] == 0.0
    assert "near" not in seen(scene, replace(camera, cx=camera.cx - 400.0))


def test_what_is_hidden_by_a_person_is_not_there():
    scene = boxy_scene()
    count = len(scene.actors[0].gaussians)
    without = scene.with_member("actors/near", marks=SelectionFlags(hidden=BitMask.all(count)))
    assert list(seen(without)) == ["far"]
    assert seen(without)["far"].visibility == pytest.approx(1.0, abs=0.02)
    assert list(seen(scene.with_member("actors/near", visible=False))) == ["far"]


def test_labels_are_written_as_coco_and_kitti(tmp_path):
    scene = boxy_scene()
    recording = ExportSettings(
        output=str(tmp_path / "run"), size_px=(288, 192), passes=("color", "depth"), twin="sunny"
    )
    sequences = export_sequences(
        recording, scene, RainSimulation.start(RainSettings()), camera_of(scene), in_scene_time=True
    )
    coco, kitti = (
        run_to_end(write_object_labels(CpuRenderer(), form, recording, sequences, [0])) for form in ("coco", "kitti")
    )
    assert [*coco, *kitti] == [tmp_path / "run/labels.coco.json", tmp_path / "run"]
    document, found = json.loads(coco[0].read_text()), list(seen(scene).values())
    (image,) = document["images"]
    assert image["file_name"] == "000000.png"
    assert image["clear_file_name"] == "../run.clear/000000.png"
    assert image["depth_file_name"] == "000000.depth.png"
    lines = (tmp_path / "run/label_2/000000.txt").read_text().splitlines()
    for each, label, line in zip(found, document["annotations"], lines, strict=True):
        left, top, right, bottom = each.box_xyxy
        assert (label["object"], label["bbox"]) == (each.object.id, [left, top, right - left, bottom - top])
        np.testing.assert_array_equal(unpacked(label["segmentation"]), each.mask)
        length, width, height = each.size_lwh_m
        expected = [*(edge - 0.5 for edge in each.box_xyxy), height, width, length, *each.to_camera[:3, 3]]
        assert line.startswith("Car ")
        np.testing.assert_allclose(np.array(line.split()[4:14], float), expected, atol=0.006)
    with Image.open(tmp_path / "run/instance_2/000000.png") as picture:
        assert len(np.unique(np.asarray(picture))) == 3


# Boxes

CAMERA = Camera(200, 100, 100.0, 100.0, 100.0, 50.0)
AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
"""From x forward, y left, z up to the camera's axes."""


@pytest.mark.parametrize(
    ("place", "size_lwh", "expected", "within"),
    [
        ((11, 0, -1), (2.0, 4.0, 2.0), (80, 40, 120, 60), (80, 40, 120, 60)),
        ((11, 10, -1), (2.0, 4.0, 2.0), (-20, 40, 100 - 800 / 12, 60), (0, 40, 100 - 800 / 12, 60)),
        ((11, 40, -1), (2.0, 4.0, 2.0), (-320, 40, 100 - 3800 / 12, 60), None),
        ((-5, 0, -1), (2.0, 2.0, 2.0), None, None),  # behind the camera
    ],
)
def test_a_box_is_where_its_nearest_face_is_and_cut_at_the_edges(place, size_lwh, expected, within):
    pose = AHEAD.copy()
    pose[:3, 3] = AHEAD[:3, :3] @ place
    hull = convex_outline(box_corners(pose, size_lwh), CAMERA)
    for polygon, rectangle in ((hull, expected), (cut_at_edges(hull, CAMERA), within)):
        assert (len(polygon) > 0) == (rectangle is not None)
        if rectangle is not None:
            np.testing.assert_allclose(bounding_rectangle(polygon), rectangle, atol=1e-3)
    if expected == within and expected is not None:
        assert area_px(hull) == pytest.approx(800, abs=0.01)


@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24)), st.integers(1, 40))
def test_packed_masks_come_back_and_are_those_of_pycocotools(mask, times):
    large = np.kron(mask, np.ones((times, 1), bool))
    packed = encode_rle(large)
    np.testing.assert_array_equal(unpacked(packed), large)
    coco = pytest.importorskip("pycocotools.mask")
    assert packed["counts"] == coco.encode(np.asfortranarray(large.astype(np.uint8)))["counts"].decode()
