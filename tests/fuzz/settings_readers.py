"""Rows of the table: YAML and JSON in which people say what they want, and notes that the program keeps."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gsrain_engine.appearance.finetune.settings import load_finetuning
from gsrain_engine.appearance.output_folder import TRANSFER, TransferRecord, read_record, write_record
from gsrain_engine.datasets.capture import CaptureError
from gsrain_engine.editor.autosave import Autosave
from gsrain_engine.editor.files import recent_files
from gsrain_engine.editor.preferences import load_preferences
from gsrain_engine.evaluation.compare_results import load_comparison
from gsrain_engine.evaluation.detection.description import load_description
from gsrain_engine.evaluation.detection.ground_truth import read_coco
from gsrain_engine.evaluation.lidar.sensor import SENSORS
from gsrain_engine.evaluation.lidar.session import open_sensor
from gsrain_engine.presets import shipped_config_names
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.rain.properties import rain_properties
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.training.settings import load_settings

from .mutations import damaged_json, damaged_yaml
from .reader import Reader, one_text

_SHIPPED = Path(__file__).resolve().parents[2] / "sample_configs"


def assert_finite(values: Any) -> None:
    """Assert that plain values hold no number that is not finite."""
    waiting = [msgspec.to_builtins(values, enc_hook=str)]
    while waiting:
        value = waiting.pop()
        if isinstance(value, float):
            assert np.isfinite(value), "holds a number that is not finite"
        elif isinstance(value, dict):
            waiting += value.values()
        elif isinstance(value, list | tuple):
            waiting += value


def _settings(
    name: str, folder: str, shipped: str, load: Callable[[str], Any], then: Callable[[Any], Any] = id
) -> Reader:
    """A kind of settings that the program ships samples of."""

    def read(path: Path) -> None:
        found = load(str(path))
        assert_finite(found)
        then(found)

    text = (_SHIPPED / folder / f"{shipped}.yaml").read_text()
    return Reader(name, one_text("settings.yaml", text), read, ValueError, (("*.yaml", damaged_yaml),))


def _calibrated(calibration: Any) -> None:
    """Look at the rain that a calibration makes: numbers as they may be, and none that warns."""
    from gsrain_engine.rain.settings import RainSettings

    for intensity in (0.0, 0.5, 8.5, 100.0):
        with np.errstate(all="ignore"):
            rain_properties(RainSettings(intensity_mm_h=intensity), calibration)


_COCO = {
    "images": [{"id": k, "file_name": f"{k}.png", "width": 64, "height": 48} for k in (1, 2)],
    "annotations": [
        {"id": k, "image_id": 1 + k % 2, "category_id": 3, "bbox": [1.0, 2.5, 30, 40], "iscrowd": k % 2,
         "visibility": 0.5, "distance_m": 12.0, "object": f"car-{k}"}
        for k in range(3)
    ],
    "categories": [{"id": 3, "name": "car"}],
}  # fmt: skip


def _read_coco(path: Path) -> None:
    for objects in read_coco(path).values():
        for each in objects:
            assert np.isfinite(each.box_xyxy).all(), "has a box that is not finite"


def _record(folder: Path) -> Path:
    write_record(folder, TransferRecord("wet", "street", {"seed": 1, "width_px": 512}, np.diag([2.0, 2, 2, 1])))
    return folder


def _read_record(folder: Path) -> None:
    record = read_record(folder)
    assert np.isfinite(record.to_world).all() and record.metres_per_unit > 0


@contextmanager
def _at_home(folder: Path) -> Iterator[None]:
    """Let preferences and notes lie in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME"):
            patch.setenv(name, str(folder))
        yield


def _preferences(folder: Path) -> Path:
    (folder / "gsrain").mkdir()
    (folder / "gsrain/preferences.yaml").write_text("theme: light\nfont_scale: 1.5\nui_scale: 1.0\nautosave_s: 30\n")
    return folder


def _read_preferences(folder: Path) -> None:
    with _at_home(folder):
        preferences, problem = load_preferences()
    assert_finite(preferences)
    if problem is not None:
        raise ValueError(problem)


def _notes(folder: Path) -> Path:
    (folder / "gsrain").mkdir()
    (folder / "gsrain/recent.json").write_text('{"paths": ["/a/scene", "/b/street.ply"]}')
    place = folder / ".scene.autosave"
    (place / "scene").mkdir(parents=True)
    (place / "scene/scene.json").write_text("{}")
    about = {"name": "scene", "home": "/a/scene", "stamp": None}
    (place / "autosave.json").write_text(json.dumps(about))
    return folder


def _read_notes(folder: Path) -> None:
    """The program's own state files: a damaged one counts as absent and is never an error."""
    with _at_home(folder):
        assert all(isinstance(each, Path) for each in recent_files())
        Autosave().found(folder / ".scene.autosave")


SETTINGS_READERS = (
    _settings("rain", "rain", "paper", load_preset),
    _settings("calibration", "calibrations", "published", load_calibration, _calibrated),
    _settings("fitted-calibration", "calibrations", "locarno_2018", load_calibration, _calibrated),
    _settings("detector-description", "detectors", "nanodet", load_description),
    _settings("training-settings", "reconstruct", shipped_config_names("reconstruct")[0], load_settings),
    _settings("finetuning-settings", "finetune", shipped_config_names("finetune")[0], load_finetuning),
    _settings("comparison", "comparisons", shipped_config_names("comparisons")[0], load_comparison),
    Reader("lidar-sensor", one_text("sensor.yaml", msgspec.yaml.encode(next(iter(SENSORS.values()))).decode()),
           lambda path: assert_finite(open_sensor(str(path), {})), ValueError, (("*.yaml", damaged_yaml),)),
    Reader("coco", one_text("labels.json", json.dumps(_COCO)), _read_coco, ValueError, (("*.json", damaged_json),)),
    Reader("transfer-record", _record, _read_record, CaptureError, ((TRANSFER, damaged_json),)),
    Reader("preferences", _preferences, _read_preferences, ValueError, (("preferences.yaml", damaged_yaml),)),
    Reader("notes", _notes, _read_notes, ValueError, (("recent.json", damaged_json), ("autosave.json", damaged_json))),
)  # fmt: skip
"""Settings and notes, and what looks at them."""
