"""Consistency: it depends on whether a transfer does the same in every view; reflections in water do not count."""

import json
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from PIL import Image

from app.main import run
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

from .street_views import street_views

PAIRS = [(0, 1), (1, 0), (2, 1), (3, 1)]


def _alike(view):
    """Darker in the same way everywhere."""
    return RainyView(view, 0.5 * view.image)


def _unlike(view):
    """Another tint in each view."""
    tint = {"first": 0.1, "second": -0.1}.get(view.name, 0.0)
    return RainyView(view, np.clip(0.5 * view.image + 0.2 + np.float32(tint), 0, 1))


def _mirroring(view):
    """Stripes that stay where they are in the picture, on flat ground, which is the film."""
    film = (view.normals[..., 2] > 0.9).astype(np.float32)
    stripes = (np.arange(view.image.shape[1]) // 20 % 2).astype(np.float32)[None, :, None]
    image = np.where(film[..., None] > 0, 0.5 * view.image + 0.5 * stripes, 0.5 * view.image)
    return RainyView(view, image.astype(np.float32), film)


def _all(make):
    return [make(view) for view in street_views().values()]


def test_errors_depend_on_what_a_transfer_does_in_each_view():
    rows = list(agreements(_all(_alike), PAIRS))
    assert len(rows) == len(PAIRS)
    for row in rows:
        assert row.everywhere.ratio == pytest.approx(0.5, abs=1e-3)
        assert row.everywhere.contrast_ratio == pytest.approx(1, abs=1e-3)
        assert row.outside_film is None
    rows = list(agreements(_all(_unlike), PAIRS))
    assert [rows[k].everywhere.after.rmse for k in (0, 3)] == pytest.approx([0.2, 0.1], abs=0.02)
    assert rows[0].everywhere.ratio > 5


def test_reflections_of_the_film_do_not_count():
    row = next(agreements(_all(_mirroring), PAIRS))
    assert row.everywhere.ratio > 2
    assert row.outside_film.ratio == pytest.approx(0.5, abs=0.02)
    assert 0.1 < row.outside_film.pixels / row.everywhere.pixels < 0.9
    pair = warped_pair(*_all(_mirroring)[:2])
    assert not (pair.dry & (pair.of.film > 0.05)).any()
    assert row.outside_film.pixels == np.count_nonzero(pair.dry)


def test_views_without_overlap_are_skipped():
    views = _all(_alike)
    blind = replace(views[1].clear, depth=np.zeros_like(views[1].clear.depth), sky=np.zeros_like(views[1].clear.sky))
    rows = list(agreements([views[0], RainyView(blind, blind.image), views[2]], [(0, 1), (0, 2)]))
    assert [row.to for row in rows] == ["third"]


def test_errors_equal_a_plain_computation():
    random = np.random.default_rng(2)
    view, other = random.random((2, 8, 9, 3)).astype(np.float32)
    mask = random.random((8, 9)) > 0.5
    calls = []

    def perceived(*images):
        calls.append(images)
        return 0.25

    found = warp_error(view, other, mask, perceived)
    squares = [(other[y, x, c] - view[y, x, c]) ** 2 for y, x in np.argwhere(mask) for c in range(3)]
    assert found.rmse == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6)
    assert found.contrast == pytest.approx(np.sqrt(np.var(view[mask], axis=0).mean()), rel=1e-6)
    ((first, second, where),) = calls
    assert found.lpips == 0.25 and first is other and second is view and where is mask
    with pytest.raises(ValueError, match="no pixel"):
        warp_error(view, other, np.zeros((8, 9), bool))


def test_pooled_errors_have_equal_weight_per_pixel():
    small = WarpAgreement(100, WarpError(0.2, 0.4, 0.3), WarpError(0.1, 0.4, 0.1))
    large = WarpAgreement(300, WarpError(0.1, 0.2, 0.1), WarpError(0.1, 0.4, 0.1))
    mean = pool_errors([small, large])
    assert mean.pixels == 400
    assert mean.after.rmse == pytest.approx(np.sqrt((100 * 0.04 + 300 * 0.01) / 400))
    assert mean.after.contrast == pytest.approx(np.sqrt((100 * 0.16 + 300 * 0.04) / 400))
    assert mean.after.lpips == pytest.approx(0.15)
    assert (mean.ratio, mean.lpips_ratio) == pytest.approx((np.sqrt(1.75), 1.5))
    assert pool_errors([]) is None


def _write(folder, make, views=4):
    for _ in write_transferred(folder, iter(_all(make)[:views]), TransferRecord(folder.name, "street", {"seed": 1})):
        pass


@pytest.fixture
def written(tmp_path):
    _write(tmp_path / "alike", _alike)
    _write(tmp_path / "mirroring", _mirroring)
    _write(tmp_path / "few", _unlike, 2)
    return tmp_path


def _means(folder, *arguments):
    assert run(["evaluate", "consistency", *arguments, "--json", str(folder / "c.json")]) == 0
    return json.loads((folder / "c.json").read_text())["means"]


def test_empty_numbers_outside_the_film_are_explained(written, capsys):
    for folder, is_explained in (("mirroring", False), ("alike", True)):
        _means(written, str(written / folder))
        assert ("Empty under dry, since their water film is unknown: " in capsys.readouterr().out) == is_explained


def test_folders_are_compared_with_each_other(written):
    folders = [str(written / "alike"), str(written / "mirroring")]
    page, sheet = written / "c.html", written / "c.png"
    options = ["--contact-sheet", str(sheet), "--contact-sheet-pairs", "1", "--report", str(page)]
    alike, mirroring = _means(written, *folders, *options)
    report = json.loads((written / "c.json").read_text())
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


def test_other_captures_have_no_error_before(written):
    (written / "alike" / "transfer.json").unlink()
    (mean,) = _means(written, str(written / "alike"))
    assert mean["rmse_before"] is None and mean["ratio"] is None
    assert 0.001 < mean["rmse_after"] < 0.05
