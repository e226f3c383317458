"""Scenes of NVIDIA's NuRec in the layouts of their public sources, stand-ins: nodes, tracks, rig and sky; damage."""

import gzip
import io
import json
import logging
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import torch

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene
from gsrain_engine.scene.gaussians import Gaussians
from trained_street import (
    FACES,
    HEIGHT,
    LENGTH,
    WIDTH,
    assert_same_picture,
    at_center,
    centers,
    colors_towards,
    cubemap,
    raw,
    street,
    without_car,
)

pytest.importorskip("pxr")
START_US = 27_567_868_848
SEQUENCE, TRACK = "scene:1", "7@scene:1"


def node(gaussians: Gaussians, terms: int = 5) -> dict[str, torch.Tensor]:
    """Tensors of a node; albedo is a Fourier series over time, whose other terms average out."""
    each = raw(gaussians)
    count = len(each["means"])
    return {
        "positions": each["means"],
        "rotations": each["quats"],
        "scales": each["scales"],
        "densities": each["opacities"][:, None],
        "features_albedo": torch.cat([each["sh0"], torch.full((count, terms - 1, 3), 3.0)], dim=1),
        "features_specular": each["shN"].reshape(count, -1),
        "n_active_features": torch.tensor(3),
    }


def state(*, with_car: bool = True) -> dict[str, Any]:
    """State of a model, by key without its prefix."""
    scene = street()
    nodes = {"background": node(scene.layers[0].gaussians)}
    if with_car:
        car = node(at_center(scene.actors[0]))
        nodes["dynamic_rigids"] = {**car, "gaussian_cuboid_ids": torch.full((200,), 1)}
    found: dict[str, Any] = {
        f"gaussians_nodes.{name}.{key}": tensor for name, values in nodes.items() for key, tensor in values.items()
    }
    found["background.textures"] = cubemap()[None]
    found["_extra_state"] = {"obj_track_ids": {"background": [], "dynamic_rigids": ["3@scene:1", TRACK]}}
    return found


def volume(values: dict[str, Any]) -> bytes:
    """Bytes of a `.nurec`: half floats and 64-bit integers, with the shape beside each."""
    packed: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, torch.Tensor):
            array = value.numpy().astype("<f2" if value.is_floating_point() else "<i8")
            packed[f".{key}"], packed[f".{key}.shape"] = array.tobytes(), list(array.shape)
        else:
            packed[f".{key}"] = value
    data = {"nre_data": {"version": "26.4", "model": "nre", "config": {}, "state_dict": packed}}
    return gzip.compress(msgspec.msgpack.encode(data))


def tracks() -> dict[str, Any]:
    """Of the car, in the frames in which it is present, and of another without Gaussians."""
    positions, turns, present = (each.numpy() for each in centers(street().actors[0]))
    poses = np.concatenate([positions, turns[:, [1, 2, 3, 0]]], axis=1)[present].tolist()
    times = [START_US + 100_000 * k for k in np.flatnonzero(present).tolist()]
    return {
        SEQUENCE: {
            "tracks_data": {
                "tracks_id": ["9@scene:1", TRACK],
                "tracks_label_class": ["person", "automobile"],
                "tracks_timestamps_us": [[START_US], times],
                "tracks_poses": [[[0, 0, 0, 0, 0, 0, 1]], poses],
            },
            "cuboidtracks_data": {"cuboids_dims": [[0.5, 0.5, 1.8], [LENGTH, WIDTH, HEIGHT]]},
        }
    }


def rig() -> dict[str, Any]:
    """Drive along x at 2 m/s for 0.5 s, in a world 100 m away, with one camera without and one with a lens."""
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = 100 + 0.2 * np.arange(6)
    to_nre = np.eye(4)
    to_nre[0, 3] = -100
    ahead = np.array([[0.0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 1.6], [0, 0, 0, 1]])
    pinhole = {"resolution": [1920, 1080], "focal_length": [1000.0, 1001.0], "principal_point": [960.0, 540.0]}
    return {
        "world_to_nre": {"matrix": to_nre.tolist()},
        "camera_calibrations": {
            "front@scene:1": {
                "logical_sensor_name": "front",
                "T_sensor_rig": ahead.tolist(),
                "camera_model": {"type": "opencv-pinhole", "parameters": {**pinhole, "radial_coeffs": [0.0] * 6}},
            },
            "wide@scene:1": {
                "logical_sensor_name": "wide",
                "T_sensor_rig": ahead.tolist(),
                "camera_model": {"type": "ftheta", "parameters": {"resolution": [1920, 1080]}},
            },
        },
        "rig_trajectories": [
            {
                "T_rig_world_timestamps_us": [START_US + 100_000 * k for k in range(6)],
                "T_rig_worlds": poses.tolist(),
            }
        ],
    }


STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World"
{
    def Volume "volume"
    {
        custom bool omni:nurec:isNuRecVolume = 1
        def OmniNuRecFieldAsset "density_field"
        {
            custom asset filePath = @./volume.nurec@
        }
        def OmniNuRecFieldAsset "emissive_color_field"
        {
            custom asset filePath = @./volume.nurec@
        }
    }
}
"""


def write_artifact(path: Path, **members: bytes | str | None) -> None:
    """Write a `.usdz` as AlpaSim's artifacts are; `members` replace files of it or, with None, leave them out."""
    files: dict[str, bytes | str | None] = {
        "default.usda": STAGE,
        "volume.nurec": volume(state()),
        "metadata.yaml": "scene_id: clipgt-1\n",
        "sequence_tracks.json": json.dumps(tracks()),
        "rig_trajectories.json": json.dumps(rig()),
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, content in (files | {key.replace("__", "."): value for key, value in members.items()}).items():
            if content is not None:
                archive.writestr(name, content)


def test_an_artifact_comes_back_with_its_car_its_rig_and_its_sky(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_artifact(tmp_path / "a.usdz")
    with caplog.at_level(logging.WARNING, "gsrain"):
        scene = read_scene(tmp_path / "a.usdz")
    assert "cameras with lenses are left out: wide" in caplog.text
    assert scene.name == "clipgt-1" and [(each.name, each.kind) for each in scene.layers] == [
        ("background", "background"),
        ("sky", "sky"),
    ]
    (car,) = scene.actors
    assert (car.id, car.class_name) == ("7", "car") and car.size_lwh == pytest.approx((LENGTH, WIDTH, HEIGHT))
    assert car.pose_at(0.15) is not None and car.pose_at(0.45) is None
    expected = street()
    np.testing.assert_allclose(car.pose_at(0.25), expected.actors[0].pose_at(0.25), atol=1e-5)
    assert_same_picture(scene, expected, (0.1, 0.25, 0.5), least_db=40)  # half floats
    # The map's axes are right, up, back: -y, z and -x of the scene's.
    found = colors_towards(scene, (0, -1, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (-1, 0, 0), (1, 0, 0))
    np.testing.assert_allclose(found, FACES, atol=2e-3)
    (front,) = scene.rigs["recorded"]
    ego = scene.ego_to_world(0.5)
    assert ego is not None and (front.name, front.fx, front.fy) == ("front", 1000, 1001)
    np.testing.assert_allclose((ego @ front.camera_to_ego)[:3, 3], [1.0 + 1.5, 0, 1.6], atol=1e-6)
    np.testing.assert_allclose((ego @ front.camera_to_ego)[:3, 2], [1, 0, 0], atol=1e-9)
    assert scene.ground_m == 0


def test_a_checkpoint_stands_in_for_a_volume_that_is_missing(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    torch.save({"state_dict": {f"model.{key}": value for key, value in state().items()}, "epoch": 3}, buffer)
    summary = {"sequence_tracks_dynamic": tracks(), "rig_trajectories": rig()}
    write_artifact(
        tmp_path / "a.usdz",
        default__usda='#usda 1.0\n(\n    upAxis = "Z"\n)\ndef Xform "World"\n{\n}\n',
        volume__nurec=None,
        sequence_tracks__json=None,
        rig_trajectories__json=None,
        checkpoint__ckpt=buffer.getvalue(),
        datasource_summary__json=json.dumps(summary),
    )
    scene = read_scene(tmp_path / "a.usdz")
    assert [actor.id for actor in scene.actors] == ["7"] and scene.ego is not None
    assert_same_picture(scene, street(), (0.25,))


def test_a_volume_alone_has_hidden_road_users(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "a.nurec").write_bytes(volume(state()))
    with caplog.at_level(logging.WARNING, "gsrain"):
        scene = read_scene(tmp_path / "a.nurec")
    assert "1 road users have no track" in caplog.text
    assert [(actor.id, actor.visible) for actor in scene.actors] == [("7", False)]
    assert_same_picture(scene, without_car(street()), least_db=40)


def test_a_volume_is_placed_as_its_stage_says(tmp_path: Path) -> None:
    turned = STAGE.replace('custom bool', """matrix4d xformOp:transform = ((0,1,0,0),(-1,0,0,0),(0,0,1,0),(5,6,7,1))
        uniform token[] xformOpOrder = ["xformOp:transform"]
        custom bool""")  # fmt: skip
    write_artifact(tmp_path / "a.usdz", default__usda=turned)
    scene, turn = read_scene(tmp_path / "a.usdz"), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    car, before = scene.actors[0].pose_at(0.2), street().actors[0].pose_at(0.2)
    assert car is not None and before is not None
    np.testing.assert_allclose(car[:3, 3], turn @ before[:3, 3] + [5, 6, 7], atol=1e-5)
    np.testing.assert_allclose(scene.layers[0].to_scene[:3, :3], turn, atol=1e-9)


def _changed(name: str, change: Any, part: str = "dynamic_rigids") -> bytes:
    values = state()
    key = f"gaussians_nodes.{part}.{name}"
    values[key] = change(values[key])
    return volume(values)


@pytest.mark.parametrize(
    "make",
    [
        lambda: b"",
        lambda: b"no gzip",
        lambda: gzip.compress(b"no MessagePack"),
        lambda: gzip.compress(msgspec.msgpack.encode([1, 2])),
        lambda: gzip.compress(msgspec.msgpack.encode({"nre_data": {}})),
        lambda: gzip.compress(msgspec.msgpack.encode({"nre_data": {"state_dict": {}}})),
        lambda: gzip.compress(b"\x91" * 5000),
        lambda: gzip.compress(bytes(400_000_000)),
        lambda: volume(state())[:-100],
        lambda: volume({"gaussians_nodes.background.positions": torch.zeros(4, 3)}),
        lambda: _changed("positions", lambda each: each[:-1]),
        lambda: _changed("positions", lambda each: each * torch.nan),
        lambda: _changed("positions", lambda _: "positions"),
        lambda: _changed("rotations", lambda each: each * 0),
        lambda: _changed("scales", lambda each: each.repeat(1, 2)),
        lambda: _changed("densities", lambda each: each[:7]),
        lambda: _changed("features_albedo", lambda each: each[:, :, :2]),
        lambda: _changed("features_specular", lambda each: each[:, :10]),
        lambda: _changed("gaussian_cuboid_ids", lambda each: each[:3]),
        lambda: volume({**state(), "background.textures": torch.zeros(1, 5, 8, 8, 3)}),
        lambda: volume({**state(), "background.textures": torch.full((1, 6, 8, 8, 3), torch.nan)}),
        lambda: volume({**state(), "_extra_state": {"obj_track_ids": {"dynamic_rigids": 3}}}),
    ],
)
def test_damaged_volumes_are_refused_in_one_sentence(tmp_path: Path, make: Callable[[], bytes]) -> None:
    (tmp_path / "a.nurec").write_bytes(make())
    with pytest.raises(SceneFormatError) as caught:
        read_scene(tmp_path / "a.nurec")
    assert str(caught.value).startswith(f"{tmp_path / 'a.nurec'}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("volume.nurec", b"no gzip"),
        ("sequence_tracks.json", "{"),
        ("sequence_tracks.json", '{"a": {"tracks_data": {"tracks_id": ["1"]}}}'),
        ("sequence_tracks.json", json.dumps(tracks()).replace("0.0, 1.0]", "1.0]", 1)),
        ("rig_trajectories.json", "[]"),
        ("rig_trajectories.json", json.dumps(rig()).replace('"T_sensor_rig"', '"T"')),
        ("rig_trajectories.json", json.dumps(rig()).replace('"T_rig_worlds": [[', '"T_rig_worlds": [[[0], ')),
        ("volume.nurec", None),
    ],
)
def test_damaged_artifacts_are_refused_in_one_sentence(tmp_path: Path, name: str, content: Any) -> None:
    write_artifact(tmp_path / "a.usdz", **{name.replace(".", "__"): content})
    with pytest.raises(SceneFormatError) as caught:
        read_scene(tmp_path / "a.usdz")
    assert str(caught.value).startswith(f"{tmp_path / 'a.usdz'}: ") and "\n" not in str(caught.value)
