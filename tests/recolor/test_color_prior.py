"""Inputs and files of a recoloring: maps of colors, ground pixels, harmonics by name."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.recolor.problem import fit_color_prior
from gsrain_engine.recolor.result import read_recolored, write_recolored
from gsrain_engine.recolor.views import ground_height_m, ground_share
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.files import SceneFormatError
from gsrain_engine.scene.gaussians import SH_C0, sh_from_color
from gsrain_engine.scene.scene import Scene
from training.small_street import small_street

MATRIX = np.array([[0.6, 0.1, 0.0], [0.05, 0.6, 0.0], [0.0, 0.1, 0.7]])


OFFSET = np.array([0.02, 0.05, 0.1])


def pixels(count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    clear = np.random.default_rng(0).uniform(0, 1, (count, 3)).astype(np.float32)
    return clear, (clear @ MATRIX.T + OFFSET).astype(np.float32)


def test_an_affine_change_is_found_again_and_applied_to_harmonics():
    clear, changed = pixels()
    shares = np.tile(np.array([0, 1, 0], np.float32), (len(clear), 1))
    change = fit_color_prior(*([each[:1000], each[1000:]] for each in (clear, changed, shares)))
    colors = np.array([[0.2, 0.5, 0.9], [0.0, 1.0, 0.3]], np.float32)
    sh = np.concatenate([sh_from_color(colors), np.full((2, 3, 3), 0.1, np.float32)], axis=1)
    moved = change.of_sh(sh, shares[:2])
    np.testing.assert_allclose(0.5 + SH_C0 * moved[:, 0], colors @ MATRIX.T + OFFSET, atol=0.01)
    np.testing.assert_allclose(moved[:, 1:], np.broadcast_to(MATRIX.sum(axis=1) * 0.1, (2, 3, 3)), atol=0.01)


# Ground

CAMERA = Camera.from_fov(60, 48, 60, look_at(np.array([0, 0, 1.5]), np.array([1.0, 0, 1.4]), np.array([0.0, 0, 1])))


FLAT = np.zeros((48, 60), np.float32)


def test_ground_is_what_the_scene_says_or_what_lies_low():
    scene = small_street()
    assert ground_height_m(replace(scene, ground_m=-2.0)) == -2
    assert ground_height_m(replace(scene, ground_m=None)) == pytest.approx(0, abs=0.01)
    assert ground_height_m(Scene("empty")) == 0


def test_only_what_is_low_and_faces_up_is_ground():
    depth = FLAT + np.float32(4)  # at the lower edge, 35 degrees down, that is 2.9 m below the eye
    assert ground_share(depth, FLAT + 1, CAMERA, -1.4)[-1, 30] > 0.9
    assert ground_share(depth, FLAT + 1, CAMERA, -3.0)[-1, 30] == 0
    assert not ground_share(FLAT, FLAT + 1, CAMERA, -1.4).any()
    assert not ground_share(depth, FLAT + np.float32(0.5), CAMERA, -1.4).any()


# File


def test_recolored_files_go_and_come_back_with_any_name(tmp_path):
    sh = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    names = ["layers/../odd name", "actors/käfer", "layers/names"]
    write_recolored(tmp_path / "sub" / "a.npz", {name: sh + i for i, name in enumerate(names)})
    back = read_recolored(tmp_path / "sub" / "a.npz")
    assert list(back) == names
    np.testing.assert_array_equal(back["layers/names"], sh + 2)
    assert [each.name for each in (tmp_path / "sub").iterdir()] == ["a.npz"]


GOOD = {"version": np.array(1), "names": np.array(["layers/x"]), "sh_0": np.zeros((2, 4, 3), np.float32)}


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "recolored"), (b"no zip at all", "recolored"), (b"PK\x03\x04 truncated", "recolored"),
        (GOOD | {"sh_0": np.zeros(3)}, "layers/x"), (GOOD | {"version": np.array(9)}, "version 9"),
        ({"version": np.array(1), "names": GOOD["names"]}, "recolored"),
    ],
)  # fmt: skip
def test_other_files_are_refused_with_their_name(tmp_path, content, reason):
    path = tmp_path / "bad.npz"
    path.write_bytes(content) if isinstance(content, bytes) else np.savez(path, **content)
    with pytest.raises(SceneFormatError, match=rf"bad\.npz.*{reason}"):
        read_recolored(path)
