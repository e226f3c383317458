"""Comparisons of rain translators: shipped settings, resumed runs, missing views, fingerprints."""

import csv
import io
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gsrain_engine.evaluation.compare_results import (
    ComparedMethod,
    ComparisonPairs,
    TransferComparison,
    comparison_table,
    load_comparison,
    plain_row,
)
from gsrain_engine.evaluation.compare_translators import (
    MethodFolder,
    capture_source,
    choose_figure_views,
    comparison_figure,
    method_folder,
    real_images,
    run_comparison,
)
from gsrain_engine.evaluation.fid import open_extractor
from gsrain_engine.evaluation.fid_features import ExtractorChoice
from gsrain_engine.presets import shipped_config_names
from gsrain_engine.safe_io.fingerprints import input_fingerprint
from tests.app.picture_sets import write_pictures
from tests.training.drive_capture import drive_capture

CLEAR, WET = (ComparedMethod(name=name, method=name) for name in ("clear", "wet"))


@pytest.fixture
def started(tmp_path):
    """A comparison of a drive of four views, and how it is run."""
    real = real_images([write_pictures(tmp_path / "real", 5, 0)], 48)
    comparison = TransferComparison(source="drive", real=(tmp_path / "real",), methods=(CLEAR, WET), resamples=20)
    source = capture_source(drive_capture(4), 48, "drive")
    extractor = open_extractor(ExtractorChoice(name="pixels16"))
    return comparison, lambda: run_comparison(comparison, source, real, extractor, None, tmp_path / "out")


def finished(work):
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


def test_shipped_comparisons_load():
    found = {name: load_comparison(name) for name in shipped_config_names("comparisons")}
    assert found.keys() == {"paper", "paper_waymo", "tiny"} and found["tiny"].extractor == "pixels16"
    _, ours, *_ = found["paper"].methods
    assert [each.name for each in found["paper_waymo"].methods if not each.mutual_attention] == [
        "without mutual attention"
    ]
    for names in ((ours.name,), ("WeatherEdit", ours.name, "clear")):  # in the order of the names
        assert tuple(each.name for each in found["paper"].only(names).methods) == names
    with pytest.raises(ValueError, match="'none'"):
        found["paper"].only(("none",))


def test_stopped_runs_resume_with_the_next_method(started, tmp_path):
    _, work = started
    first = work()
    for _ in range(6):
        next(first)
    first.close()
    assert [each.name for each in (tmp_path / "out").iterdir()] == ["clear"]
    result, second = finished(work()), finished(work())
    assert (result.reused, second.reused) == (("clear",), ("clear", "wet"))
    assert comparison_table(second.rows).markdown == comparison_table(result.rows).markdown
    assert (second.figure == result.figure).all()
    for row, cells in zip(result.rows, csv.DictReader(io.StringIO(comparison_table(result.rows).csv)), strict=True):
        found = row.everywhere
        numbers = [float(cells[name]) for name in ("error before", "error after", "KD-pixels16 x1000", "ratio")]
        expected = [255 * found.before.rmse, 255 * found.after.rmse, 1000 * row.distance.kernel.value, found.ratio]
        assert numbers == pytest.approx(expected)
        assert plain_row(row)["rmse_before"] == found.before.rmse


def test_missing_views_are_omitted(started, tmp_path):
    comparison, work = started
    finished(work())
    source = capture_source(drive_capture(3), 48, "short")
    short = list(method_folder(ComparedMethod(name="short", method="clear"), source, comparison, tmp_path / "out"))[-1]
    clear = MethodFolder(CLEAR, tmp_path / "out" / "clear", None, False)
    paired = ComparisonPairs([short.folder, clear.folder], 2)
    count, everywhere, dry = paired.agreement(clear.folder)
    assert (everywhere.ratio, dry) == (1, None)
    assert 0 < paired.agreement(short.folder)[0] < count

    names = choose_figure_views([short, clear], (), 4)
    assert names == ["0", "1", "2", "3"]
    figure = comparison_figure([clear, short], names)
    height = figure.shape[0]
    missing = figure[height - 100 : height - 20, -300:-20]
    assert (missing == missing[0, 0]).all()
    assert np.ptp(figure[height // 2 + 60 : height - 20, 20:300]) > 30
    with pytest.raises(ValueError, match="'7'"):
        choose_figure_views([clear], ("7",), 4)


def test_a_figure_with_a_column_for_each_camera_shows_one_moment(monkeypatch):
    moments = [f"{moment:04}_{camera}" for moment in range(5) for camera in ("FRONT", "FRONT_LEFT", "FRONT_RIGHT")]
    views = [SimpleNamespace(clear=SimpleNamespace(name=name)) for name in moments]
    monkeypatch.setattr("gsrain_engine.evaluation.compare_translators.read_transferred", lambda folder: views)
    folders, sensors = [MethodFolder(CLEAR, Path(), None, False)], ("FRONT_LEFT", "FRONT", "FRONT_RIGHT")
    chosen = choose_figure_views(folders, (), 3, sensors)
    assert chosen == ["0002_FRONT_LEFT", "0002_FRONT", "0002_FRONT_RIGHT"]
    assert choose_figure_views(folders, (), 3, sensors[:2]) == choose_figure_views(folders, (), 3)


def test_fingerprint_changes_with_files_and_their_times(tmp_path):
    file = tmp_path / "a" / "b.txt"
    file.parent.mkdir()
    file.write_text("one")
    first = input_fingerprint(tmp_path)
    assert input_fingerprint(tmp_path) == first
    os.utime(file, ns=(1, 1))
    second = input_fingerprint(tmp_path)
    (tmp_path / "c.txt").write_text("")
    assert len({first, second, input_fingerprint(tmp_path), input_fingerprint(file)}) == 4
    assert input_fingerprint(tmp_path / "d") == "absent"
