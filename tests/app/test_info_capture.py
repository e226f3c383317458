"""`gsrain info CAPTURE` as a person runs it."""

import json
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
def small(tmp_path: Path) -> Path:
    write_binary(tmp_path / "garden/sparse/0", ("left/a.png", "right/b.png", "right/c.png"))
    write_pictures(tmp_path / "garden/images", ("left/a.png", "right/b.png"))
    return tmp_path / "garden"


def test_a_capture_is_described(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(small), "--json", str(tmp_path / "out.json")]) == 0
    printed = capsys.readouterr().out
    for part in (
        "garden: COLMAP, 2 views\n",
        "units of unknown length",
        "2 points on surfaces",
        "left    1      64x48  50.0 51.0        65.2 deg       straight",
        "problem: 1 of 3 images are left out: ",
        "right/c.png: no such picture",
    ):
        assert part in printed
    numbers = json.loads((tmp_path / "out.json").read_text())
    assert (numbers["capture"], numbers["format"], numbers["views"], numbers["points"]) == ("garden", "COLMAP", 2, 2)
    assert numbers["sensors"][1]["name"] == "right"
    assert numbers["sensors"][1]["focal_px"] == [50.0, 51.0]
    assert "checks" not in numbers


def test_broken_pictures_are_found_by_check(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = small / "images/left/a.png"
    data = bytearray(file.read_bytes())
    data[300:-50] = bytes(len(data) - 350)
    file.write_bytes(data)
    assert run(["info", str(small)]) == 0
    assert "COLMAP, 2 views" in capsys.readouterr().out
    assert run(["info", str(small), "--check"]) == 0
    printed = capsys.readouterr().out
    assert "COLMAP, 1 view\n" in printed
    assert "problem: View left_a is left out: " in printed
    assert "poses: nothing to check them by" in printed


def test_points_are_drawn_into_a_sheet(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(small), "--overlay", str(tmp_path / "new/sheet.png")]) == 0
    assert "sheet.png: points and boxes drawn into views" in capsys.readouterr().out
    sheet = np.asarray(Image.open(tmp_path / "new/sheet.png"))
    assert sheet.shape == (480 + 22, 2 * 640 + 4, 3)


def test_real_drive_is_described_and_checked(
    test_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = test_data / "driving" / "nuscenes_sample"
    assert run(["info", str(path), "--check", "--json", str(tmp_path / "out.json")]) == 0
    printed = capsys.readouterr().out
    assert "lidar: 1 sweep, 34,688 points" in printed
    assert printed.count("fits: ") == 6
    numbers = json.loads((tmp_path / "out.json").read_text())
    assert numbers["lidar_points"] == 34688
    assert [check["verdict"] for check in numbers["checks"]] == ["fits"] * 6
    assert sum(numbers["boxes"].values()) == 69


def test_the_folder_that_street_writes_is_scene_and_capture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_scene(small_scene("town"), tmp_path / "town" / "scene")
    list(write_views(tmp_path / "town" / "images", capture_views()))
    assert run(["info", str(tmp_path / "town"), "--json", str(tmp_path / "n.json")]) == 0
    printed = capsys.readouterr().out
    assert "capture folder, 2 views" in printed and "town: " in printed and "rig one: FRONT" in printed
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert numbers["views"] == 2 and numbers["gaussians"] == small_scene().gaussian_count
    still = ["render", str(tmp_path / "town"), "-o", str(tmp_path / "a.png"), "--size", "32x24", "--backend", "cpu"]
    assert run(still) == 0
    opened = load_document(str(tmp_path / "town"))
    assert opened.home == (tmp_path / "town" / "scene").resolve() and opened.scene.name == "town"
    shutil.rmtree(tmp_path / "town" / "images")
    assert run(["info", str(tmp_path / "town")]) == 0
    assert "town: " in capsys.readouterr().out


@pytest.mark.parametrize("meta", ['{"title": "photos"}', "[]", "{", '{"means": 1' + " " * (1 << 20) + "}"])
def test_a_meta_json_alone_is_no_sog(tmp_path: Path, meta: str, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "photos"
    write_pictures(folder, ("a.png", "b.png"))
    (folder / "meta.json").write_text(meta)
    assert run(["info", str(folder)]) == 0
    assert "image folder, 2 views" in capsys.readouterr().out
    assert run(["render", str(folder), "-o", str(tmp_path / "a.png")]) == BAD_INPUT
    error = capsys.readouterr().err
    assert "its meta.json is none of SOG" in error and error.count("\n") == 1
