"""Scenes: tracks and parts, one set of Gaussians of a whole, cameras and classes."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.camera import Camera, look_at, read_camera
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.objects import COCO_CATEGORIES
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from gsrain_engine.scene.transforms import FILE_UP, flatten_scene, transform_gaussians

from .formats.sample_files import sample_gaussians
from .test_gaussians import covariances

UP = np.array([0.0, 0, 1])


def track(valid: tuple[bool, ...] = (True, True, True)) -> PoseTrack:
    quarter = Rotation.from_euler("z", [[0], [90], [90]], degrees=True).as_quat()[:, [3, 0, 1, 2]]
    return PoseTrack(np.array([0.0, 1, 3]), np.array([[0.0, 0, 0], [2, 0, 0], [2, 4, 0]]), quarter, np.array(valid))


def car(valid: tuple[bool, ...] = (True, True, True), **fields: Any) -> Actor:
    return Actor("x", "car", (4.0, 2.0, 1.5), sample_gaussians(6, 1, seed=4), track(valid), **fields)


def test_tracks_interpolate_and_parts_are_there_while_their_tracks_are_valid() -> None:
    for time, place, turn_deg in ((-5.0, [0, 0, 0], 0), (0.5, [1, 0, 0], 45), (99.0, [2, 4, 0], 90)):
        pose = track().pose(time)
        assert pose is not None
        np.testing.assert_allclose(pose[:3, 3], place, atol=1e-12)
        np.testing.assert_allclose(
            pose[:3, :3], Rotation.from_euler("z", turn_deg, degrees=True).as_matrix(), atol=1e-9
        )
    layers = (Layer("a", sample_gaussians(3)), Layer("b", sample_gaussians(3), visible=False))
    scene = Scene("s", layers, (car((True, False, True)),))
    assert [len(scene.parts(t)) for t in (0.5, 1.5, 3.5)] == [2, 1, 2]
    assert scene.gaussian_count == 12
    assert len(scene.with_member("layers/a", gaussians=sample_gaussians(5)).layers[0].gaussians) == 5
    with pytest.raises(KeyError, match="layers/c"):
        scene.member("layers/c")


@pytest.mark.parametrize("turn_deg", [1.0, 3.0, 100.0])
def test_tracks_turn_evenly_by_small_and_large_angles(turn_deg: float) -> None:
    ends = Rotation.from_euler("z", [[0], [turn_deg]], degrees=True).as_quat()[:, [3, 0, 1, 2]]
    turning = PoseTrack(np.array([0.0, 1.0]), np.zeros((2, 3)), ends, np.ones(2, bool))
    for part in (0.25, 0.5, 0.9):
        pose = turning.pose(part)
        assert pose is not None
        assert np.degrees(np.arctan2(pose[1, 0], pose[0, 0])) == pytest.approx(part * turn_deg, rel=1e-4)


def test_parts_and_the_ego_are_in_meters_with_z_up() -> None:
    layer = Layer("a", sample_gaussians(3))
    scene = Scene("s", (layer,), (car(),), metres_per_unit=2.0, up=(0.0, -1.0, 0.0), ego=track())
    first, actor = scene.parts(1.0)
    assert first.to_world @ [0, -1, 0, 1] == pytest.approx([0, 0, 2, 1])
    assert actor.to_world @ [1, 0, 0, 1] == pytest.approx(first.to_world @ [2, 1, 0, 1])
    pose = replace(scene, up=(0.0, 0.0, 1.0)).ego_to_world(0.5)
    assert pose is not None
    assert pose[:3, 3] == pytest.approx([2, 0, 0])
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)  # meters, and no scale


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), FILE_UP, (0.3, 0.2, -0.7)])
def test_flat_scenes_hold_what_is_visible_and_look_the_same_in_the_world(up: tuple[float, float, float]) -> None:
    layers = Layer("a", sample_gaussians(9)), Layer("b", sample_gaussians(7), visible=False)
    scene = Scene("s", layers, (car(), car(visible=False)), metres_per_unit=2.5, up=up)
    for time in (0.0, 1.0):
        parts = [transform_gaussians(part.gaussians, part.to_world) for part in scene.parts(time)]
        before = Gaussians.concatenate(parts)
        flat = flatten_scene(scene, time)
        (part,) = Scene("t", (Layer("t", flat),), up=FILE_UP).parts()
        after = transform_gaussians(part.gaussians, part.to_world)
        np.testing.assert_allclose(after.means, before.means, atol=1e-4)
        np.testing.assert_allclose(covariances(after), covariances(before), atol=1e-5)
        np.testing.assert_allclose(after.sh, before.sh, atol=1e-5)
        np.testing.assert_array_equal(after.opacities, before.opacities)
    as_file = flatten_scene(Scene("s", layers, up=FILE_UP))
    np.testing.assert_array_equal(as_file.means, layers[0].gaussians.means)  # not turned there and back
    assert len(flatten_scene(Scene("s", layers[1:]))) == 0


# Cameras

coordinates = st.floats(-100, 100)
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)


def project(camera: Camera, point: np.ndarray) -> tuple[np.ndarray, float]:
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]), z


@given(points, points)
def test_look_at_puts_the_target_in_the_middle_and_up_upwards(eye: np.ndarray, target: np.ndarray) -> None:
    if np.linalg.norm((target - eye)[:2]) < 1e-3:
        return
    camera = Camera.from_fov(320, 200, 60.0, look_at(eye, target, UP))
    pixel, depth = project(camera, target)
    assert pixel == pytest.approx([160, 100], abs=1e-4)
    assert depth == pytest.approx(np.linalg.norm(target - eye))
    above, _ = project(camera, target + 1e-3 * UP)
    assert above[1] < pixel[1]
    assert camera.position == pytest.approx(eye, abs=1e-9 * (1 + np.abs(eye).max()))


def test_resizing_keeps_the_vertical_field_of_view() -> None:
    camera = Camera(960, 640, 1030.0, 1000.0, 470.0, 330.0)
    smaller = camera.resized(300, 160)
    assert smaller.vertical_fov_deg == pytest.approx(camera.vertical_fov_deg)
    assert smaller.fx / smaller.fy == pytest.approx(1.03)
    assert smaller.cx == pytest.approx(150 - 10 / 4)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"fx": 0}, "fx, fy"),
        ({"width": 0}, "1..16384"),
        ({"width": "wide"}, "'wide'"),
        ({"world_to_camera": np.diag([2, 2, 2, 1]).tolist()}, "rotation without scale"),
        ({"world_to_camera": [[float("nan")] * 4] * 4}, "finite 4x4"),
        ({"world_to_camera": [1, 2, 3]}, "expected 4x4"),
        ({"world_to_camera": None}, "'world_to_camera'"),
        ({"exposure_s": 0}, "exposure_s"),
    ],
)
def test_camera_files_come_back_and_bad_ones_are_named(tmp_path: Path, change: dict[str, Any], field: str) -> None:
    file = tmp_path / "camera.json"
    values = Camera(640, 480, 500.0, 501.0, 320.5, 240.0, look_at(np.array([1.0, 2, 3]), np.zeros(3), UP)).to_json()
    file.write_text(json.dumps(values))
    assert read_camera(file).to_json() == values
    file.write_text(json.dumps({name: value for name, value in (values | change).items() if value is not None}))
    with pytest.raises(SceneFormatError, match=rf"camera\.json: .*{field}"):
        read_camera(file)
    file.write_text("{")
    with pytest.raises(SceneFormatError, match="not a JSON file"):
        read_camera(file)


# Classes


def test_category_ids_are_those_of_coco_2017() -> None:
    known = {"person": 1, "car": 3, "truck": 8, "stop sign": 13, "umbrella": 28, "skis": 35, "dining table": 67}
    assert {name: COCO_CATEGORIES[name] for name in known} == known
    assert (len(COCO_CATEGORIES), COCO_CATEGORIES["tv"], COCO_CATEGORIES["toothbrush"]) == (80, 72, 90)
