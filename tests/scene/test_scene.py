"""Scenes: tracks and parts, one set of Gaussians of a whole, cameras, things with boxes, names, and progress."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from boxy_scene import boxy_scene
from gsrain_engine.scene.camera import Camera, look_at, read_camera
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.objects import COCO_CATEGORIES, scene_objects
from gsrain_engine.scene.open import is_built_in_street, load_scene, load_street
from gsrain_engine.scene.progress import Progress, run_to_end
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from gsrain_engine.scene.street.layout import StreetParameters, plan_street
from gsrain_engine.scene.transforms import FILE_UP, flatten_scene, transform_gaussians
from small_scene import small_scene

from .formats.sample_files import sample_gaussians
from .test_gaussians import covariances

UP = np.array([0.0, 0, 1])


def track(valid: tuple[bool, ...] = (True, True, True)) -> PoseTrack:
    quarter = Rotation.from_euler("z", [[0], [90], [90]], degrees=True).as_quat()[:, [3, 0, 1, 2]]
    return PoseTrack(np.array([0.0, 1, 3]), np.array([[0.0, 0, 0], [2, 0, 0], [2, 4, 0]]), quarter, np.array(valid))


def car(valid: tuple[bool, ...] = (True, True, True), **fields: Any) -> Actor:
    return Actor("x", "car", (4.0, 2.0, 1.5), sample_gaussians(6, 1, seed=4), track(valid), **fields)


def test_tracks_interpolate_linearly_and_along_the_arc() -> None:
    before, middle, after = (track().pose(time) for time in (-5.0, 0.5, 99.0))
    assert before is not None and middle is not None and after is not None
    assert middle[:3, 3] == pytest.approx([1, 0, 0])
    assert np.allclose(middle[:3, :3], Rotation.from_euler("z", 45, degrees=True).as_matrix())
    assert before[:3, 3] == pytest.approx([0, 0, 0]) and after[:3, 3] == pytest.approx([2, 4, 0])


def test_parts_are_visible_members_while_their_tracks_are_valid() -> None:
    layers = (Layer("a", sample_gaussians(3)), Layer("b", sample_gaussians(3), visible=False))
    scene = Scene("s", layers, (car((True, False, True)),))
    assert [len(scene.parts(t)) for t in (0.5, 1.5, 3.5)] == [2, 1, 2]
    assert scene.gaussian_count == 12
    assert len(scene.with_member("layers/a", gaussians=sample_gaussians(5)).layers[0].gaussians) == 5
    with pytest.raises(KeyError, match="layers/c"):
        scene.member("layers/c")


def test_parts_and_the_ego_stand_in_meters_with_z_up() -> None:
    layer = Layer("a", sample_gaussians(3))
    scene = Scene("s", (layer,), (car(),), metres_per_unit=2.0, up=(0.0, -1.0, 0.0), ego=track())
    first, actor = scene.parts(1.0)
    assert first.to_world @ [0, -1, 0, 1] == pytest.approx([0, 0, 2, 1])
    assert actor.to_world @ [1, 0, 0, 1] == pytest.approx(first.to_world @ [2, 1, 0, 1])
    pose = replace(scene, up=(0.0, 0.0, 1.0)).ego_to_world(0.5)
    assert pose is not None
    assert pose[:3, 3] == pytest.approx([2, 0, 0])
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)  # meters, and no scale


# One set of Gaussians


def test_visible_layers_and_actors_at_a_time_are_joined() -> None:
    layers = (
        Layer("a", sample_gaussians(5)),
        Layer("b", sample_gaussians(7), visible=False),
        Layer("sky", sample_gaussians(3, 2), kind="sky"),
    )
    scene = Scene("s", layers, (car(), car(visible=False)), up=FILE_UP)
    joined = flatten_scene(scene)
    assert len(joined) == 5 + 3 + 6
    np.testing.assert_array_equal(joined.means[:5], layers[0].gaussians.means)
    np.testing.assert_array_equal(joined.sh[:5], layers[0].gaussians.sh)
    np.testing.assert_array_equal(joined.sh[5:8, :9], layers[2].gaussians.sh)
    x, y, z = car().gaussians.means.T
    np.testing.assert_allclose(joined.means[8:], np.stack([x, y, z], axis=1), atol=1e-5)
    np.testing.assert_allclose(flatten_scene(scene, 1.0).means[8:], np.stack([2 - y, x, z], axis=1), atol=1e-5)
    assert len(flatten_scene(Scene("s", layers[1:2]))) == 0


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.3, 0.2, -0.7)])
def test_files_show_in_the_world_what_the_scene_shows(up: tuple[float, float, float]) -> None:
    scene = Scene("s", (Layer("a", sample_gaussians(9)),), (car(),), metres_per_unit=2.5, up=up)
    before = Gaussians.concatenate([transform_gaussians(part.gaussians, part.to_world) for part in scene.parts()])
    (part,) = Scene("t", (Layer("t", flatten_scene(scene)),), up=FILE_UP).parts()
    after = transform_gaussians(part.gaussians, part.to_world)
    np.testing.assert_allclose(after.means, before.means, atol=1e-4)
    np.testing.assert_allclose(covariances(after), covariances(before), atol=1e-5)
    np.testing.assert_allclose(after.sh, before.sh, atol=1e-5)


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


# Things with a class and a box


@pytest.fixture(scope="module")
def street() -> Scene:
    return load_street()


def test_the_street_has_its_lead_car_and_every_parked_vehicle(street: Scene) -> None:
    objects = scene_objects(street)
    layout = plan_street(StreetParameters())
    cars, trucks = layout.cars, layout.trucks
    assert [each.id for each in objects] == [
        "lead", *(f"parked-{k:02d}" for k in range(len(cars))), *(f"truck-{k:02d}" for k in range(len(trucks)))
    ]  # fmt: skip
    assert [each.class_name for each in objects] == ["car"] * (1 + len(cars)) + ["truck"] * len(trucks)
    for kind, count in (("cars", len(cars)), ("trucks", len(trucks))):
        own = [each.rows for each in objects if each.member == f"layers/parked {kind}"]
        rows = np.concatenate(own)
        assert len(own) == count >= 2 and len(np.unique(rows)) == len(rows)
        assert len(rows) > 0.98 * len(street.member(f"layers/parked {kind}").gaussians)
    for each, vehicle in zip(objects[1:], (*cars, *trucks), strict=True):
        middle = street.member(each.member).gaussians.means[each.rows][:, :2].mean(axis=0)
        np.testing.assert_allclose(middle, (vehicle.x, vehicle.y), atol=0.9)
        np.testing.assert_allclose(each.track.pose(3.0)[:2, 3], (vehicle.x, vehicle.y))


def test_the_shadow_that_a_car_carries_along_is_not_the_car(street: Scene) -> None:
    lead = street.actors[0]
    rows = scene_objects(street)[0].rows
    left_out = np.delete(np.arange(len(lead.gaussians)), rows)
    assert len(left_out) > 100
    np.testing.assert_allclose(lead.gaussians.means[left_out, 2], 0.06, atol=1e-3)
    assert lead.gaussians.opacities[left_out].max() < 0.6
    assert lead.gaussians.opacities[rows].min() > 0.5


def test_vehicles_of_another_street_and_hidden_ones_are_no_objects(street: Scene) -> None:
    cars, trucks = street.member("layers/parked cars"), street.member("layers/parked trucks")
    moved = replace(cars.gaussians, means=cars.gaussians.means + np.float32([3, 0, 0]))
    elsewhere = street.with_member(cars.key, gaussians=moved)
    assert {each.member for each in scene_objects(elsewhere)} == {"actors/lead", trucks.key}
    assert len(scene_objects(replace(street, name="mine"))) == 1
    hidden = street.with_member(cars.key, visible=False)
    assert {each.class_name for each in scene_objects(hidden)} == {"car", "truck"}
    assert len(scene_objects(hidden.with_member(trucks.key, visible=False))) == 1
    scene = boxy_scene()
    assert [each.class_name for each in scene_objects(scene)] == ["Car", "Car"]
    assert len(scene_objects(scene.with_member("actors/far", visible=False))) == 1


def test_category_ids_are_those_of_coco_2017() -> None:
    known = {"person": 1, "car": 3, "truck": 8, "stop sign": 13, "umbrella": 28, "skis": 35, "dining table": 67}
    assert {name: COCO_CATEGORIES[name] for name in known} == known
    assert (len(COCO_CATEGORIES), COCO_CATEGORIES["tv"], COCO_CATEGORIES["toothbrush"]) == (80, 72, 90)


# Names


def test_the_street_is_built_in_unless_a_scene_is_called_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert is_built_in_street(None) and is_built_in_street("street") and not is_built_in_street("road")
    write_scene(small_scene("own"), tmp_path / "street" / "scene")  # as the command `street` writes it
    (tmp_path / "street" / "meta.json").write_text("{}")  # none of SOG
    assert is_built_in_street("street") and not is_built_in_street("street/scene")
    for name in ("meta.json", "scene.json"):
        (tmp_path / "street" / name).write_text('{"means": {}}')
        assert not is_built_in_street("street")
        (tmp_path / "street" / name).unlink()
    (tmp_path / "street").rename(tmp_path / "other")
    write_scene(small_scene("own"), tmp_path / "street")
    assert not is_built_in_street("street") and load_scene("street").name == "own"


# Progress


def test_work_runs_to_its_end_or_to_its_error() -> None:
    def work(stops_at: int | None = None) -> Any:
        for i in range(3):
            if i == stops_at:
                raise ValueError("the disk is full")
            yield Progress(i / 3, f"step {i}")
        return "a scene"

    steps: list[Progress] = []
    assert run_to_end(work(), steps.append) == run_to_end(work()) == "a scene"
    assert [step.message for step in steps] == ["step 0", "step 1", "step 2"]
    with pytest.raises(ValueError, match="disk is full"):
        run_to_end(work(stops_at=2), steps.append)
    assert len(steps) == 5
