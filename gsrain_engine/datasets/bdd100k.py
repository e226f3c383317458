"""BDD-100K: dashcam frames in all weathers, without poses, with weather and time of day from label files.

File names are two groups of eight hexadecimal digits. Labels are one list for all frames (bdd100k_labels_images_*.json,
det_20/det_*.json) or one file a frame (labels/100k/train/NAME.json), each with `name` and `attributes`.
"""

import re
from pathlib import Path
from typing import Any

import msgspec

from ..safe_io.errors import convert_checked
from .capture import Capture, CaptureError, abbreviated_names, omissions
from .capture_folder import capture_without_poses
from .io.arrays import read_json
from .io.images import images_in

_NAME = re.compile(r"[0-9a-f]{8}-[0-9a-f]{8}(-\d{7})?")
_IMAGE_LAYOUTS = ("images", "images/*", "images/*/*", "bdd100k/images/*/*")
_FOLDERS_UP = 4
_FIRST = 20  # number of images of a folder whose names are checked
_MAX_LABEL_FILES = 200_000


class _LabeledFrame(msgspec.Struct):
    """Used fields of a frame's labels; boxes are skipped without being decoded."""

    name: str
    attributes: dict[str, Any] = {}


def recognizes_bdd100k(path: Path) -> bool:
    """Return whether most of the first images in a folder, or in a standard subfolder, are named as in BDD-100K."""
    samples = (images_in(folder)[:_FIRST] for folder in _image_folders(path))
    return any(2 * sum(map(_is_frame, files)) > len(files) for files in samples)


def read_bdd100k(path: Path) -> Capture:
    """Read all frames at or below a folder as independent views, with attributes from label files if found.

    Images with other names, broken frames and label files are listed as problems. Raises `CaptureError` without any
    frame.
    """
    pictures = [file for folder in _image_folders(path) for file in images_in(folder)]
    files = [file for file in pictures if _is_frame(file)]
    others = [file.name for file in pictures if not _is_frame(file)]
    problems: list[str] = []
    if others:
        problems.append(
            f"{len(others)} of {len(pictures)} pictures are left out, for they are not named as frames of BDD-100K "
            f"(0000f77c-6257be58.jpg): {abbreviated_names(others)}."
        )
    return capture_without_poses(path, files, _attributes(path, {file.stem for file in files}, problems), problems)


def _is_frame(file: Path) -> bool:
    return _NAME.fullmatch(file.stem) is not None


def _image_folders(path: Path) -> list[Path]:
    found = [path, *(folder for layout in _IMAGE_LAYOUTS for folder in sorted(path.glob(layout)))]
    return [folder for folder in dict.fromkeys(found) if folder.is_dir()]


def _attributes(path: Path, stems: set[str], problems: list[str]) -> dict[str, dict[str, str]]:
    """Attributes by the frame's name, from label files in the folder or next to its parents."""
    found: dict[str, dict[str, str]] = {}
    broken: list[str] = []
    for file in _label_files(path, stems):
        try:
            rows = convert_checked(read_json(file), list[_LabeledFrame] | _LabeledFrame)
        except ValueError as error:
            broken.append(str(CaptureError(f"{file}: no label file of BDD-100K ({error})")))
            continue
        for row in rows if isinstance(rows, list) else [rows]:
            name = row.name.rpartition(".")[0] or row.name
            if name in stems:
                found[name] = {key: str(value) for key, value in row.attributes.items()}
    problems += omissions(broken, f"{len(broken)} label files")
    return found


def _label_files(path: Path, stems: set[str]) -> list[Path]:
    for base in (path, *path.resolve().parents[:_FOLDERS_UP]):
        folder = base / "labels"
        if folder.is_dir():
            files = sorted(folder.rglob("*.json"))[:_MAX_LABEL_FILES]
            return [file for file in files if not _NAME.fullmatch(file.stem) or file.stem in stems]
        if lists := sorted([*base.glob("bdd100k_labels*.json"), *base.glob("det_*.json")]):
            return lists
    return []
