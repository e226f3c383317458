"""`gsrain reconstruct`: a capture folder in; a scene, a report and numbers out."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("torch")

from app.main import run
from colmap_files import cut_rows, write_undistorted
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.scene.formats.scene_files import read_scene
from small_capture import small_capture
from training.drive_capture import drive_capture

QUICK = ["--steps", "12", "--gaussians", "1500", "--device", "cpu"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    for _ in write_views(folder, small_capture()):
        pass
    return folder


def test_a_capture_becomes_a_scene(capture, tmp_path, reported, capsys):
    scene = tmp_path / "scene"
    found = reported("reconstruct", capture, "-o", scene, *QUICK, "--held-out", "2")
    assert found["views"] == 4
    assert [each["name"] for each in found["held_out"]] == ["1.00m", "3.00m"]
    assert found["psnr_held_out_db"] > found["psnr_before_db"]
    assert found["gaussians"] > 0 and found["seconds"] > 0
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


def test_pictures_may_have_different_sizes(photos, tmp_path, reported, capsys):
    command = ("reconstruct", photos, "-o", tmp_path / "scene", *QUICK)
    found = reported(*command)
    assert found["views"] == 5
    assert found["own_body"] == {"searched": False, "reason": "the capture is no drive", "shares": {}}
    assert "Own body: not looked for (the capture is no drive)" in capsys.readouterr().out
    assert "not looked for (the capture is no drive)" in (tmp_path / "scene.report.html").read_text()
    assert reported(*command, "--own-body")["own_body"]["searched"]
    assert "Own body: looked for (asked for)" in capsys.readouterr().out
    assert run(["info", str(photos)]) == 0
    assert "96x60 to 96x64" in capsys.readouterr().out


def test_other_pictures_and_a_config_with_options_on_top(capture, tmp_path, reported):
    images, config = tmp_path / "red", tmp_path / "quick.yaml"
    images.mkdir()
    for view in small_capture():
        Image.fromarray(np.full((32, 48, 3), (200, 30, 30), np.uint8)).save(images / f"{view.name}.png")
    config.write_text("steps: 5\ngaussians: 1500\nsh_degree: 0\n")
    options = ("--images", images, "--config", config, "--steps", "12", "--device", "cpu")
    found = reported("reconstruct", capture, "-o", tmp_path / "scene", *options)
    assert found["steps"] == 12
    background = read_scene(tmp_path / "scene").member("layers/background").gaussians
    assert background.sh_degree == 0
    assert np.median(background.sh[:, 0, 0]) > np.median(background.sh[:, 0, 1]) + 0.5
