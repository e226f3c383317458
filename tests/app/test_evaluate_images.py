"""`gsrain evaluate images`: figures of pairs by name, with masks, as a user runs it."""

import json

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from gsrain_engine.evaluation.image_metrics import psnr, ssim

from .picture_sets import write_pictures


@pytest.fixture
def folders(tmp_path):
    return write_pictures(tmp_path / "shown", 6, 0, noise=6), write_pictures(tmp_path / "truth", 6, 0)


def images(*arguments):
    return run(["evaluate", "images", *map(str, arguments)])


def _read(file):
    with Image.open(file) as picture:
        return np.asarray(picture, np.float32) / 255


def test_pairs_are_measured_and_told(folders, tmp_path, capsys):
    file, page = tmp_path / "out" / "images.json", tmp_path / "out" / "images.html"
    (folders[1] / "004.png").rename(folders[1] / "other.png")
    assert images(*folders, "--json", file, "--report", page) == 0
    numbers = json.loads(file.read_text())
    assert [row["name"] for row in numbers["rows"]] == ["000", "001", "002", "003", "005"]
    assert numbers["left_out"] == 2
    first = [_read(folder / "000.png") for folder in folders]
    assert numbers["rows"][0]["psnr_db"] == pytest.approx(psnr(*first), rel=1e-9)
    assert numbers["rows"][0]["ssim"] == pytest.approx(ssim(*first), rel=1e-9)
    assert numbers["rows"][0]["lpips"] is None
    mean = numbers["means"]["psnr_db"]
    assert mean["mean"] == pytest.approx(np.mean([row["psnr_db"] for row in numbers["rows"]]))
    assert mean["low"] < mean["mean"] < mean["high"]
    shown = capsys.readouterr()
    assert "mean of 5" in shown.out
    assert "2 pictures have no other of their name" in shown.err
    html = page.read_text()
    assert "Every picture" in html
    assert "held-out" not in html.lower()
    assert numbers["command"].startswith("gsrain")
    assert numbers["versions"]["gsrain"]
    assert len(numbers["inputs"]) == 2
    assert all(each in html for each in (numbers["command"], *numbers["inputs"].values()))
    alone = tmp_path / "alone.html"
    assert images(*folders, "--report", alone) == 0
    assert alone.with_suffix(".json").read_bytes() == file.read_bytes()
    again = tmp_path / "again.json"
    assert images(*folders, "--json", again) == 0
    assert again.read_bytes() == file.read_bytes()


def test_masks_leave_pixels_out(folders, tmp_path):
    masks = tmp_path / "masks"
    masks.mkdir()
    mask = np.zeros((48, 64), np.uint8)
    mask[:, :40] = 255
    for name in ("000", "001", "002", "003", "004", "005"):
        Image.fromarray(mask).save(masks / f"{name}.png")
        spoilt = np.array(Image.open(folders[0] / f"{name}.png"))
        spoilt[:, 40:] = 0
        Image.fromarray(spoilt).save(folders[0] / f"{name}.png")

    def mean(*options):
        assert images(*folders, "--json", tmp_path / "numbers.json", *options) == 0
        return json.loads((tmp_path / "numbers.json").read_text())

    masked, whole = mean("--masks", masks), mean()
    assert masked["rows"][0]["compared_share"] == pytest.approx(0.625)
    assert whole["rows"][0]["compared_share"] == 1
    assert masked["means"]["psnr_db"]["mean"] > whole["means"]["psnr_db"]["mean"] + 10
    (masks / "003.png").unlink()
    assert images(*folders, "--masks", masks) == BAD_INPUT


def test_equal_pictures_are_equal(folders, tmp_path):
    assert images(folders[1], folders[1], "--json", tmp_path / "same.json") == 0
    numbers = json.loads((tmp_path / "same.json").read_text())
    assert numbers["means"]["psnr_db"] == {"mean": None, "low": None, "high": None}  # infinite, which JSON lacks
    assert numbers["means"]["ssim"]["mean"] == 1


def test_lpips_stands_beside(folders, tmp_path, capsys):
    pytest.importorskip("torch")
    from evaluation.random_lpips import random_weights

    random_weights("alex").write(tmp_path / "alex.npz")
    assert images(*folders, "--lpips", tmp_path / "alex.npz", "--json", tmp_path / "numbers.json") == 0
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    assert all(row["lpips"] > 0 for row in numbers["rows"])
    assert "LPIPS" in capsys.readouterr().out


def test_two_pictures_are_a_pair_whatever_they_are_called(folders, tmp_path, capsys):
    file = tmp_path / "numbers.json"
    (folders[1] / "004.png").rename(tmp_path / "true.png")
    pair = folders[0] / "004.png", tmp_path / "true.png"
    assert images(*pair, "--json", file) == 0
    numbers = json.loads(file.read_text())
    (row,) = numbers["rows"]
    assert row["psnr_db"] == pytest.approx(psnr(*(_read(each) for each in pair)), rel=1e-9)
    assert numbers["left_out"] == 0
    mask = np.zeros(_read(pair[1]).shape[:2], np.uint8)
    mask[:8, :8] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    assert images(*pair, "--masks", tmp_path / "mask.png", "--json", file) == 0
    assert json.loads(file.read_text())["rows"][0]["compared_share"] == pytest.approx(64 / mask.size)
    assert images(folders[0] / "002.png", folders[1], "--json", file) == 0
    assert [each["name"] for each in json.loads(file.read_text())["rows"]] == ["002"]
    capsys.readouterr()
    (tmp_path / "notes.png").write_text("no picture")
    assert images(pair[0], tmp_path / "notes.png") == BAD_INPUT
    assert "notes.png" in capsys.readouterr().err
    assert images(pair[0], folders[1] / "none.png") == BAD_INPUT
    assert "no such file or folder" in capsys.readouterr().err
