"""`gsrain evaluate fid` and the converters of weights, as a user runs them."""

import json
from itertools import pairwise

import numpy as np
import pytest

from app.main import run
from gsrain_engine.evaluation.fid import PLACE as CACHE
from gsrain_engine.evaluation.fid_torch_features import INCEPTION_PLACE

from .picture_sets import write_pictures


@pytest.fixture(autouse=True)
def own_places(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE, str(tmp_path / "cache"))
    monkeypatch.setenv(INCEPTION_PLACE, str(tmp_path / "none"))


@pytest.fixture
def sets(tmp_path):
    real, fake = (write_pictures(tmp_path / name, 14, k) for k, name in enumerate(("real", "fake")))
    return real, fake, write_pictures(tmp_path / "dark", 12, 2, darker=0.5)


def fid(*arguments):
    return run(["evaluate", "fid", *map(str, arguments)])


def test_two_sets_are_compared_with_the_real_one(sets, tmp_path, capsys):
    file, page = tmp_path / "out" / "fid.json", tmp_path / "out" / "fid.html"
    options = ("--extractor", "pixels16", "--resamples", "40", "--json", file, "--report", page)
    assert fid(*sets, *options) == 0
    alike, dark = json.loads(file.read_text())["rows"]
    for row, folder, count in ((alike, sets[1], 14), (dark, sets[2], 12)):
        assert (row["metric"], row["real"], row["fake"]) == ("FD-pixels16", str(sets[0]), str(folder))
        assert (row["real_pictures"], row["fake_pictures"], row["features"]) == (14, count, 160)
        assert row["extractor"] == "colour and edges of 4x4 cells, 128x128 px"
        assert row["frechet_interval"][0] <= row["frechet"] <= row["frechet_interval"][1]
    assert alike["kernel_interval"][0] < 0 < alike["kernel_interval"][1]
    assert dark["kernel_interval"][0] > 0
    assert alike["frechet"] <= alike["same"]["interval"][1]
    assert dark["frechet"] > dark["same"]["interval"][1]
    shown = capsys.readouterr().out
    lines = [line for line in shown.splitlines() if "colour and edges" in line]
    assert len(lines) == 2
    assert all("FD-pixels16" in line and " 14 " in line for line in lines)
    assert "tells no difference" in shown
    assert "FID" not in shown  # only Inception's distances have the names
    assert "KID" not in shown
    html = page.read_text()
    assert f"FD-pixels16 of {tmp_path.name}/dark" in html
    assert "tells no difference" in html
    numbers = json.loads(file.read_text())
    assert numbers["command"].startswith("gsrain")
    assert numbers["versions"]["gsrain"]
    assert set(numbers["inputs"]) == {str(folder) for folder in sets}
    assert all(each in html for each in (numbers["command"], *numbers["inputs"].values()))
    alone = tmp_path / "alone.html"
    assert fid(*sets, "--extractor", "pixels16", "--resamples", "40", "--report", alone) == 0
    assert alone.with_suffix(".json").read_bytes() == file.read_bytes()
    again = tmp_path / "again.json"
    assert fid(*sets, "--extractor", "pixels16", "--resamples", "40", "--json", again) == 0
    assert again.read_bytes() == file.read_bytes()


def test_inception_gives_fid_and_its_features_are_kept(sets, tmp_path, capsys):
    pytest.importorskip("torch")
    from evaluation.random_networks import write_inception

    write_inception(tmp_path / "random.npz")
    weights, kept = tmp_path / "inception.safetensors", tmp_path / "cache"
    assert run(["evaluate", "inception-weights", str(tmp_path / "random.npz"), "-o", str(weights)]) == 0
    assert f"{weights}: Inception of FID, 87." in capsys.readouterr().out
    few = [write_pictures(tmp_path / f"few{k}", 4, 7) for k in range(2)]
    (few[1] / "000.png").write_bytes((write_pictures(tmp_path / "one", 1, 8) / "000.png").read_bytes())
    assert fid(*few, "--weights", weights, "--resamples", "20", "--json", tmp_path / "fid.json") == 0
    (row,) = json.loads((tmp_path / "fid.json").read_text())["rows"]
    assert (row["metric"], row["kernel_metric"], row["features"], row["real_pictures"]) == ("FID", "KID", 2048, 4)
    assert row["frechet"] > 0
    assert len(list(kept.rglob("*.npy"))) == 5  # three pictures are in both sets
    for file in kept.rglob("*.npy"):
        np.save(file, np.zeros(2048, np.float32))
    assert fid(*few, "--weights", weights, "--resamples", "20", "--json", tmp_path / "kept.json") == 0
    assert json.loads((tmp_path / "kept.json").read_text())["rows"][0]["frechet"] == 0  # it took what was kept


def test_lpips_weights_become_plain_arrays_and_back(tmp_path):
    pytest.importorskip("safetensors")
    from evaluation.random_lpips import random_weights
    from gsrain_engine.evaluation.lpips_weights import read_lpips_weights

    weights = random_weights("alex")
    weights.write(tmp_path / "alex.npz")
    files = [str(tmp_path / name) for name in ("alex.npz", "new/alex.safetensors", "back.npz")]
    for source, output in pairwise(files):
        assert run(["evaluate", "lpips-weights", source, "-o", output]) == 0
    between = read_lpips_weights(tmp_path / "new" / "alex.safetensors")
    assert all(np.array_equal(a, b) for a, b in zip(weights.kernels, between.kernels, strict=True))
    assert (tmp_path / "back.npz").read_bytes() == (tmp_path / "alex.npz").read_bytes()
