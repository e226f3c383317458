"""Scenes in the layout that HUGSIM's export_scene.py writes: made up, small, with real torch checkpoints."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.scene.open import load_scene, scene_hash
from realcar_vehicle import state, write_vehicle

SKY, BUILDING = 10, 2
TIMES = 0.0, 0.5, 1.0
CAR = "a1b2c3"
LENGTH, WIDTH, HEIGHT = 4.0, 1.8, 1.5


def box_to_scene(time_s):
    """Box of a car that drives along +z at 6 m/s: x right, y forward, z up, as for nuScenes."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    matrix[:3, 3] = 2.0, 1.6 - HEIGHT / 2, 10.0 + 6.0 * time_s
    return matrix


@pytest.fixture
def folder(tmp_path):
    generator = torch.Generator().manual_seed(1)
    path = tmp_path / "scene-0383"
    path.mkdir()
    (path / "cfg.yaml").write_text("data_type: nuscenes\naffine: true\n")
    means = np.random.default_rng(1).normal(0, 5, (40, 3))
    classes = [BUILDING] * 30 + [SKY] * 10
    road = state([[x, 1.6, z] for x in (-2.0, 2.0) for z in (0.0, 5.0, 10.0)], [0] * 6, generator, scale_columns=2)
    appearance = {"params": torch.zeros(8)}
    torch.save((state(means, classes, generator, extra=(1.0, appearance, road[:8])), 30_000), path / "scene.pth")
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    corners *= (WIDTH, LENGTH, HEIGHT)
    car = np.random.default_rng(2).uniform(-0.5, 0.5, (20, 3)) * (WIDTH, LENGTH, HEIGHT)
    torch.save((state(car, [13] * 20, generator), 30_000), path / f"dynamic_{CAR}.pth")
    frames = [
        {
            "rgb_path": f"./images/{camera}/{number:05}.jpg",
            "camtoworld": pose(camera, time_s).tolist(),
            "intrinsics": [[500.0, 0, 400], [0, 510.0, 225], [0, 0, 1]],
            "width": 800,
            "height": 450,
            "timestamp": time_s,
            "dynamics": {CAR: box_to_scene(time_s).tolist()} if time_s < 1 else {},
        }
        for number, time_s in enumerate(TIMES)
        for camera in ("CAM_FRONT", "CAM_BACK")
    ]
    (path / "meta_data.json").write_text(json.dumps({"frames": frames, "verts": {CAR: corners.tolist()}}))
    return SimpleNamespace(path=path, means=means, car=car)


def pose(camera, time_s):
    matrix = np.eye(4)
    if camera == "CAM_BACK":
        matrix[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    matrix[2, 3] = 5.0 * time_s
    return matrix


def test_a_released_scene_opens_with_its_layers_vehicles_and_cameras(folder):
    scene = load_scene(folder.path)
    assert [(each.name, each.kind, len(each.gaussians)) for each in scene.layers] == [
        ("background", "background", 30),
        ("road", "background", 6),
        ("sky", "sky", 10),
    ]
    background, road, _ = (each.gaussians for each in scene.layers)
    np.testing.assert_allclose(background.means, folder.means[:30].astype(np.float32))
    assert background.sh.shape == (30, 4, 3)
    np.testing.assert_allclose(road.scales, np.tile(np.float32([np.exp(-2), 0.001, np.exp(-2)]), (6, 1)), rtol=1e-6)
    assert (scene.up, scene.metres_per_unit, scene.unit_is_assumed) == ((0, -1, 0), 1.0, False)
    assert scene.ground_m == pytest.approx(-1.6)

    ego_to_world = scene.ego_to_world(0.5)
    np.testing.assert_allclose(ego_to_world[:3, 3], scene.scene_to_world[:3, :3] @ [0, 0, 2.5], atol=1e-9)
    front, back = scene.rigs["recorded"]
    assert (front.name, front.fx, front.fy, front.cx, back.name) == ("CAM_FRONT", 500, 510, 400, "CAM_BACK")
    assert np.allclose(front.camera_to_ego[:3, 2], [1, 0, 0]) and np.allclose(back.camera_to_ego[:3, 2], [-1, 0, 0])


def test_vehicles_drive_forward_on_their_wheels(folder):
    (car,) = load_scene(folder.path).actors
    assert car.id == CAR and car.size_lwh == pytest.approx((LENGTH, WIDTH, HEIGHT))
    for time_s in (0.0, 0.25):
        to_scene = car.pose_at(time_s)
        np.testing.assert_allclose(to_scene[:3, 3], [2, 1.6, 10 + 6 * time_s], atol=1e-9)
        np.testing.assert_allclose(to_scene[:3, 0], [0, 0, 1], atol=1e-9)  # forward
        np.testing.assert_allclose(to_scene[:3, 2], [0, -1, 0], atol=1e-9)  # up
    assert car.pose_at(0.75) is None  # not annotated any more
    expected = folder.car @ box_to_scene(0)[:3, :3].T + box_to_scene(0)[:3, 3]
    placed = car.gaussians.means @ car.pose_at(0)[:3, :3].T + car.pose_at(0)[:3, 3]
    np.testing.assert_allclose(placed, expected, atol=1e-5)


def test_a_standing_vehicle_looks_along_its_longer_level_side_however_tall_it_is(folder):
    recording = folder.path / "meta_data.json"
    values = json.loads(recording.read_text())
    for frame in values["frames"]:
        frame["dynamics"] = {CAR: box_to_scene(0.0).tolist()}
    values["verts"][CAR] = [[x, y, 6 * z] for x, y, z in values["verts"][CAR]]
    recording.write_text(json.dumps(values))
    (car,) = load_scene(folder.path).actors
    assert car.size_lwh == pytest.approx((LENGTH, WIDTH, 6 * HEIGHT))
    np.testing.assert_allclose(np.abs(car.pose_at(0.25)[:3, 0]), [0, 0, 1], atol=1e-9)


def test_a_fitted_motion_replaces_the_annotated_one(folder):
    times = torch.tensor([0.0, 1.0])
    turned = Rotation.from_matrix(box_to_scene(0)[:3, :3]).as_euler("xzy")
    angles = torch.as_tensor(np.pi / 2 - np.stack([turned, turned]), dtype=torch.float32)
    columns = torch.tensor([[2.0, 2.0], [11.0, 19.0], [8.0, 8.0]]), torch.tensor([0.85, 0.85])
    (x, z, speed), y = columns
    fitted = (x, z, speed, angles[:, :2], angles[:, 2], y, times, torch.diff(times))
    torch.save(fitted, folder.path / f"unicycle_{CAR}.pth")
    (car,) = load_scene(folder.path).actors
    np.testing.assert_allclose(car.pose_at(0.5)[:3, 3], [2, 1.6, 15], atol=1e-5)
    np.testing.assert_allclose(car.pose_at(0.5)[:3, 0], [0, 0, 1], atol=1e-5)


def test_a_3drealcar_vehicle_opens_as_an_actor(tmp_path):
    own = np.random.default_rng(3).uniform(-0.5, 0.5, (2000, 3)) * (LENGTH, HEIGHT, WIDTH)  # x forward, y down, z left
    own += [0.3, 0.0, -0.1]  # its origin is the center of its box in HUGSIM, wherever its Gaussians are
    write_vehicle(tmp_path, own, (WIDTH, LENGTH, HEIGHT))
    (car,) = read_scene(tmp_path).actors
    assert car.size_lwh == pytest.approx((LENGTH, WIDTH, HEIGHT))
    means = car.pose_at(0)[:3, :3] @ car.gaussians.means.T
    np.testing.assert_allclose(means[0], own[:, 0], atol=1e-5)
    np.testing.assert_allclose(means[1], own[:, 2], atol=1e-5)
    np.testing.assert_allclose(means[2], HEIGHT / 2 - own[:, 1], atol=0.05)


def test_the_hash_covers_every_file_that_is_read(folder):
    before = scene_hash(str(folder.path))
    (folder.path / "ground_param.pkl").write_bytes(b"not read")
    assert scene_hash(str(folder.path)) == before
    recording = folder.path / "meta_data.json"
    recording.write_text(recording.read_text().replace("800", "801"))
    assert scene_hash(str(folder.path)) != before


class _Malicious:
    def __reduce__(self):
        return (print, ("this ran",))


def _saved(value):
    return lambda path: torch.save(value, path)


def _changed(index, value):
    def damage(path):
        (model, iteration) = torch.load(path, weights_only=True)
        torch.save(((*model[:index], value(model[index]), *model[index + 1 :]), iteration), path)

    return damage


def _replaced(old, new):
    def damage(path):
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return damage


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("scene.pth", _saved(_Malicious())),
        ("scene.pth", _saved({"means": torch.zeros(3)})),
        ("scene.pth", lambda path: path.write_bytes(path.read_bytes()[:2000])),
        ("scene.pth", lambda path: path.write_bytes(b"")),
        ("scene.pth", _changed(0, lambda _: 7)),
        ("scene.pth", _changed(1, lambda means: means[:-1])),
        ("scene.pth", _changed(1, lambda means: means * np.nan)),
        ("scene.pth", _changed(5, lambda scales: scales.repeat(1, 2))),
        ("scene.pth", _changed(6, lambda quaternions: quaternions * 0)),
        ("scene.pth", _changed(7, lambda _: "opacity")),
        ("scene.pth", _changed(1, lambda means: torch.zeros(1, 3).expand(50_000_000, 3))),
        (f"dynamic_{CAR}.pth", _changed(2, lambda _: None)),
        (f"unicycle_{CAR}.pth", _saved((torch.zeros(2),) * 3)),
        ("meta_data.json", lambda path: path.write_text("{")),
        ("meta_data.json", _replaced("[500.0, 0, 400]", "[500.0]")),
        ("meta_data.json", _replaced("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 1.0]")),
        ("meta_data.json", _replaced('"height": 450', '"height": 0')),
    ],
)
def test_damaged_files_are_named(folder, capsys, name, damage):
    damage(folder.path / name)
    with pytest.raises(SceneFormatError) as caught:
        load_scene(folder.path)
    assert caught.value.path == folder.path / name
    assert "this ran" not in capsys.readouterr().out
