"""`gsrain reconstruct`, run as a person would run it: a capture folder in, a scene, a report and numbers out."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("torch")

from app.main import run
from colmap_files import cut_rows, write_undistorted
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.training.train import EgoMaskReport
from small_capture import small_capture
from training.drive_capture import drive_capture

QUICK = ["--steps", "12", "--gaussians", "1500", "--device", "cpu"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    for _ in write_views(folder, small_capture()):
        pass
    return folder


def test_a_capture_becomes_a_scene(capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, numbers = tmp_path / "scene", tmp_path / "numbers.json"
    asked = ["reconstruct", str(capture), "-o", str(scene), *QUICK, "--held-out", "2", "--json", str(numbers)]
    assert run(asked) == 0
    found = json.loads(numbers.read_text())
    assert found["views"] == 4
    assert [each["name"] for each in found["held_out"]] == ["1.00m", "3.00m"]
    assert found["psnr_held_out_db"] > found["psnr_before_db"]
    assert found["gaussians"] > 0 and 0 < found["seconds"] < 600
    written = read_scene(scene)
    assert [layer.name for layer in written.layers] == ["background", "sky"]
    report = (tmp_path / "scene.report.html").read_text()
    assert "1.00m" in report and "Reconstruction of" in report
    printed = capsys.readouterr().out
    assert f"{found['psnr_held_out_db']:.2f} dB" in printed
    assert str(scene) in printed


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of image_undistorter for photos with a camera each: every image is a row higher than the one before."""
    folder = tmp_path_factory.mktemp("photos") / "dense"
    drive = drive_capture(5, step_m=0.7)
    write_undistorted(folder, cut_rows(drive), np.concatenate([sweep.points_m[::4] for sweep in drive.sweeps]))
    return folder


def test_pictures_may_have_different_sizes(photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = tmp_path / "numbers.json"
    asked = ["reconstruct", str(photos), "-o", str(tmp_path / "scene"), *QUICK, "--json", str(numbers)]
    assert run(asked) == 0
    found = json.loads(numbers.read_text())
    assert found["views"] == 5
    assert found["own_body"] == {"searched": False, "reason": "the capture is no drive", "shares": {}}
    assert "Own body: not looked for (the capture is no drive)" in capsys.readouterr().out
    assert "not looked for (the capture is no drive)" in (tmp_path / "scene.report.html").read_text()
    assert run([*asked, "--own-body"]) == 0
    assert json.loads(numbers.read_text())["own_body"]["searched"]
    assert "Own body: looked for (asked for)" in capsys.readouterr().out
    assert run(["info", str(photos)]) == 0
    assert "96x60 to 96x64" in capsys.readouterr().out


def test_the_own_body_is_looked_for_in_a_drive(capture: Path, tmp_path: Path) -> None:
    drive = small_capture()
    assert EgoMaskReport.planned(drive, None).searched and drive.ego is not None
    assert not EgoMaskReport.planned(replace(drive, ego=None), None).searched
    assert not EgoMaskReport.planned(drive, False).searched
    assert EgoMaskReport.planned(replace(drive, ego=None), True).searched


def test_other_pictures_take_the_place_of_the_own_ones(capture: Path, tmp_path: Path) -> None:
    images = tmp_path / "red"
    images.mkdir()
    for view in small_capture():
        Image.fromarray(np.full((32, 48, 3), (200, 30, 30), np.uint8)).save(images / f"{view.name}.png")
    asked = ["reconstruct", str(capture), "-o", str(tmp_path / "scene"), *QUICK, "--images", str(images)]
    assert run(asked) == 0
    sh = read_scene(tmp_path / "scene").member("layers/background").gaussians.sh[:, 0]
    assert np.median(sh[:, 0]) > np.median(sh[:, 1]) + 0.5


def test_a_config_is_read_and_options_go_on_top(capture: Path, tmp_path: Path) -> None:
    config = tmp_path / "quick.yaml"
    config.write_text("steps: 5\ngaussians: 1500\nsh_degree: 0\n")
    numbers = tmp_path / "numbers.json"
    asked = ["reconstruct", str(capture), "-o", str(tmp_path / "scene"), "--config", str(config), "--steps", "7"]
    assert run([*asked, "--json", str(numbers)]) == 0
    assert json.loads(numbers.read_text())["steps"] == 7
    assert read_scene(tmp_path / "scene").member("layers/background").gaussians.sh_degree == 0
