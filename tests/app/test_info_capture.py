"""`gsrain info CAPTURE` as a person runs it."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.command_line import BAD_INPUT, run
from colmap_files import write_binary, write_pictures


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
