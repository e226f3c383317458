"""`gsrain recolor` and `gsrain reconstruct`: a scene, a report and numbers out of captures and pictures."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.main import run
from colmap_files import cut_rows
from gsrain_engine.datasets.capture import CaptureFrame
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from small_capture import small_capture
from tests.recolor.changed_street import street_and_pictures


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene folder, a capture of it in another look, and the same pictures without cameras."""
    folder = tmp_path_factory.mktemp("recolor")
    clear, _, targets = street_and_pictures()
    write_scene(clear, folder / "clear")
    views = [
        CaptureFrame(f"v{i}", each.camera, np.rint(each.image * 255).astype(np.uint8), each.time_s)
        for i, each in enumerate(targets)
    ]
    list(write_views(folder / "capture", views))
    (folder / "images").mkdir()
    for view in views[:5]:
        (folder / "images" / f"{view.name}.png").write_bytes((folder / "capture" / f"{view.name}.png").read_bytes())
    return folder


def test_a_scene_takes_on_the_look_of_a_capture(files, tmp_path, reported, capsys):
    wet, report = tmp_path / "wet", tmp_path / "report.html"
    options = ("--images", files / "capture", "-o", wet, "--held-out", "5", "--report", report)
    numbers = reported("recolor", files / "clear", *options)
    assert set(numbers) >= {"seconds", "gaussians", "psnr_before_db", "psnr_held_out_db", "views"}
    assert (numbers["views"], numbers["views_held_out"]) == (5, 1)
    assert numbers["psnr_held_out_db"] > numbers["psnr_before_db"] + 3
    clear, scene = read_scene(files / "clear"), read_scene(wet)
    street = scene.member("layers/street")
    np.testing.assert_array_equal(street.gaussians.sh, clear.member("layers/street").gaussians.sh)
    assert street.wet_sh is not None
    assert np.abs(street.wet_sh - street.gaussians.sh).mean() > 0.05
    assert "<svg" in report.read_text(encoding="utf-8")
    assert "Held-out views:" in capsys.readouterr().out


def test_pictures_without_cameras_are_matched_by_name_and_can_replace_the_clear_colors(files, tmp_path, capsys):
    new = tmp_path / "new"
    command = ["recolor", str(files / "clear"), "--images", str(files / "images"), "--capture", str(files / "capture")]
    assert run([*command, "-o", str(new), "--replace", "--held-out", "0", "--iterations", "4"]) == 0
    assert "'v5' for one" in capsys.readouterr().out
    assert "<svg" in (tmp_path / "new.report.html").read_text(encoding="utf-8")
    clear, scene = read_scene(files / "clear"), read_scene(new)
    assert scene.member("layers/street").wet_sh is None
    assert np.abs(scene.member("layers/street").gaussians.sh - clear.member("layers/street").gaussians.sh).max() > 0.1


def test_pictures_of_different_sizes_go_all_the_way(files, tmp_path, reported):
    """Transfer, recoloring and evaluation of what undistortion by one camera a picture makes of a capture."""
    views = cut_rows(open_capture(files / "capture"))
    list(write_views(tmp_path / "photos", views))
    rainy, photos = str(tmp_path / "rainy"), str(tmp_path / "photos")
    assert run(["transfer", photos, "-o", rainy, "--contact-sheet", str(tmp_path / "sheet.png")]) == 0
    assert [view.camera.height for view in open_capture(rainy)] == [view.camera.height for view in views]
    options = ("--images", rainy, "-o", tmp_path / "wet", "--iterations", "2", "--held-out", "5")
    assert reported("recolor", files / "clear", *options)["views"] == len(views) - 1
    assert run(["evaluate", "images", rainy, photos, "--report", str(tmp_path / "images.html")]) == 0
    assert run(["evaluate", "fid", photos, rainy, "--extractor", "pixels16", "--resamples", "20"]) == 0
    assert run(["info", photos, "--overlay", str(tmp_path / "overlay.png")]) == 0


QUICK = ["--steps", "12", "--gaussians", "1500", "--device", "cpu"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    pytest.importorskip("torch")
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
