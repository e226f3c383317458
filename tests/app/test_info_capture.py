"""`gsrain info CAPTURE` as a person runs it."""

import json
import shutil
from dataclasses import replace
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


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["{tmp}/gardn"], "gardn"),
        (["{tmp}/empty"], "empty: neither a scene (scene.json, or meta.json of SOG) nor a capture that is known"),
        (["street", "--check"], "--check and --overlay are for captures"),
        (["{tmp}/broken"], "transforms.json: not a JSON file"),
    ],
)
def test_bad_input_ends_in_one_line(small: Path, tmp_path: Path, arguments, told: str, capsys) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "transforms.json").write_text("{")
    assert run(["info", *(each.format(tmp=tmp_path) for each in arguments)]) == BAD_INPUT
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


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


@pytest.mark.parametrize("columns", ["60", "200"])
def test_names_are_printed_whole(
    tmp_path: Path, columns: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    layer, long = small_scene().layers[0], "a layer of asphalt with a name that is longer than any terminal, " * 4
    front = small_scene().rigs["one"][0]
    rigs = {"a rig with many cameras": tuple(replace(front, name=f"CAMERA_OF_THE_ROOF_{k}") for k in range(8))}
    write_scene(replace(small_scene(), layers=(replace(layer, name=long),), rigs=rigs), tmp_path / "scene")
    assert run(["info", str(tmp_path / "scene")]) == 0
    printed = capsys.readouterr().out
    assert long in printed and ", ".join(f"CAMERA_OF_THE_ROOF_{k}" for k in range(8)) in printed
    assert "..." not in printed and "\u2026" not in printed
    folder = "front_left_camera_of_the_roof_" * 6
    write_binary(tmp_path / "garden/sparse/0", (f"{folder}/a.png", "right/b.png"))
    write_pictures(tmp_path / "garden/images", (f"{folder}/a.png", "right/b.png"))
    assert run(["info", str(tmp_path / "garden")]) == 0
    assert folder in capsys.readouterr().out


def test_a_unit_that_nobody_gave_is_said_to_be_assumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = tmp_path / "wall.ply", tmp_path / "wall"
    write_scene(small_scene(), file)
    numbers = tmp_path / "n.json"
    for path, options in ((file, []), (folder, ["convert"])):
        if options:
            assert run(["convert", str(file), str(folder)]) == 0
        assert run(["info", str(path), "--json", str(numbers)]) == 0
        assert "1 unit = 1 m (assumed), up" in capsys.readouterr().out
        assert json.loads(numbers.read_text())["metres_per_unit_is_assumed"]
    assert run(["convert", str(folder), str(tmp_path / "metric"), "--metres-per-unit", "1"]) == 0
    assert run(["info", str(tmp_path / "metric")]) == 0
    assert "1 unit = 1 m, up" in capsys.readouterr().out


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


def test_sizes_of_all_pictures_of_a_camera_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, size in (("a", (80, 60)), ("b", (60, 64)), ("c", (70, 70)), ("d", (80, 60))):  # the first is neither end
        Image.new("RGB", size).save(tmp_path / f"{name}.png")
    assert run(["info", str(tmp_path), "--check", "--json", str(tmp_path / "n.json")]) == 0
    printed = capsys.readouterr()
    assert "60x64 to 70x70 (3 sizes)" in printed.out
    assert "2/2" in printed.err  # the bar ends, also where there is nothing to check
    [sensor] = json.loads((tmp_path / "n.json").read_text())["sensors"]
    assert (sensor["width"], sensor["sizes"], sensor["smallest_px"]) == (80, 3, [60, 64])
