"""`gsrain doctor` and the detector of camera-idm."""

import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from app import doctor
from evaluation.detection.tiny_onnx import NAMES, rows, write_constant
from gsrain_engine.evaluation.detection.detector import PLACE


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Empty folder for the user's detectors."""
    monkeypatch.delenv(PLACE, raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "gsrain" / "detectors"


def test_a_missing_detector_comes_with_where_to_put_one_and_where_to_get_it(folder):
    finding = doctor.find_detector_file()
    assert not finding.found
    assert str(folder) in finding.what and "https://" in finding.what and "Apache-2.0" in finding.what


def test_a_detector_is_opened(folder):
    folder.mkdir(parents=True)
    file = write_constant(folder / "seer.onnx", [rows()], (48, 64), NAMES)
    assert doctor.find_detector_file() == (doctor.find_detector_file().name, True, f"{file} (sees 64 x 48 px)")
    file.write_bytes(b"nothing of the kind")
    finding = doctor.find_detector_file()
    assert not finding.found and "seer.onnx" in finding.what
