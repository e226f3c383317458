"""Scenes of SplatSim: round trips, the layout as its documentation has it, version 2, skies and damage."""

import io
import json
import logging
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from app.main import run
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene, write_scene
from gsrain_engine.scene.formats.registry import lost_in_file
from gsrain_engine.scene.scene import Scene
from small_scene import small_scene
from trained_street import CAR, HEIGHT, LENGTH, WIDTH, assert_same_picture, colors_towards, street


def driven_street() -> Scene:
    """The street with its car, and the drive and the camera of the small scene."""
    scene, small = street(), small_scene()
    return Scene(scene.name, scene.layers, scene.actors, rigs=small.rigs, ego=small.ego, ground_m=0.0)


def contents(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        assert all(each.compress_type == zipfile.ZIP_STORED for each in archive.infolist())
        return {name: archive.read(name) for name in archive.namelist()}


def rewritten(path: Path, files: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    write_scene(driven_street(), tmp_path / "a.splatsim.usdz")
    return tmp_path / "a.splatsim.usdz"


def test_a_scene_comes_back_with_its_car_and_its_drive(written: Path, tmp_path: Path) -> None:
    write_scene(driven_street(), tmp_path / "b.splatsim.usdz")
    assert written.read_bytes() == (tmp_path / "b.splatsim.usdz").read_bytes()
    scene, expected = read_scene(written), driven_street()
    assert scene.name == "street" and scene.up == (0, 0, 1) and not scene.unit_is_assumed
    (car,) = scene.actors
    assert (car.id, car.class_name) == (CAR, "car") and car.size_lwh == pytest.approx((LENGTH, WIDTH, HEIGHT))
    np.testing.assert_allclose(car.pose_at(0.25), expected.actors[0].pose_at(0.25), atol=1e-6)
    assert car.pose_at(0.45) is None
    assert_same_picture(scene, expected, (0.1, 0.25), least_db=35)  # SPZ has steps of 1/16 of a logarithm, and bytes
    for time_s in (0.0, 2.3):
        np.testing.assert_allclose(scene.ego_to_world(time_s), expected.ego_to_world(time_s), atol=1e-6)
    (before,), (after,) = expected.rigs["one"], scene.rigs["ego"]
    np.testing.assert_allclose(after.camera_to_ego, before.camera_to_ego, atol=1e-9)
    assert (after.name, after.width, after.fx, after.cy) == ("FRONT", 960, 800.0, 320.0)


def test_a_usdz_of_any_name_is_read_as_such_a_scene(written: Path, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    assert len(read_scene(written.rename(tmp_path / "scene.usdz")).actors) == 1


def test_its_files_are_those_of_the_documentation(written: Path) -> None:
    files = contents(written)
    index = json.loads(files["scene.json"])
    assert index["schema"] == "splatsim.scene/v3" and index["gaussians"]["frame"] == "world"
    assert index["extras"] == {
        "sequence_tracks": "sequence_tracks.json",
        "actor_assets": "actor_assets.json",
        "rig_trajectories": "rig_trajectories.json",
    }
    listed = index["gaussians"]["chunks"]
    assert sum(each["n_points"] for each in listed) == index["gaussians"]["n_gaussians"] == 700
    assert all(
        np.array(each["bbox_min"]) @ [1, 0, 0] // 50 == np.array(each["bbox_max"]) @ [1, 0, 0] // 50 for each in listed
    )
    card = json.loads(files["metadata.yaml"])
    assert card["scene_id"] == "street" and all(isinstance(card[key], str) for key in ("uuid", "version_string"))
    tracks, bank, rigs = (
        json.loads(files[name]) for name in ("sequence_tracks.json", "actor_assets.json", "rig_trajectories.json")
    )
    assert [each["schema"] for each in (tracks, bank, rigs)] == [
        "splatsim.sequence_tracks/v2",
        "splatsim.actor_assets/v1",
        "splatsim.rig_trajectories/v2",
    ]
    assert tracks["frame_convention"] == rigs["frame_convention"] == index["world"]["frame_convention"]
    (track,), (asset,), (instance,) = tracks["tracks"], bank["assets"], bank["instances"]
    assert (
        (instance["track_id"], instance["asset_id"]) == (track["track_id"], asset["asset_id"]) == (CAR, "a000-" + CAR)
    )
    assert asset["uri"] == f"actor_assets/a000-{CAR}/asset.spz" and asset["motion"] == "rigid"
    low, high = np.array(asset["bbox_min"]), np.array(asset["bbox_max"])
    assert (low < 0).all() and (high > 0).all()  # the origin is the center of the box
    first = track["frames"][0]
    assert first["translation"][2] == pytest.approx(HEIGHT / 2) and np.linalg.norm(first["rotation"]) == pytest.approx(
        1
    )
    (rig,) = rigs["rigs"]
    assert [pose["translation"][2] for pose in rig["poses"]] == pytest.approx([0.0] * 6)  # on the ground
    assert rig["cameras"][0]["camera_model"]["type"] == "pinhole"
    assert rig["cameras"][0]["sensor_in_rig"]["translation"] == pytest.approx([0, 0, 1.5])


def test_version_2_lists_no_chunks(written: Path) -> None:
    files = contents(written)
    index = json.loads(files["scene.json"])
    index["schema"] = "splatsim.scene/v2"
    del index["gaussians"]["chunks"]
    rewritten(written, {**files, "scene.json": json.dumps(index).encode(), "chunks/chunk_000000.lidar": b"x"})
    assert len(read_scene(written).layers[0].gaussians) == 700


def test_the_sky_is_that_of_the_panorama(written: Path) -> None:
    """Red ahead, in the middle; green on the left, a quarter before it; blue overhead."""
    picture = np.full((180, 360, 3), 128, np.uint8)
    picture[80:100, 170:190], picture[80:100, 80:100], picture[:10] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    png = io.BytesIO()
    Image.fromarray(picture).save(png, "PNG")
    rewritten(written, {**contents(written), "skybox.png": png.getvalue()})
    scene = read_scene(written)
    found = colors_towards(scene, (1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0))
    np.testing.assert_allclose(found, np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0.5]]), atol=0.01)


def test_assets_are_fitted_and_tracks_without_one_are_left_out(written: Path, caplog: pytest.LogCaptureFixture) -> None:
    files = contents(written)
    tracks, bank = json.loads(files["sequence_tracks.json"]), json.loads(files["actor_assets.json"])
    tracks["tracks"] += [{**tracks["tracks"][0], "track_id": "large", "size": [8.0, 3.6, 3.0]}]
    tracks["tracks"] += [{**tracks["tracks"][0], "track_id": "bare"}]
    bank["instances"] += [{**bank["instances"][0], "track_id": "large", "fit_mode": "uniform"}]
    rewritten(
        written,
        {**files, "sequence_tracks.json": json.dumps(tracks).encode(), "actor_assets.json": json.dumps(bank).encode()},
    )
    with caplog.at_level(logging.WARNING, "gsrain"):
        own, large = read_scene(written).actors
    assert "1 tracks have no Gaussians" in caplog.text
    assert large.size_lwh == pytest.approx((8, 3.6, 3)) and own.size_lwh == pytest.approx((4, 1.8, 1.5))
    np.testing.assert_allclose(large.gaussians.means, 2 * own.gaussians.means, atol=1e-4)


def test_what_it_leaves_out_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lost = lost_in_file(small_scene(), tmp_path / "a.splatsim.usdz")
    assert lost == ["the division into 3 layers", "which layer is the sky"]
    write_scene(street(), tmp_path / "scene")
    assert run(["convert", str(tmp_path / "scene"), str(tmp_path / "b.splatsim.usdz")]) == 0
    nothing = Scene("nothing", actors=street().actors)
    with pytest.raises(SceneFormatError, match="at least one visible layer"):
        write_scene(nothing, tmp_path / "c.splatsim.usdz")
    assert not (tmp_path / "c.splatsim.usdz").exists()


def _json(name: str, change: Callable[[Any], object]) -> Callable[[dict[str, bytes]], None]:
    def damage(files: dict[str, bytes]) -> None:
        values = json.loads(files[name])
        change(values)
        files[name] = json.dumps(values).encode()

    return damage


def _bytes(name: str, content: bytes | None) -> Callable[[dict[str, bytes]], None]:
    def damage(files: dict[str, bytes]) -> None:
        if content is None:
            del files[name]
        else:
            files[name] = content

    return damage


ASSET = f"actor_assets/a000-{CAR}/asset.spz"


@pytest.mark.parametrize(
    "damage",
    [
        _json("scene.json", lambda each: each.update(schema="splatsim.scene/v1")),
        _json("scene.json", lambda each: each.update(schema="splatsim.scene/v9")),
        _json("scene.json", lambda each: each.update(gaussians=3)),
        _json("scene.json", lambda each: each["gaussians"].update(chunks=[])),
        _json("scene.json", lambda each: each["gaussians"]["chunks"][0].update(uri="../x.spz")),
        _json("scene.json", lambda each: each["gaussians"]["chunks"][0].pop("uri")),
        _bytes("scene.json", b"{"),
        _bytes("chunks/chunk_000000.spz", b"NGSP"),
        _bytes("chunks/chunk_000000.spz", None),
        _bytes("sequence_tracks.json", b"{"),
        _json("sequence_tracks.json", lambda each: each["tracks"][0].update(size=[1, 2])),
        _json("sequence_tracks.json", lambda each: each["tracks"][0]["frames"][0].update(rotation=[0, 0, 0])),
        _json("sequence_tracks.json", lambda each: each["tracks"][0]["frames"][0].update(rotation=[0, 0, 0, 0])),
        _json("sequence_tracks.json", lambda each: each["tracks"][0]["frames"][1].update(timestamp_us=0)),
        _json("actor_assets.json", lambda each: each["assets"][0].update(uri="nowhere.spz")),
        _json("actor_assets.json", lambda each: each["assets"][0].update(size=[0, 0])),
        _json("actor_assets.json", lambda each: each.update(assets={})),
        _bytes(ASSET, b""),
        _bytes(ASSET, None),
        _bytes("rig_trajectories.json", b"[]"),
        _json(
            "rig_trajectories.json", lambda each: each["rigs"][0]["cameras"][0].update(camera_model={"type": "pinhole"})
        ),
        _json("rig_trajectories.json", lambda each: each["rigs"][0]["poses"][0].update(translation=["a", 0, 0])),
        _bytes("skybox.png", b"no picture"),
    ],
)
def test_damaged_scenes_are_refused_in_one_sentence(written: Path, damage: Callable[[dict[str, bytes]], None]) -> None:
    files = contents(written)
    damage(files)
    rewritten(written, files)
    with pytest.raises(SceneFormatError) as caught:
        read_scene(written)
    assert str(caught.value).startswith(f"{written}: ") and "\n" not in str(caught.value)
