"""Inputs and files of a recoloring: maps of colors, ground pixels, harmonics by name."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.recolor.problem import fit_color_prior
from gsrain_engine.recolor.result import read_recolored, write_recolored
from gsrain_engine.recolor.views import ground_height_m, ground_share
from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import SH_C0, sh_from_color
from gsrain_engine.scene.scene import Scene
from training.small_street import small_street

MATRIX = np.array([[0.6, 0.1, 0.0], [0.05, 0.6, 0.0], [0.0, 0.1, 0.7]])
OFFSET = np.array([0.02, 0.05, 0.1])


def test_an_affine_change_is_found_again_and_applied_to_harmonics():
    clear = np.random.default_rng(0).uniform(0, 1, (4000, 3)).astype(np.float32)
    changed = (clear @ MATRIX.T + OFFSET).astype(np.float32)
    shares = np.tile(np.array([0, 1, 0], np.float32), (len(clear), 1))
    change = fit_color_prior(*([each[:1000], each[1000:]] for each in (clear, changed, shares)))
    sh = np.concatenate([sh_from_color(clear[:2]), np.full((2, 3, 3), 0.1, np.float32)], axis=1)
    moved = change.of_sh(sh, shares[:2])
    np.testing.assert_allclose(0.5 + SH_C0 * moved[:, 0], changed[:2], atol=0.01)
    np.testing.assert_allclose(moved[:, 1:], np.broadcast_to(MATRIX.sum(axis=1) * 0.1, (2, 3, 3)), atol=0.01)


def test_ground_is_at_the_scenes_height_or_where_it_lies_low_and_faces_up():
    scene = small_street()
    for each, expected in (
        (replace(scene, ground_m=-2.0), -2),
        (replace(scene, ground_m=None), 0),
        (Scene("empty"), 0),
    ):
        assert ground_height_m(each) == pytest.approx(expected, abs=0.01)
    camera = Camera.from_fov(60, 48, 60, look_at(np.array([0, 0, 1.5]), np.array([1.0, 0, 1.4]), np.array([0.0, 0, 1])))
    level = np.ones((48, 60), np.float32)
    depth = 4 * level  # at the lower edge, 35 degrees down, that is 2.9 m below the eye
    assert ground_share(depth, level, camera, -1.4)[-1, 30] > 0.9
    assert ground_share(depth, level, camera, -3.0)[-1, 30] == 0
    assert not ground_share(0 * level, level, camera, -1.4).any()
    assert not ground_share(depth, np.float32(0.5) * level, camera, -1.4).any()


def test_recolored_files_come_back_with_any_name(tmp_path):
    colors = {
        name: np.full((2, 4, 3), i, np.float32)
        for i, name in enumerate(["layers/../odd name", "actors/käfer", "layers/names"])
    }
    write_recolored(tmp_path / "sub" / "a.npz", colors)
    back = read_recolored(tmp_path / "sub" / "a.npz")
    assert list(back) == list(colors) and all(np.array_equal(sh, colors[name]) for name, sh in back.items())
    assert [each.name for each in (tmp_path / "sub").iterdir()] == ["a.npz"]


GOOD = {"version": np.array(1), "names": np.array(["layers/x"]), "sh_0": np.zeros((2, 4, 3), np.float32)}


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", ""), (b"PK\x03\x04 truncated", ""), (GOOD | {"sh_0": np.zeros(3)}, "layers/x"),
        (GOOD | {"version": np.array(9)}, "version 9"), ({"version": np.array(1), "names": GOOD["names"]}, "sh_0"),
    ],
)  # fmt: skip
def test_other_files_are_refused_with_their_name(tmp_path, content, reason):
    path = tmp_path / "bad.npz"
    path.write_bytes(content) if isinstance(content, bytes) else np.savez(path, **content)
    with pytest.raises(SceneFormatError, match=rf"bad\.npz.*{reason}"):
        read_recolored(path)
