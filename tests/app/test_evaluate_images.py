"""`gsrain evaluate images`: figures of pairs by name, with masks."""

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


def read(file):
    with Image.open(file) as picture:
        return np.asarray(picture, np.float32) / 255


def test_pairs_are_measured_and_reported(folders, tmp_path, reported, capsys):
    page = tmp_path / "out" / "images.html"
    (folders[1] / "004.png").rename(folders[1] / "other.png")
    numbers = reported("evaluate", "images", *folders, "--report", page)
    rows, mean = numbers["rows"], numbers["means"]["psnr_db"]
    assert [row["name"] for row in rows] == ["000", "001", "002", "003", "005"]
    assert numbers["left_out"] == 2
    first = [read(folder / "000.png") for folder in folders]
    assert rows[0]["psnr_db"] == pytest.approx(psnr(*first), rel=1e-9)
    assert rows[0]["ssim"] == pytest.approx(ssim(*first), rel=1e-9)
    assert rows[0]["lpips"] is None
    assert mean["mean"] == pytest.approx(np.mean([row["psnr_db"] for row in rows]))
    assert mean["low"] < mean["mean"] < mean["high"]
    printed = capsys.readouterr()
    assert "mean of 5" in printed.out and "2 pictures have no other of their name" in printed.err
    html = page.read_text()
    assert "Every picture" in html and "held-out" not in html.lower()
    assert numbers["command"].startswith("gsrain") and len(numbers["inputs"]) == 2
    assert f"gsrain {numbers['versions']['gsrain']}, numpy" in html
    assert all(each in html for each in (numbers["command"], *numbers["inputs"].values()))
    alone = tmp_path / "alone.html"
    assert run(["evaluate", "images", *map(str, folders), "--report", str(alone)]) == 0
    assert json.loads(alone.with_suffix(".json").read_text()) == numbers


def test_masks_leave_pixels_out(folders, tmp_path, reported):
    masks = tmp_path / "masks"
    masks.mkdir()
    mask = np.zeros((48, 64), np.uint8)
    mask[:, :40] = 255
    for k in range(6):
        Image.fromarray(mask).save(masks / f"{k:03}.png")
        spoilt = np.array(Image.open(folders[0] / f"{k:03}.png"))
        spoilt[:, 40:] = 0
        Image.fromarray(spoilt).save(folders[0] / f"{k:03}.png")
    command = ("evaluate", "images", *folders)
    masked, whole = reported(*command, "--masks", masks), reported(*command)
    assert (masked["rows"][0]["compared_share"], whole["rows"][0]["compared_share"]) == (pytest.approx(0.625), 1)
    assert masked["means"]["psnr_db"]["mean"] > whole["means"]["psnr_db"]["mean"] + 10
    (masks / "003.png").unlink()
    assert run([*map(str, command), "--masks", str(masks)]) == BAD_INPUT


def test_lpips_is_another_column_and_equal_pictures_are_equal(folders, tmp_path, reported, capsys):
    pytest.importorskip("torch")
    from evaluation.random_lpips import random_weights

    random_weights("alex").write(tmp_path / "alex.npz")
    command = ("evaluate", "images", "--lpips", tmp_path / "alex.npz")
    assert all(row["lpips"] > 0 for row in reported(*command, *folders)["rows"])
    assert "LPIPS" in capsys.readouterr().out
    means = reported(*command, folders[1], folders[1])["means"]
    assert [means["psnr_db"][name] for name in ("mean", "low", "high")] == [None] * 3  # infinite, which JSON lacks
    assert (means["ssim"]["mean"], means["lpips"]["mean"]) == (1, 0)


def test_two_pictures_are_a_pair_whatever_their_names(folders, tmp_path, reported, capsys):
    (folders[1] / "004.png").rename(tmp_path / "true.png")
    pair = folders[0] / "004.png", tmp_path / "true.png"
    numbers = reported("evaluate", "images", *pair)
    (row,) = numbers["rows"]
    assert row["psnr_db"] == pytest.approx(psnr(*map(read, pair)), rel=1e-9) and numbers["left_out"] == 0
    mask = np.zeros(read(pair[1]).shape[:2], np.uint8)
    mask[:8, :8] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    (row,) = reported("evaluate", "images", *pair, "--masks", tmp_path / "mask.png")["rows"]
    assert row["compared_share"] == pytest.approx(64 / mask.size)
    (row,) = reported("evaluate", "images", folders[0] / "002.png", folders[1])["rows"]
    assert row["name"] == "002"
    (tmp_path / "notes.png").write_text("no picture")
    for file in (tmp_path / "notes.png", folders[1] / "none.png"):
        assert run(["evaluate", "images", str(pair[0]), str(file)]) == BAD_INPUT
        assert file.name in capsys.readouterr().err
