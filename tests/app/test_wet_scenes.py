"""Wet colors on the command line: told by info, baked by convert, blended by render."""

import json

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.transforms import blend_wet_sh
from small_scene import small_scene


def darker(scene):
    """Wet colors for the road and the wall."""
    for each in scene.layers[:2]:
        scene = scene.with_member(each.key, wet_sh=each.gaussians.sh - np.float32(0.6))
    return scene


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wet") / "project"
    write_scene(darker(small_scene()), folder)
    return folder


def mean(project, out, *options):
    size = ["--size", "64x48", "--backend", "cpu"]
    assert run(["render", str(project), "-o", str(out), *size, "--no-streaks", "--no-haze", *options]) == 0
    return np.asarray(Image.open(out)).mean()


def test_info_says_which_members_have_wet_colours(project, tmp_path, capsys):
    numbers = tmp_path / "info.json"
    assert run(["info", str(project), "--json", str(numbers)]) == 0
    rows = {row["name"]: row for row in json.loads(numbers.read_text())["members"]}
    assert {name: row["wet_colors"] for name, row in rows.items()} == {"road": True, "wall": True, "sky": False}
    per_gaussian = {name: row["memory_bytes"] / row["gaussians"] for name, row in rows.items()}
    assert per_gaussian == {"road": 68, "wall": 68, "sky": 56}
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[4] for line in lines if line.split()[0] in rows] == ["yes", "yes", "no"]


def test_convert_bakes_the_clear_colours_or_a_blend(project, tmp_path, capsys):
    scene = read_scene(project)
    clear = np.concatenate([each.gaussians.sh for each in scene.layers])
    wet = np.concatenate([each.gaussians.sh if each.wet_sh is None else each.wet_sh for each in scene.layers])
    for options, expected in (([], clear), (["--wetness", "0.25"], blend_wet_sh(clear, wet, 0.25))):
        assert run(["convert", str(project), str(tmp_path / "one.ply"), *options]) == 0
        np.testing.assert_allclose(read_scene(tmp_path / "one.ply").layers[0].gaussians.sh, expected, atol=1e-5)
    assert run(["convert", str(project), str(tmp_path / "both")]) == 0
    assert read_scene(tmp_path / "both").has_wet_colors
    assert run(["convert", str(project), str(tmp_path / "soaked"), "--wetness", "1"]) == 0
    soaked = read_scene(tmp_path / "soaked")
    assert not soaked.has_wet_colors
    np.testing.assert_array_equal(soaked.layers[0].gaussians.sh, scene.layers[0].wet_sh)


def test_render_gets_as_wet_as_it_rains_or_as_it_is_told(project, tmp_path, capsys):
    clear, wet = mean(project, tmp_path / "0.png"), mean(project, tmp_path / "12.png", "--rain", "12")
    assert wet < mean(project, tmp_path / "1.png", "--rain", "1.2") - 3 < clear - 6
    soaked = mean(project, tmp_path / "told.png", "--wetness", "1")
    assert soaked < wet < soaked + 5
    assert mean(project, tmp_path / "dry.png", "--rain", "12", "--wetness", "0") == pytest.approx(clear, abs=0.01)
    out = str(tmp_path / "x.png")
    assert run(["render", str(project), "-o", out, "--wetness", "2"]) == BAD_INPUT
    assert "wetness must be within 0..1" in capsys.readouterr().err
