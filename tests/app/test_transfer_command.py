import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.main import run
from gsrain_engine.appearance.output_folder import read_transferred
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from tests.training.drive_capture import drive_capture
from tests.training.small_street import small_street


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene in units of half a metre with y up, and a capture without geometry."""
    folder = tmp_path_factory.mktemp("transfer")
    write_scene(small_street(), folder / "scene")
    list(write_views(folder / "drive", drive_capture(2)))
    (folder / "notes").mkdir()
    (folder / "notes" / "mine.txt").write_text("x")
    return folder


def test_the_street_becomes_rainy_and_its_colors_follow(files, tmp_path, capsys):
    rainy, numbers, sheet = tmp_path / "rainy", tmp_path / "n.json", tmp_path / "sheet.png"
    command = ["transfer", str(files / "scene"), "-o", str(rainy), "--count", "3", "--width", "64"]
    assert run([*command, "--json", str(numbers), "--sheet", str(sheet)]) == 0
    assert f"{rainy}: 3 rainy views of small street" in capsys.readouterr().out
    told = json.loads(numbers.read_text())
    assert (told["method"], told["views"]) == ("wet", 3)
    assert told["seconds"] > 0 and told["seconds_per_view"] == pytest.approx(told["seconds"] / 3, abs=1e-3)
    views = read_transferred(rainy)
    assert views.record.settings["wetness"] == 1
    assert told["film_share_mean"] == pytest.approx(np.mean([view.film.mean() for view in views]), abs=2e-3)
    assert [view.image.shape for view in views] == [(43, 64, 3)] * 3
    assert np.abs(views[0].image - views[0].clear.image).mean() > 0.05
    with Image.open(sheet) as picture:
        assert picture.width > 1200

    wet = tmp_path / "wet"
    assert run(["recolor", str(files / "scene"), "--images", str(rainy), "-o", str(wet), "--held-out", "0",
                "--iterations", "4", "--json", str(numbers)]) == 0  # fmt: skip
    told = json.loads(numbers.read_text())
    assert told["psnr_db"] > told["psnr_before_db"] + 6  # cameras are where the pictures were taken
    assert read_scene(wet).has_wet_colors


def test_what_another_program_made_of_the_views_takes_the_place_of_a_transfer(files, tmp_path, capsys, caplog):
    first, other = tmp_path / "first", tmp_path / "other"
    common = [str(files / "scene"), "--count", "2", "--width", "48"]
    assert run(["transfer", *common, "-o", str(first), "--rain", "0"]) == 0
    other.mkdir()
    for file in sorted((first / "clear").iterdir()):
        with Image.open(file) as picture:
            picture.convert("L").resize((96, 64)).save(other / file.name)
    assert run(["transfer", *common, "-o", str(first), "--method", "images", "--images", str(other)]) == 0
    views = read_transferred(first)
    assert len(views) == 2
    for view in views:
        assert np.ptp(view.image, axis=2).max() < 0.02
        assert np.abs(view.image.mean(axis=2) - view.clear.image @ [0.299, 0.587, 0.114]).mean() < 0.02


def test_pictures_of_a_capture_become_rainy(files, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(["transfer", str(files / "drive"), "-o", str(out), "--count", "1", "--width", "48"]) == 0
    capture, drive = open_capture(out), open_capture(files / "drive")
    assert [view.name for view in capture] == ["1"]
    np.testing.assert_allclose(capture[0].camera.world_to_camera, drive[1].camera.world_to_camera, atol=1e-9)
    assert capture[0].camera.fx == pytest.approx(drive[1].camera.fx / 2)
    sky = slice(0, 8), slice(None)
    before, after = (read_transferred(out)[0].clear.image[sky], read_transferred(out)[0].image[sky])
    assert np.ptp(after.mean(axis=(0, 1))) < 0.5 * np.ptp(before.mean(axis=(0, 1)))  # the sky was blue


def test_recorded_cameras_of_a_scene_are_those_of_its_capture(files, tmp_path):
    out = tmp_path / "out"
    command = ["transfer", str(files / "scene"), "-o", str(out), "--views", "recorded", "--width", "48"]
    assert run([*command, "--capture", str(files / "drive")]) == 0
    assert [view.name for view in open_capture(out)] == ["0", "1"]


def street_pictures(folder: Path) -> Path:
    """Write two pictures without poses: a gray road under a blue sky, and a car on it that is as gray."""
    folder.mkdir()
    for name, at in (("a", 40), ("b", 60)):
        image = np.empty((90, 160, 3), np.float32)
        image[:45], image[45:] = (95, 145, 225), (110, 110, 110)
        image[50:72, at : at + 40] = (70, 70, 75)
        image[54:58, at + 4 : at + 36] = image[62:66, at + 4 : at + 36] = (112, 112, 111)
        image[45:] += np.random.default_rng(at).normal(0, 3, (45, 160, 1))
        Image.fromarray(np.clip(image, 0, 255).astype(np.uint8)).save(folder / f"{name}.png")
    return folder


def test_pictures_alone_are_not_made_wet_and_that_is_said(tmp_path, capsys):
    pictures, out, numbers = street_pictures(tmp_path / "pictures"), tmp_path / "out", tmp_path / "n.json"
    assert run(["transfer", str(pictures), "-o", str(out), "--json", str(numbers)]) == 0
    told = json.loads(numbers.read_text())
    sentence = "2 of 2 views: only light, colors and the sky where it is sure"
    assert [line for line in capsys.readouterr().out.splitlines() if line.startswith(sentence)] == told["notes"]
    views = read_transferred(out)
    assert views.record.notes == tuple(told["notes"])
    for view in views:
        assert view.film.max() == 0
        assert view.clear.sky[:40].min() > 0.9 and view.clear.sky[50:].max() < 0.05
        assert not view.clear.depth.any()
        assert not view.clear.has_pose
    capture = open_capture(out)
    assert not capture.has_poses and "No poses" in capture.problems[0]
    assert run(["evaluate", "consistency", str(out)]) == 2
    assert "it is not known where its pictures were taken" in capsys.readouterr().err
    assert run(["evaluate", "consistency", str(pictures)]) == 2
    assert "it is not known where its pictures were taken" in capsys.readouterr().err


def test_pictures_without_poses_do_not_attend_to_each_other(tmp_path, capsys):
    pytest.importorskip("torch")
    pytest.importorskip("diffusers")
    from gsrain_engine.appearance.cyclegan_turbo.lora import LoraRanks
    from gsrain_engine.appearance.cyclegan_turbo.model import build_random_model, tiny
    from gsrain_engine.appearance.cyclegan_turbo.weights import save_weights

    weights, pictures = tmp_path / "tiny.safetensors", street_pictures(tmp_path / "pictures")
    save_weights(build_random_model(tiny(), False, LoraRanks(2, 2)), weights)
    command = ["transfer", str(pictures), "--method", "cyclegan-turbo", "--weights", str(weights), "--side", "64"]
    assert run([*command, "-o", str(tmp_path / "with")]) == 0
    sentence = "2 of 2 views: no attention between views: it is not known where their cameras stood."
    assert sentence in capsys.readouterr().out.splitlines()
    assert read_transferred(tmp_path / "with").record.notes == (sentence,)
    assert run([*command, "-o", str(tmp_path / "without"), "--no-mutual-attention"]) == 0
    assert "attention" not in capsys.readouterr().out
    for name in ("a.png", "b.png"):
        assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes()
