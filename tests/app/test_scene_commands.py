"""`gsrain info`, `convert` and `street`."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.main import run
from colmap_files import write_binary, write_pictures
from datasets.sample_captures import views as capture_views
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.editor.files import load_document
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.transforms import blend_wet_sh, wet_sh_of
from small_scene import small_scene


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A file with the wall of the small scene: 400 Gaussians."""
    path = tmp_path_factory.mktemp("room") / "wall.ply"
    write_scene(replace(small_scene("wall"), layers=small_scene().layers[1:2], rigs={}, ego=None), path)
    return path


@pytest.fixture
def marked(tmp_path):
    """944 Gaussians: of the road's 400, 100 are deleted, and 50 of those and 30 others hidden."""
    scene = small_scene()
    numbers = np.arange(400)
    marks = SelectionFlags(deleted=BitMask.of(numbers < 100), hidden=BitMask.of((numbers >= 50) & (numbers < 130)))
    write_scene(replace(scene, layers=(replace(scene.layers[0], marks=marks), *scene.layers[1:])), tmp_path / "marked")
    return tmp_path / "marked"


@pytest.fixture
def wet(tmp_path):
    """Road and wall have wet colors."""
    scene = small_scene()
    for each in scene.layers[:2]:
        scene = scene.with_member(each.key, wet_sh=each.gaussians.sh - np.float32(0.6))
    write_scene(scene, tmp_path / "wet")
    return tmp_path / "wet"


def test_info_of_a_file_and_of_wet_colors(room, wet, reported, capsys):
    report = reported("info", room)
    assert report["gaussians"] == 400 and report["shell"] is None
    assert (report["members"][0]["minimum"], report["members"][0]["maximum"]) == ([40, -9, -12], [40, 0, 12])
    assert "400" in capsys.readouterr().out
    rows = {row["name"]: row for row in reported("info", wet)["members"]}
    assert {name: row["wet_colors"] for name, row in rows.items()} == {"road": True, "wall": True, "sky": False}
    per_gaussian = {name: row["memory_bytes"] / row["gaussians"] for name, row in rows.items()}
    assert per_gaussian == {"road": 68, "wall": 68, "sky": 56}
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[4] for line in lines if line.split()[0] in rows] == ["yes", "yes", "no"]


def test_info_and_convert_of_marked_gaussians(marked, tmp_path, reported, capsys):
    numbers = reported("info", marked)
    assert (numbers["gaussians"], numbers["deleted"], numbers["hidden"]) == (844, 100, 30)
    assert (numbers["members"][0]["gaussians"], numbers["members"][1]["deleted"]) == (300, 0)
    assert "small: 844 Gaussians (100 deleted, 30 hidden)" in capsys.readouterr().out
    assert reported("convert", marked, tmp_path / "visible.ply") == {"gaussians": 814, "left_out": 130}
    assert "814 Gaussians; 130 deleted or hidden ones are left out" in capsys.readouterr().out
    assert len(read_scene(tmp_path / "visible.ply").layers[0].gaussians) == 814
    assert reported("convert", marked, tmp_path / "copy") == {"gaussians": 844, "left_out": 0}
    assert "844 Gaussians (100 deleted, 30 hidden)" in capsys.readouterr().out
    assert read_scene(tmp_path / "copy").layers[0].marks.deleted.size == 100


def test_convert_sets_axis_and_unit(room, tmp_path):
    before = read_scene(room).layers[0].gaussians.means
    options = ["--up", "z", "--meters-per-unit", "2.5"]
    assert run(["convert", str(room), str(tmp_path / "folder"), *options]) == 0
    scene = read_scene(tmp_path / "folder")
    assert (scene.up, scene.metres_per_unit) == ((0.0, 0.0, 1.0), 2.5)
    np.testing.assert_array_equal(scene.layers[0].gaussians.means, before)
    assert run(["convert", str(room), str(tmp_path / "baked.ply"), *options]) == 0
    baked = read_scene(tmp_path / "baked.ply").layers[0].gaussians.means
    x, y, z = before.T  # what was up, z, is now where files have it: -y
    np.testing.assert_allclose(baked[:, 1], -2.5 * z, rtol=1e-5)
    np.testing.assert_allclose(np.hypot(baked[:, 0], baked[:, 2]), 2.5 * np.hypot(x, y), rtol=1e-5)


@pytest.mark.parametrize("suffix", [".splat", ".spz", ".ply", ""])
def test_convert_to_each_format(room, tmp_path, suffix, reported):
    target = tmp_path / f"wall2{suffix}"
    assert reported("convert", room, target) == {"gaussians": 400, "left_out": 0}
    before, after = (np.sort(read_scene(path).layers[0].gaussians.means, axis=0) for path in (room, target))
    np.testing.assert_allclose(after, before, atol=1e-2)


def test_convert_bakes_the_clear_colors_or_a_blend(wet, tmp_path):
    scene = read_scene(wet)
    clear = np.concatenate([each.gaussians.sh for each in scene.layers])
    soaked = np.concatenate([each.gaussians.sh if each.wet_sh is None else each.wet_sh for each in scene.layers])
    for options, expected in (([], clear), (["--wetness", "0.25"], blend_wet_sh(clear, soaked, 0.25))):
        assert run(["convert", str(wet), str(tmp_path / "one.ply"), *options]) == 0
        np.testing.assert_allclose(read_scene(tmp_path / "one.ply").layers[0].gaussians.sh, expected, atol=1e-5)
    assert run(["convert", str(wet), str(tmp_path / "both")]) == 0
    assert read_scene(tmp_path / "both").has_wet_colors
    assert run(["convert", str(wet), str(tmp_path / "soaked"), "--wetness", "1"]) == 0
    baked = read_scene(tmp_path / "soaked")
    assert not baked.has_wet_colors
    np.testing.assert_array_equal(baked.layers[0].gaussians.sh, scene.layers[0].wet_sh)


def test_convert_computes_wet_colors_if_asked_to(tmp_path):
    write_scene(small_scene(), tmp_path / "dry")
    for target, options in (("both", []), ("soaked.ply", []), ("half.ply", ["--wetness", "0.5"])):
        assert run(["convert", str(tmp_path / "dry"), str(tmp_path / target), "--wet", *options]) == 0
    both = read_scene(tmp_path / "both")
    assert both.has_rainy_light
    clear, soaked = (np.concatenate([sh(each) for each in both.layers]) for sh in (lambda a: a.gaussians.sh, wet_sh_of))
    assert not np.allclose(clear, soaked, atol=0.05)
    for name, share in (("soaked.ply", 1.0), ("half.ply", 0.5)):
        found = read_scene(tmp_path / name).layers[0].gaussians.sh
        np.testing.assert_allclose(found, blend_wet_sh(clear, soaked, share), atol=1e-5)


@pytest.fixture
def garden(tmp_path: Path) -> Path:
    write_binary(tmp_path / "garden/sparse/0", ("left/a.png", "right/b.png", "right/c.png"))
    write_pictures(tmp_path / "garden/images", ("left/a.png", "right/b.png"))
    return tmp_path / "garden"


def test_a_capture_is_described_and_its_points_are_drawn(garden, tmp_path, reported, capsys):
    numbers = reported("info", garden, "--overlay", tmp_path / "new/sheet.png")
    printed = capsys.readouterr().out
    assert "left 1 64x48 50.0 51.0 65.2 deg straight" in " ".join(printed.split())
    for part in (
        "garden: COLMAP, 2 views\n",
        "units of unknown length",
        "2 points on surfaces",
        "problem: 1 of 3 images are left out: ",
        "right/c.png: no such picture",
        "sheet.png: points and boxes drawn into views",
    ):
        assert part in printed
    assert (numbers["capture"], numbers["format"], numbers["views"], numbers["points"]) == ("garden", "COLMAP", 2, 2)
    assert (numbers["sensors"][1]["name"], numbers["sensors"][1]["focal_px"]) == ("right", [50.0, 51.0])
    assert "checks" not in numbers
    assert np.asarray(Image.open(tmp_path / "new/sheet.png")).shape == (480 + 22, 2 * 640 + 4, 3)


def test_broken_pictures_are_found_by_check(garden, capsys):
    file = garden / "images/left/a.png"
    data = bytearray(file.read_bytes())
    data[300:-50] = bytes(len(data) - 350)
    file.write_bytes(data)
    assert run(["info", str(garden)]) == 0
    assert "COLMAP, 2 views" in capsys.readouterr().out
    assert run(["info", str(garden), "--check"]) == 0
    printed = capsys.readouterr().out
    for part in ("COLMAP, 1 view\n", "problem: View left_a is left out: ", "poses: nothing to check them by"):
        assert part in printed


def test_the_folder_that_street_writes_is_scene_and_capture(tmp_path, reported, capsys):
    town = tmp_path / "town"
    write_scene(small_scene("town"), town / "scene")
    list(write_views(town / "images", capture_views()))
    numbers = reported("info", town)
    printed = capsys.readouterr().out
    assert "capture folder, 2 views" in printed and "town: " in printed and "rig one: FRONT" in printed
    assert numbers["views"] == 2 and numbers["gaussians"] == small_scene().gaussian_count
    still = ["render", str(town), "-o", str(tmp_path / "a.png"), "--size", "32x24", "--backend", "cpu"]
    assert run(still) == 0
    opened = load_document(str(town))
    assert opened.home == (town / "scene").resolve() and opened.scene.name == "town"
    shutil.rmtree(town / "images")
    assert run(["info", str(town)]) == 0
    assert "town: " in capsys.readouterr().out
