"""Consistency: a transfer that does the same in every view keeps it, one that does not loses it, water may move."""

import json
import re
from dataclasses import replace
from html import unescape
from math import isnan

import numpy as np
import pytest
from PIL import Image

from app.main import BAD_INPUT, run
from appearance.street_views import street_views
from gsrain_engine.appearance.base import RainyView
from gsrain_engine.appearance.output_folder import TransferRecord, write_transferred
from gsrain_engine.evaluation.consistency import (
    WarpAgreement,
    WarpError,
    agreements,
    pool_errors,
    warp_error,
    warped_pair,
)

PAIRS = [(0, 1), (1, 0), (2, 1), (3, 1)]


def _alike(view):
    """Darker in the same way everywhere."""
    return RainyView(view, 0.5 * view.image)


def _unlike(view):
    """Another tint in each view."""
    tint = {"first": 0.1, "second": -0.1}.get(view.name, 0.0)
    return RainyView(view, np.clip(0.5 * view.image + 0.2 + np.float32(tint), 0, 1))


def _mirroring(view):
    """Stripes that stay where they are in the picture, on flat ground, which the film tells."""
    film = (view.normals[..., 2] > 0.9).astype(np.float32)
    stripes = (np.arange(view.image.shape[1]) // 20 % 2).astype(np.float32)[None, :, None]
    image = np.where(film[..., None] > 0, 0.5 * view.image + 0.5 * stripes, 0.5 * view.image)
    return RainyView(view, image.astype(np.float32), film)


def _all(make):
    return [make(view) for view in street_views().values()]


def test_the_same_in_every_view_keeps_the_error_in_shares_of_contrast():
    rows = list(agreements(_all(_alike), PAIRS))
    assert len(rows) == len(PAIRS)
    for row in rows:
        assert row.everywhere.ratio == pytest.approx(0.5, abs=1e-3)
        assert row.everywhere.contrast_ratio == pytest.approx(1, abs=1e-3)
        assert row.outside_film is None


def test_another_tint_in_each_view_is_seen():
    rows = list(agreements(_all(_unlike), PAIRS))
    assert rows[0].everywhere.after.rmse == pytest.approx(0.2, abs=0.02)
    assert rows[0].everywhere.ratio > 5
    assert rows[3].everywhere.after.rmse == pytest.approx(0.1, abs=0.02)


def test_outside_the_film_reflections_do_not_count():
    row = next(agreements(_all(_mirroring), PAIRS))
    assert row.everywhere.ratio > 2
    assert row.outside_film.ratio == pytest.approx(0.5, abs=0.02)
    assert 0.1 < row.outside_film.pixels / row.everywhere.pixels < 0.9
    pair = warped_pair(*_all(_mirroring)[:2])
    assert not (pair.dry & (pair.of.film > 0.05)).any()
    assert row.outside_film.pixels == np.count_nonzero(pair.dry)


def test_captures_have_no_before_and_views_that_share_nothing_are_passed_by():
    row = next(agreements(_all(lambda view: RainyView(view, view.image)), PAIRS, has_clear=False))
    assert row.everywhere.before is None and isnan(row.everywhere.ratio) and row.everywhere.after.rmse > 0
    views = _all(_alike)
    blind = replace(views[1].clear, depth=np.zeros_like(views[1].clear.depth), sky=np.zeros_like(views[1].clear.sky))
    rows = list(agreements([views[0], RainyView(blind, blind.image), views[2]], [(0, 1), (0, 2)]))
    assert [row.to for row in rows] == ["third"]


def test_errors_are_those_of_a_plain_computation():
    random = np.random.default_rng(2)
    view, other = random.random((2, 8, 9, 3)).astype(np.float32)
    mask = random.random((8, 9)) > 0.5
    calls = []

    def perceived(first, second, where):
        calls.append((first is other, second is view, where is mask))
        return 0.25

    found = warp_error(view, other, mask, perceived)
    squares = [(other[y, x, c] - view[y, x, c]) ** 2 for y, x in np.argwhere(mask) for c in range(3)]
    assert found.rmse == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6)
    assert found.contrast == pytest.approx(np.sqrt(np.var(view[mask], axis=0).mean()), rel=1e-6)
    assert (found.lpips, calls) == (0.25, [(True, True, True)])
    with pytest.raises(ValueError, match="no pixel"):
        warp_error(view, other, np.zeros((8, 9), bool))


def test_means_count_every_pixel_alike():
    small = WarpAgreement(100, WarpError(0.2, 0.4, 0.3), WarpError(0.1, 0.4, 0.1))
    large = WarpAgreement(300, WarpError(0.1, 0.2, 0.1), WarpError(0.1, 0.4, 0.1))
    mean = pool_errors([small, large])
    assert mean.pixels == 400
    assert mean.after.rmse == pytest.approx(np.sqrt((100 * 0.04 + 300 * 0.01) / 400))
    assert mean.after.lpips == pytest.approx(0.15)
    assert mean.ratio == pytest.approx(np.sqrt(1.75))
    assert mean.lpips_ratio == pytest.approx(1.5)
    assert pool_errors([]) is None


@pytest.fixture
def written(tmp_path):
    for name, make in (("alike", _alike), ("mirroring", _mirroring)):
        record = TransferRecord(name, "street", {"seed": 1})
        for _ in write_transferred(tmp_path / name, iter(_all(make)), record):
            pass
    return tmp_path


def test_folders_are_compared_next_to_each_other(written):
    folders = [str(written / "alike"), str(written / "mirroring")]
    page, sheet = written / "c.html", written / "c.png"
    options = ["--contact-sheet", str(sheet), "--contact-sheet-pairs", "1", "--report", str(page)]
    assert run(["evaluate", "consistency", *folders, *options]) == 0
    report = json.loads((written / "c.json").read_text())
    alike, mirroring = report["means"]
    assert (alike["method"], alike["settings"], alike["pairs"]) == ("alike", {"seed": 1}, 8)
    assert alike["ratio"] == pytest.approx(0.5, abs=0.02)  # bytes
    assert alike["outside_film"] == {"pixels": 0}
    assert mirroring["ratio"] > 2
    assert mirroring["outside_film"]["ratio"] == pytest.approx(0.5, abs=0.03)
    assert len(report["rows"]) == 16
    assert {row["of"] for row in report["rows"]} == {"first", "second", "third", "left"}
    assert report["rows"][0]["rmse_before"] == report["rows"][8]["rmse_before"]
    pixels = np.asarray(Image.open(sheet))
    assert pixels.shape[1] > 1000 and pixels.std() > 20
    text = unescape(page.read_text())
    assert set(report["inputs"]) == set(folders) and report["versions"]["gsrain"]
    assert all(each in text for each in (report["command"], *report["inputs"].values()))
    assert f">{255 * mirroring['rmse_after']:.2f}<" in text and text.count("data:image/jpeg") == 1


def test_a_capture_of_another_tool_has_only_an_after(written):
    capture = written / "alike"
    (capture / "transfer.json").unlink()
    assert run(["evaluate", "consistency", str(capture), "--json", str(written / "c.json")]) == 0
    mean = json.loads((written / "c.json").read_text())["means"][0]
    assert mean["rmse_before"] is None
    assert mean["ratio"] is None
    assert 0.001 < mean["rmse_after"] < 0.05


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        ((), "DIR"),
        (("nowhere",), "nowhere"),
        (("alike", "--water-film", "2"), "--water-film 2"),
        (("alike", "--lpips", "none.pth"), "none.pth"),
        (("alike", "few"), "few: .*'left'"),
    ],
)
def test_bad_input_is_named(arguments, names, written, capsys, monkeypatch):
    monkeypatch.chdir(written)
    for _ in write_transferred(written / "few", iter(_all(_alike)[:2]), TransferRecord("few", "street")):
        pass
    assert run(["evaluate", "consistency", *arguments]) == BAD_INPUT
    assert re.search(names, capsys.readouterr().err)


def test_lpips_is_told_where_weights_are_given(written, monkeypatch):
    pytest.importorskip("torch")
    from evaluation.random_lpips import random_weights

    random_weights("alex", seed=4).write(written / "lpips.npz")
    monkeypatch.setenv("GSRAIN_LPIPS_WEIGHTS", str(written / "lpips.npz"))
    few = written / "few"
    for _ in write_transferred(few, iter(_all(_unlike)[:2]), TransferRecord("unlike", "street")):
        pass
    assert run(["evaluate", "consistency", str(few), "--lpips", "alex", "--json", str(written / "c.json")]) == 0
    mean = json.loads((written / "c.json").read_text())["means"][0]
    assert mean["lpips_after"] > mean["lpips_before"] > 0
    assert mean["lpips_ratio"] == pytest.approx(mean["lpips_after"] / mean["lpips_before"])
