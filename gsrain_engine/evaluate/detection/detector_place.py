"""Where a detector is looked for on a person's machine, and how to get one."""

import os
from pathlib import Path

import platformdirs

PLACE = "GSRAIN_DETECTOR"
"""Environment variable with the ONNX file of a detector, or a folder with one."""

_URL = "https://github.com/Megvii-BaseDetection/YOLOX/releases/download/0.1.1rc0/yolox_nano.onnx"


def detector_place() -> Path:
    """Return the file or folder of GSRAIN_DETECTOR, else the folder for detectors among the person's data."""
    own = os.environ.get(PLACE)
    return Path(own) if own else platformdirs.user_data_path("gsrain", appauthor=False) / "detectors"


def find_detector() -> Path:
    """Return the ONNX file of the detector on this machine, the first by name where there are several.

    Raises FileNotFoundError, with where it was looked for and how to get one.
    """
    place = detector_place()
    files = [place] if place.is_file() else sorted(place.glob("*.onnx"))
    if files:
        return files[0]
    raise FileNotFoundError(
        f"no detector (.onnx) at {place}: put one there, for example {_URL} (3.7 MB, Apache-2.0), "
        f"or name its file by --detector or {PLACE}"
    )
