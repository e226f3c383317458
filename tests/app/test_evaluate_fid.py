"""`gsrain evaluate fid` and the converters of weights."""

import json
from itertools import pairwise

import pytest

from app.main import run
from gsrain_engine.evaluation.fid import PLACE as CACHE
from gsrain_engine.evaluation.fid_torch_features import INCEPTION_PLACE

from .picture_sets import write_pictures


@pytest.fixture(autouse=True)
def own_places(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE, str(tmp_path / "cache"))
    monkeypatch.setenv(INCEPTION_PLACE, str(tmp_path / "none"))


def test_two_sets_are_compared_with_the_real_one(tmp_path, reported, capsys):
    real, fake = (write_pictures(tmp_path / name, 14, k) for k, name in enumerate(("real", "fake")))
    sets = real, fake, write_pictures(tmp_path / "dark", 12, 2, darker=0.5)
    page, command = tmp_path / "out" / "fid.html", ("evaluate", "fid", *sets, "--extractor", "pixels16")
    numbers = reported(*command, "--resamples", "40", "--report", page)
    alike, dark = numbers["rows"]
    for row, folder, count in ((alike, fake, 14), (dark, sets[2], 12)):
        assert (row["metric"], row["real"], row["fake"]) == ("FD-pixels16", str(real), str(folder))
        assert (row["real_pictures"], row["fake_pictures"], row["features"]) == (14, count, 160)
        assert row["extractor"] == "colour and edges of 4x4 cells, 128x128 px"
        assert row["frechet_interval"][0] <= row["frechet"] <= row["frechet_interval"][1]
    assert alike["kernel_interval"][0] < 0 < alike["kernel_interval"][1]
    assert dark["kernel_interval"][0] > 0
    assert alike["frechet"] <= alike["same"]["interval"][1]
    assert dark["frechet"] > dark["same"]["interval"][1]
    printed, html = capsys.readouterr().out, page.read_text()
    lines = [line for line in printed.splitlines() if "colour and edges" in line]
    assert len(lines) == 2 and all("FD-pixels16" in line and " 14 " in line for line in lines)
    assert "tells no difference" in printed and "tells no difference" in html
    assert "FID" not in printed and "KID" not in printed  # only Inception's distances have the names
    assert f"FD-pixels16 of {tmp_path.name}/dark" in html
    assert numbers["command"].startswith("gsrain") and numbers["versions"]["gsrain"]
    assert set(numbers["inputs"]) == {str(folder) for folder in sets}
    assert all(each in html for each in (numbers["command"], *numbers["inputs"].values()))
    alone = tmp_path / "alone.html"
    assert run([*map(str, command), "--resamples", "40", "--report", str(alone)]) == 0
    assert json.loads(alone.with_suffix(".json").read_text()) == numbers


def test_inception_gives_fid_from_cached_features(tmp_path, reported, capsys):
    pytest.importorskip("torch")
    from evaluation.random_networks import write_inception

    write_inception(tmp_path / "random.npz")
    weights = tmp_path / "inception.safetensors"
    assert run(["evaluate", "inception-weights", str(tmp_path / "random.npz"), "-o", str(weights)]) == 0
    assert f"{weights}: Inception of FID, 87." in capsys.readouterr().out
    few = [write_pictures(tmp_path / f"few{k}", 4, 7) for k in range(2)]
    (few[1] / "000.png").write_bytes((write_pictures(tmp_path / "one", 1, 8) / "000.png").read_bytes())
    (row,) = reported("evaluate", "fid", *few, "--weights", weights, "--resamples", "20")["rows"]
    assert (row["metric"], row["kernel_metric"], row["features"], row["real_pictures"]) == ("FID", "KID", 2048, 4)
    assert row["frechet"] > 0
    assert len(list((tmp_path / "cache").rglob("*.npy"))) == 5  # three pictures are in both sets


def test_lpips_weights_become_plain_arrays_and_back(tmp_path):
    pytest.importorskip("safetensors")
    from evaluation.random_lpips import random_weights

    random_weights("alex").write(tmp_path / "alex.npz")
    files = [str(tmp_path / name) for name in ("alex.npz", "new/alex.safetensors", "back.npz")]
    for source, output in pairwise(files):
        assert run(["evaluate", "lpips-weights", source, "-o", output]) == 0
    assert (tmp_path / "back.npz").read_bytes() == (tmp_path / "alex.npz").read_bytes()
