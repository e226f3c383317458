"""`gsrain transfer` of scenes, captures and pictures without poses, and `gsrain train-transfer`."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.appearance.output_folder import read_transferred
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from tests.training.drive_capture import drive_capture
from tests.training.small_street import small_street

from .picture_sets import write_pictures


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene in units of half a meter with y up, and a capture without geometry."""
    folder = tmp_path_factory.mktemp("transfer")
    write_scene(small_street(), folder / "scene")
    list(write_views(folder / "drive", drive_capture(2)))
    return folder


def test_the_street_becomes_rainy_and_its_colors_follow(files, tmp_path, reported, capsys):
    rainy, sheet = tmp_path / "rainy", tmp_path / "sheet.png"
    command = ("transfer", files / "scene", "-o", rainy, "--count", "3", "--width", "64", "--contact-sheet", sheet)
    numbers = reported(*command)
    assert f"{rainy}: 3 rainy views of small street" in capsys.readouterr().out
    assert (numbers["method"], numbers["views"]) == ("wet", 3)
    assert numbers["seconds_per_view"] == pytest.approx(numbers["seconds"] / 3, abs=1e-3)
    views = read_transferred(rainy)
    assert views.record.settings["wetness"] == 1
    assert numbers["film_share_mean"] == pytest.approx(np.mean([view.film.mean() for view in views]), abs=2e-3)
    assert [view.image.shape for view in views] == [(43, 64, 3)] * 3
    assert np.abs(views[0].image - views[0].clear.image).mean() > 0.05
    with Image.open(sheet) as picture:
        assert picture.width > 1200
    options = ("--images", rainy, "-o", tmp_path / "wet", "--held-out", "0", "--iterations", "4")
    numbers = reported("recolor", files / "scene", *options)
    assert numbers["psnr_db"] > numbers["psnr_before_db"] + 6  # cameras are where the pictures were taken
    assert read_scene(tmp_path / "wet").has_wet_colors


def test_pictures_of_another_program_replace_a_transfer(files, tmp_path):
    first, other = tmp_path / "first", tmp_path / "other"
    command = ["transfer", str(files / "scene"), "--count", "2", "--width", "48", "-o", str(first)]
    assert run([*command, "--rain", "0"]) == 0
    other.mkdir()
    for file in sorted((first / "clear").iterdir()):
        with Image.open(file) as picture:
            picture.convert("L").resize((96, 64)).save(other / file.name)
    assert run([*command, "--method", "images", "--images", str(other)]) == 0
    views = read_transferred(first)
    assert len(views) == 2
    for view in views:
        assert np.ptp(view.image, axis=2).max() < 0.02
        assert np.abs(view.image.mean(axis=2) - view.clear.image @ [0.299, 0.587, 0.114]).mean() < 0.02


def test_pictures_of_a_capture_and_recorded_cameras_of_a_scene(files, tmp_path):
    out, drive = tmp_path / "out", open_capture(files / "drive")
    assert run(["transfer", str(files / "drive"), "-o", str(out), "--count", "1", "--width", "48"]) == 0
    (view,) = open_capture(out)
    assert view.name == "1"
    np.testing.assert_allclose(view.camera.world_to_camera, drive[1].camera.world_to_camera, atol=1e-9)
    assert view.camera.fx == pytest.approx(drive[1].camera.fx / 2)
    (rainy,) = read_transferred(out)
    before, after = (np.ptp(image[:8].mean(axis=(0, 1))) for image in (rainy.clear.image, rainy.image))
    assert after < 0.5 * before  # the sky was blue
    options = ["--views", "recorded", "--width", "48", "--capture", str(files / "drive")]
    assert run(["transfer", str(files / "scene"), "-o", str(tmp_path / "recorded"), *options]) == 0
    assert [view.name for view in open_capture(tmp_path / "recorded")] == ["0", "1"]


@pytest.fixture
def pictures(tmp_path) -> Path:
    """Two pictures without poses: a gray road under a blue sky, and a car on it that is as gray."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for name, at in (("a", 40), ("b", 60)):
        image = np.empty((90, 160, 3), np.float32)
        image[:45], image[45:] = (95, 145, 225), (110, 110, 110)
        image[50:72, at : at + 40] = (70, 70, 75)
        image[54:58, at + 4 : at + 36] = image[62:66, at + 4 : at + 36] = (112, 112, 111)
        image[45:] += np.random.default_rng(at).normal(0, 3, (45, 160, 1))
        Image.fromarray(np.clip(image, 0, 255).astype(np.uint8)).save(folder / f"{name}.png")
    return folder


def test_pictures_alone_are_not_made_wet(pictures, tmp_path, reported, capsys):
    out = tmp_path / "out"
    (note,) = reported("transfer", pictures, "-o", out)["notes"]
    assert "2 of 2 views" in note and note in capsys.readouterr().out.splitlines()
    views = read_transferred(out)
    assert views.record.notes == (note,)
    for view in views:
        assert view.film.max() == 0 and not view.clear.depth.any() and not view.clear.has_pose
        assert view.clear.sky[:40].min() > 0.9 and view.clear.sky[50:].max() < 0.05
    assert not open_capture(out).has_poses
    for folder in (out, pictures):
        assert run(["evaluate", "consistency", str(folder)]) == BAD_INPUT
        assert str(folder) in capsys.readouterr().err


_CONFIG = """
architecture: tiny
steps: 1
pictures:
  clear: [{path: nothing}]
  rainy: [{path: nothing}]
  width_px: 16
  height_px: 16
lora: {unet: 2, vae: 2}
samples: 1
"""


def test_a_training_from_start_to_weights(tmp_path, reported, capsys, monkeypatch):
    pytest.importorskip("diffusers")
    from appearance.finetune.small_training import small
    from gsrain_engine.appearance.finetune import run as start

    monkeypatch.setattr(start, "tiny", small)
    monkeypatch.chdir(tmp_path)
    for seed, look in enumerate(("clear", "rainy")):
        write_pictures(Path(look), 2, seed)
    Path("own.yaml").write_text(_CONFIG)
    command = ["train-transfer", "own.yaml", "-o", "run", "--clear", "clear", "--rainy", "rainy"]
    numbers = reported(*command)
    printed = capsys.readouterr().out
    assert "run/weights.safetensors: 1 iterations" in printed and "cycle, clear" in printed
    assert numbers["steps"] == 1 and set(numbers["losses"]) >= {"cycle_clear", "gan_rainy", "identity_clear", "change"}
    assert [row["count"] for row in numbers["pictures"]] == [2, 2]
    assert Path("run/weights.safetensors").is_file() and Path("run/samples/step_000001.png").is_file()
    for options, words in (((), "holds a training already"), (("--resume",), "1 iterations are done")):
        assert run([*command, *options]) == BAD_INPUT
        assert words in capsys.readouterr().err


@pytest.fixture
def bare_machine(tmp_path, monkeypatch):
    """A machine without any weights, and a working folder without data."""
    for variable, folder in {"XDG_DATA_HOME": "data", "HF_HOME": "hub", "GSRAIN_LPIPS_WEIGHTS": "lpips"}.items():
        monkeypatch.setenv(variable, str(tmp_path / folder))
    for variable in ("GSRAIN_DSINE", "GSRAIN_DSINE_WEIGHTS", "GSRAIN_SD_TURBO", "GSRAIN_CLIP", "HF_HUB_CACHE"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_training_names_everything_that_is_missing(bare_machine, capsys):
    pytest.importorskip("torch")
    write_pictures(Path("clear"), 2, 0)
    command = ["train-transfer", "paper", "-o", "run", "--clear", "clear", "--rainy", "no rainy"]
    assert run(command) == BAD_INPUT
    first, *lines = capsys.readouterr().err.strip().splitlines()
    data = bare_machine / "data" / "gsrain"
    expected = {
        "no rainy: no such file or folder": "--rainy",
        f"no weights of DSINE at {data / 'dsine' / 'dsine.pt'}": "--normals-weights FILE",
        f"no program of DSINE (models/dsine) at {data / 'dsine' / 'DSINE'}": "--normals-checkout DIR",
        f"no SD-Turbo (unet/config.json, vae/config.json) at {data / 'sd-turbo'}": "--base",
        f"no CLIP ViT-B/32 (config.json) at {data / 'clip-vit-base-patch32'}": "--clip",
        f"no weights of LPIPS (vgg) at {bare_machine / 'lpips'}": "GSRAIN_LPIPS_WEIGHTS",
    }
    assert first == "gsrain: 6 inputs are missing or do not fit:"
    for line, (words, remedy) in zip(lines, expected.items(), strict=True):
        assert line.startswith(f"  {words}") and remedy in line
    assert not Path("run").exists()


def test_a_transfer_names_everything_that_is_missing(bare_machine, capsys, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.delenv("GSRAIN_TRANSFER_WEIGHTS", raising=False)
    command = ["transfer", "no scene.ply", "-o", "views", "--method", "cyclegan-turbo", "--normals", "dsine"]
    assert run([*command, "--capture", "no drive"]) == BAD_INPUT
    first, *lines = capsys.readouterr().err.strip().splitlines()
    expected = (
        "no transfer weights",
        "no weights of DSINE",
        "no program of DSINE",
        "no SD-Turbo",
        "no scene.ply: ",
        "no drive: ",
    )
    assert first == "gsrain: 6 inputs are missing or do not fit:"
    for line, words in zip(lines, expected, strict=True):
        assert line.startswith(f"  {words}")
    assert run(["evaluate", "consistency", "ours", "other"]) == BAD_INPUT
    first, *lines = capsys.readouterr().err.strip().splitlines()
    assert first == "gsrain: 2 inputs are missing or do not fit:"
    assert [line.split(":")[0] for line in lines] == ["  ours", "  other"]
    assert list(bare_machine.iterdir()) == []


def test_a_training_without_dsine_ends_in_one_sentence(bare_machine, capsys):
    pytest.importorskip("torch")
    for seed, look in enumerate(("clear", "rainy")):
        write_pictures(Path(look), 2, seed)
    Path("own.yaml").write_text(
        _CONFIG.replace("lora:", "  guide: luma\n  normals: dsine\nlora:").replace("nothing", "clear")
    )
    Path("dsine.pt").touch()
    options = ("-o", "run", "--normals-weights", "dsine.pt", "--lpips", "vgg.npz")
    Path("vgg.npz").touch()
    assert run(["train-transfer", "own.yaml", *options]) == BAD_INPUT
    (error,) = capsys.readouterr().err.strip().splitlines()
    assert error.startswith("gsrain: no program of DSINE") and "--normals-checkout DIR" in error
    assert not Path("run").exists()
