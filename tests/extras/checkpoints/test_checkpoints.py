"""Checkpoints of trainings: read back as the scene that was written, in place, size, time and color; damaged ones."""

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from app.main import run
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene
from trained_street import (
    CAR,
    FACES,
    HEIGHT,
    LENGTH,
    WIDTH,
    assert_same_picture,
    colors_towards,
    raw,
    street,
    without_car,
)

from .written import (
    SMALL,
    drivestudio_state,
    drivestudio_tensors,
    write_3dgs,
    write_drivestudio,
    write_gsplat,
    write_mtgs,
    write_splatfacto,
)


def test_a_scene_of_drivestudio_comes_back_with_its_car_and_its_sky(tmp_path: Path) -> None:
    folder = tmp_path / "omnire_23"
    folder.mkdir()
    write_drivestudio(folder / "checkpoint_final.pth")
    scene, expected = read_scene(folder / "checkpoint_final.pth"), street()
    assert scene.name == "omnire_23" and [(each.name, each.kind) for each in scene.layers] == [
        ("background", "background"),
        ("sky", "sky"),
    ]
    (car,) = scene.actors
    assert (car.id, car.class_name) == (CAR, "car") and car.size_lwh == pytest.approx((LENGTH, WIDTH, HEIGHT))
    assert scene.up == (0, 0, 1) and not scene.up_is_assumed and not scene.unit_is_assumed
    for time_s, there in ((0.0, True), (0.15, True), (0.4, False), (0.5, False)):
        pose, before = car.pose_at(time_s), expected.actors[0].pose_at(time_s)
        assert (pose is not None) == there
        if pose is not None and before is not None:
            np.testing.assert_allclose(pose, before, atol=1e-6)
    assert_same_picture(scene, expected, (0.0, 0.25, 0.5))
    # The map's axes are x, z, -y of the scene's: overhead is +y, ahead (y) is -z.
    found = colors_towards(scene, (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0, -1, 0), (0, 1, 0))
    np.testing.assert_allclose(found, FACES, atol=1e-3)


def test_its_settings_have_the_rate_and_the_direction_up(tmp_path: Path) -> None:
    state = drivestudio_state(street())
    torch.save(state, tmp_path / "checkpoint_final.pth")
    (tmp_path / "config.yaml").write_text("data:\n  dataset: waymo\nrender:\n  fps: 5\n  render_novel:\n    fps: 24\n")
    (car,) = read_scene(tmp_path / "checkpoint_final.pth").actors
    np.testing.assert_allclose(car.track.times, street().actors[0].track.times * 2)
    del state["models"]["RigidNodes"]
    torch.save(state, tmp_path / "checkpoint_final.pth")
    assert not read_scene(tmp_path / "checkpoint_final.pth").up_is_assumed
    (tmp_path / "config.yaml").write_text("data:\n  dataset: nuscenes\n")
    assert read_scene(tmp_path / "checkpoint_final.pth").up == (0, -1, 0)
    (tmp_path / "config.yaml").write_text("{")
    assert read_scene(tmp_path / "checkpoint_final.pth").up_is_assumed


def test_people_stand_on_their_track_in_one_pose(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """In SMPL's axes a person stands along y and looks along z; its pelvis turns, and then all of it is moved."""
    state = drivestudio_state(street())
    body = street().actors[0].gaussians
    means = np.random.default_rng(5).uniform(-0.5, 0.5, (200, 3)) * (0.6, 1.7, 0.3) + (0, -0.25, 0)
    body.means[:] = means
    turns = torch.tensor([0.5, 0.5, 0.5, 0.5]).repeat(6, 1, 1, 1)  # x, y, z to y, z, x: upright, looking along x
    pelvis = np.array([-0.0018, -0.2233, 0.0282])
    low, high = body.means.min(axis=0), body.means.max(axis=0)
    center = np.roll((low + high) / 2 - pelvis, 1) + pelvis
    moved = torch.as_tensor(np.array([12.0, 2.0, (high - low)[1] / 2]) - center).float()
    state["models"] = {
        "SMPLNodes": {
            **drivestudio_tensors(body),
            "points_ids": torch.zeros(200, 1, dtype=torch.long),
            "instances_size": torch.tensor([[0.5, 0.6, 1.7]]),
            "instances_fv": torch.ones(6, 1, dtype=torch.bool),
            "instances_quats": turns,
            "instances_trans": moved.repeat(6, 1, 1),
            "smpl_qauts": torch.zeros(6, 1, 23, 4),
        }
    }
    torch.save(state, tmp_path / "checkpoint_final.pth")
    with caplog.at_level(logging.WARNING, "gsrain"):
        (person,) = read_scene(tmp_path / "checkpoint_final.pth").actors
    assert "people keep one pose (1)" in caplog.text
    pose = person.pose_at(0.2)
    assert pose is not None and person.class_name == "pedestrian"
    np.testing.assert_allclose(pose[:3, :3], np.eye(3), atol=1e-6)
    assert person.size_lwh == pytest.approx((0.3, 0.6, 1.7), abs=0.05)
    np.testing.assert_allclose(pose[:3, 3], [12.0, 2.0, 0.0], atol=1e-5)
    assert 0 <= person.gaussians.means[:, 2].min() < 0.02


def test_objects_of_street_gaussians_are_hidden_as_their_tracks_are_elsewhere(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    SMALL["street_gaussians.pth"](tmp_path / "iteration_30000.pth")
    with caplog.at_level(logging.WARNING, "gsrain"):
        scene = read_scene(tmp_path / "iteration_30000.pth")
    assert "the tracks of 1 objects are not in it" in caplog.text
    (car,), expected = scene.actors, street()
    assert (car.id, car.visible) == ("obj_007", False) and scene.name == tmp_path.name
    np.testing.assert_allclose(car.gaussians.means[:, :2], expected.actors[0].gaussians.means[:, :2], atol=1e-6)
    assert car.gaussians.means[:, 2].min() == pytest.approx(0, abs=1e-6)
    np.testing.assert_array_equal(car.gaussians.sh, expected.actors[0].gaussians.sh)  # the mean over time
    assert_same_picture(scene, without_car(expected))
    np.testing.assert_allclose(colors_towards(scene, (0, 0, 1), (1, 0, 0), (0, -1, 0)), FACES[[4, 0, 3]], atol=1e-3)


def test_splatfacto_returns_to_the_coordinates_of_its_capture(tmp_path: Path) -> None:
    """The data parser's transform turns, moves and scales what was captured; the file next to it undoes that."""
    models = tmp_path / "splatfacto" / "2026-01-01" / "nerfstudio_models"
    models.mkdir(parents=True)
    write_splatfacto(models / "step-000029999.ckpt")
    alone = read_scene(models / "step-000029999.ckpt")
    assert alone.name == "2026-01-01" and alone.up == (0, 0, 1) and alone.up_is_assumed
    assert_same_picture(alone, without_car(street()))

    turn, shift, scale = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0.5, -1.0, 2.0]), 0.25
    transforms = {"transform": np.column_stack([turn, shift]).tolist(), "scale": scale}
    (models.parent / "dataparser_transforms.json").write_text(json.dumps(transforms))
    (models.parent / "config.yml").write_text("!!python/object:x\nmodel:\n  rasterize_mode: antialiased\n")
    scene = read_scene(models / "step-000029999.ckpt")
    (layer,) = scene.layers
    assert layer.gaussians.antialiased and scene.up == pytest.approx((0, 1, 0)) and not scene.up_is_assumed
    captured = layer.gaussians.means.astype(float) @ layer.to_scene[:3, :3].T + layer.to_scene[:3, 3]
    np.testing.assert_allclose(scale * (captured @ turn.T + shift), layer.gaussians.means, atol=1e-5)
    (models.parent / "dataparser_transforms.json").write_text('{"transform": [[0, 0, 0, 0]], "scale": 1}')
    with pytest.raises(SceneFormatError, match="no transform of a data parser"):
        read_scene(models / "step-000029999.ckpt")


def test_mtgs_has_the_mean_of_its_drives_and_the_car_where_it_is_present(tmp_path: Path) -> None:
    write_mtgs(tmp_path / "step-000029999.ckpt")
    scene, expected = read_scene(tmp_path / "step-000029999.ckpt"), street()
    (car,) = scene.actors
    assert (car.id, car.class_name) == ("rigid_object_a1b2", "car")
    assert car.size_lwh == pytest.approx((LENGTH, WIDTH, HEIGHT), rel=0.03)
    assert car.pose_at(0.0) is not None and car.pose_at(0.45) is None
    assert_same_picture(scene, expected, (0.0, 0.25, 0.5))


def test_gsplat_joins_the_files_of_its_gpus(tmp_path: Path) -> None:
    folder = tmp_path / "garden" / "ckpts"
    folder.mkdir(parents=True)
    write_gsplat(folder / "whole.pt")
    gaussians = street().layers[0].gaussians
    for rank, rows in enumerate((slice(0, 300), slice(300, None))):
        torch.save({"step": 9, "splats": raw(gaussians.take(rows))}, folder / f"ckpt_29999_rank{rank}.pt")
    scene = read_scene(folder / "ckpt_29999_rank0.pt")
    assert scene.name == "garden" and scene.up_is_assumed and scene.up == (0, 0, 1)
    for each in (scene, read_scene(folder / "whole.pt")):
        assert_same_picture(each, without_car(street()))


def test_3dgs_has_minus_y_up(tmp_path: Path) -> None:
    write_3dgs(tmp_path / "chkpnt30000.pth")
    scene = read_scene(tmp_path / "chkpnt30000.pth")
    assert scene.up == (0, -1, 0) and scene.up_is_assumed
    np.testing.assert_allclose(scene.layers[0].gaussians.sh, street().layers[0].gaussians.sh)


def test_a_filter_of_mip_splatting_and_flat_gaussians_are_applied(tmp_path: Path) -> None:
    each = raw(street().layers[0].gaussians)
    filters = torch.full((len(each["means"]), 1), 0.05)
    torch.save({"step": 1, "splats": {**each, "filter_3D": filters}}, tmp_path / "mip.pt")
    torch.save({"step": 1, "splats": {**each, "scales": each["scales"][:, :2]}}, tmp_path / "flat.pt")
    plain = street().layers[0].gaussians
    mip, flat = (read_scene(tmp_path / name).layers[0].gaussians for name in ("mip.pt", "flat.pt"))
    np.testing.assert_allclose(mip.scales, np.sqrt(plain.scales**2 + 0.05**2), rtol=1e-5)
    assert (mip.opacities <= plain.opacities + 1e-6).all()
    np.testing.assert_allclose(flat.scales[:, :2], plain.scales[:, :2], rtol=1e-6)
    assert not flat.scales[:, 2].any()


@pytest.mark.parametrize("to", ["scene", "scene.ply", "scene.spz"])
def test_a_checkpoint_is_converted(tmp_path: Path, to: str) -> None:
    write_drivestudio(tmp_path / "a.pth")
    assert run(["convert", str(tmp_path / "a.pth"), str(tmp_path / to)]) == 0
    found = read_scene(tmp_path / to)
    assert found.gaussian_count > 900 and (len(found.actors) == 1) == (to == "scene")


# Damage


def _changed(name: str, change: Any) -> Any:
    """A change of one tensor of the car, or a new one."""

    def damage(state: dict[str, Any]) -> Any:
        state["models"]["RigidNodes"][name] = change(state["models"]["RigidNodes"].get(name))
        return state

    return damage


class _Malicious:
    def __reduce__(self) -> Any:
        return print, ("this ran",)


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: _Malicious(),
        lambda _: {},
        lambda _: [1, 2, 3],
        lambda _: {"models": 3},
        lambda _: {"models": {"Background": {}}},
        lambda _: {"model_state": {"conv.weight": torch.zeros(3)}},
        _changed("_means", lambda each: each[:-1]),
        _changed("_means", lambda each: each * torch.nan),
        _changed("_means", lambda _: "means"),
        _changed("_means", lambda _: torch.zeros(1, 3).expand(50_000_000, 3)),
        _changed("_scales", lambda each: each.repeat(1, 2)),
        _changed("_quats", lambda each: each * 0),
        _changed("_features_rest", lambda each: each[:, :5]),
        _changed("_opacities", lambda each: each.repeat(1, 2)),
        _changed("points_ids", lambda each: each + 5),
        _changed("points_ids", lambda each: each[:-1]),
        _changed("instances_fv", lambda each: each[:2]),
        _changed("instances_trans", lambda each: each * torch.inf),
        _changed("instances_quats", lambda each: each * 0),
        _changed("instances_size", lambda each: each[:1]),
        _changed("_velocity", lambda _: torch.zeros(3)),
        lambda state: {"models": {**state["models"], "Sky": {"base": torch.zeros(5, 8, 8, 3)}}},
        lambda state: {"models": {**state["models"], "Sky": {"base": torch.full((6, 8, 8, 3), torch.nan)}}},
    ],
)
def test_damaged_checkpoints_are_refused_in_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Any
) -> None:
    path = tmp_path / "a.pth"
    torch.save(damage(drivestudio_state(street())), path)
    with pytest.raises(SceneFormatError) as caught:
        read_scene(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    assert "this ran" not in capsys.readouterr().out


def test_a_network_is_no_scene_and_says_what_it_holds(tmp_path: Path) -> None:
    torch.save({"state_dict": {}, "epoch": 3}, tmp_path / "uniad.pth")
    with pytest.raises(SceneFormatError, match=r"it holds state_dict, epoch\. Export its Gaussians as a PLY"):
        read_scene(tmp_path / "uniad.pth")
    torch.save({"splats": {**raw(street().layers[0].gaussians), "features": torch.zeros(3)}}, tmp_path / "app.pt")
    state = torch.load(tmp_path / "app.pt", weights_only=True)
    del state["splats"]["sh0"]
    torch.save(state, tmp_path / "app.pt")
    with pytest.raises(SceneFormatError, match="features of a network"):
        read_scene(tmp_path / "app.pt")
