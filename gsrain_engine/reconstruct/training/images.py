"""A capture with other pictures in place of its own: transferred ones, say."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from gsrain_engine.datasets.capture import Capture, CaptureError, View

_ENDINGS = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")


def with_images(capture: Capture, folder: Path) -> Capture:
    """Take each view's picture from a folder: NAME, SENSOR/NAME or the last part of NAME, with any picture's ending.

    Pictures of another size are resized to that of the view. Views without one are left out, and named among the
    problems. Raises CaptureError where the folder has a picture of no view.
    """
    if not folder.is_dir():
        raise CaptureError(f"--images {folder}: no such folder")
    files = {
        file.relative_to(folder).with_suffix("").as_posix(): file
        for file in sorted(folder.rglob("*"))
        if file.suffix.lower() in _ENDINGS
    }
    found = [(view, _file_of(view, files)) for view in capture]
    views = tuple(_with_file(view, file) for view, file in found if file is not None)
    if not views:
        raise CaptureError(f"--images {folder}: has no picture of a view; expected {capture[0].name}.png, for one")
    missing = [view.name for view, file in found if file is None]
    told = (f"{len(missing)} views have no picture in {folder}, {missing[0]!r} for one",) if missing else ()
    return replace(capture, views=views, problems=(*capture.problems, *told))


def _file_of(view: View, files: Mapping[str, Path]) -> Path | None:
    name = PurePosixPath(view.name)
    plain = name.with_suffix("") if name.suffix.lower() in _ENDINGS else name
    asked = [plain.as_posix(), f"{view.sensor}/{plain.name}", plain.name, plain.as_posix().replace("/", "_")]
    return next((files[each] for each in asked if each in files), None)


def _with_file(view: View, file: Path) -> View:
    size = (view.camera.width, view.camera.height)
    return replace(view, image_source=lambda: _pixels(file, size))


def _pixels(file: Path, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    try:
        with Image.open(file) as opened:
            pixels = np.asarray(opened.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:
        raise CaptureError(f"{file}: can't be read as a picture: {error}") from None
    if pixels.shape[1::-1] == size:
        return pixels
    shrinking = pixels.shape[1] > size[0]
    return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_CUBIC)
