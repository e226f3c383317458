"""Calibration files: written, read again, and those that ship."""

import math

import msgspec
import numpy as np
import pytest

from gsrain_engine.rain.calibration import (
    Provenance,
    RowConfidence,
    SourceFile,
    calibration_names,
    load_calibration,
    save_calibration,
)
from gsrain_engine.rain.properties import DropSizes


def test_a_calibration_with_confidence_and_provenance_comes_back(tmp_path):
    published = load_calibration("published")
    confidence = RowConfidence(density_m3=(200.0, 300.5), shape=(9.0, 10.25), scale_mm=(0.07, 0.08))
    fitted = msgspec.structs.replace(
        published,
        rows=tuple(msgspec.structs.replace(row, confidence=confidence) for row in published.rows),
        provenance=Provenance(
            files=(SourceFile(name="a.dat", sha256="0" * 64),),
            instrument="OTT Parsivel",
            first="2018-10-26T18:43:01",
            records=10,
            records_used=9,
            method="by hand",
        ),
    )
    path = tmp_path / "fitted.yaml"
    save_calibration(fitted, path)
    assert load_calibration(str(path)) == fitted
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_not_known_is_not_written(tmp_path):
    path = tmp_path / "published.yaml"
    save_calibration(load_calibration("published"), path)
    text = path.read_text()
    assert "confidence" not in text and "provenance" not in text and "null" not in text
    assert load_calibration(str(path)) == load_calibration("published")


def test_an_unknown_field_is_refused(tmp_path):
    path = tmp_path / "wrong.yaml"
    save_calibration(load_calibration("published"), path)
    path.write_text(path.read_text().replace("shape: 9.705", "shape: 9.705, color: 3"))
    with pytest.raises(ValueError, match="wrong.yaml: .*color.*rows"):
        load_calibration(str(path))


def test_what_ships():
    assert {"locarno_2018", "marshall_palmer", "published"} <= set(calibration_names())
    for name in calibration_names():
        assert load_calibration(name).name == name
    assert load_calibration("locarno_2018").provenance.records == 6526


def test_marshall_and_palmers_rows_are_their_law():
    d = np.array([0.3, 1.0, 2.5])
    calibration = load_calibration("marshall_palmer")
    for row in calibration.rows:
        slope = 4.1 * row.intensity_mm_h**-0.21
        inside = math.exp(-0.1 / row.scale_mm) - math.exp(-8 / row.scale_mm)
        spectrum = row.density_m3 * np.exp(-d / row.scale_mm) / (row.scale_mm * inside)
        assert row.shape == 1
        assert spectrum == pytest.approx(8000 * np.exp(-slope * d), rel=1e-3)
        sizes = DropSizes(row.shape, row.scale_mm)
        implied = 6e-4 * np.pi * row.density_m3 * sizes.expectation(lambda x: calibration.velocity(x) * x**3)
        assert 1.0 < implied / row.intensity_mm_h < 1.2
