"""`gsrain info` of captures, and of folders that are both, or look like scenes."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from colmap_files import write_binary, write_pictures
from datasets.sample_captures import views as capture_views
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.editor.files import load_document
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene


@pytest.fixture
def garden(tmp_path: Path) -> Path:
    write_binary(tmp_path / "garden/sparse/0", ("left/a.png", "right/b.png", "right/c.png"))
    write_pictures(tmp_path / "garden/images", ("left/a.png", "right/b.png"))
    return tmp_path / "garden"


def test_a_capture_is_described_and_its_points_are_drawn(garden, tmp_path, reported, capsys):
    numbers = reported("info", garden, "--overlay", tmp_path / "new/sheet.png")
    printed = capsys.readouterr().out
    for part in (
        "garden: COLMAP, 2 views\n",
        "units of unknown length",
        "2 points on surfaces",
        "left    1      64x48  50.0 51.0        65.2 deg       straight",
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


@pytest.mark.parametrize("meta", ['{"title": "photos"}', "[]", "{", '{"means": 1' + " " * (1 << 20) + "}"])
def test_a_meta_json_alone_is_no_sog(tmp_path, meta, capsys):
    folder = tmp_path / "photos"
    write_pictures(folder, ("a.png", "b.png"))
    (folder / "meta.json").write_text(meta)
    assert run(["info", str(folder)]) == 0
    assert "image folder, 2 views" in capsys.readouterr().out
    assert run(["render", str(folder), "-o", str(tmp_path / "a.png")]) == BAD_INPUT
    (error,) = capsys.readouterr().err.splitlines()
    assert "meta.json" in error and "SOG" in error
