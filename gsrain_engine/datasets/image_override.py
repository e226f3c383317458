"""Replacement images for views, such as those of a transfer, matched by file name."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
from jaxtyping import UInt8

from ..safe_io.file_names import shortened
from .capture import Capture, CaptureError, CaptureFrame
from .capture_folder import read_capture_folder, recognizes_capture_folder
from .io.images import SUFFIXES, oriented_size, read_color
from .undistort import undistort_frame

_MAX_NAME_BYTES = 200  # maximum bytes of a view's file name without the endings of depth, normals and masks
_PROPORTIONS = 0.05  # tolerance of the aspect ratio between image and view: programs round sizes, but don't crop


@dataclass(frozen=True, slots=True)
class ImageOverride:
    """Images in a folder, by their relative names: NAME, SENSOR/NAME."""

    folder: Path
    files: Mapping[str, Path]
    straight_widths: Mapping[str, int]
    """Width of images known to be without lens distortion, as from a transfer."""

    def file_of(self, name: str, sensor: str = "") -> Path | None:
        """Find the image of a view: NAME, SENSOR/NAME, the last part of NAME, or NAME with _ for each /."""
        return self.files.get(self._key(name, sensor) or "")

    def straight_width(self, name: str, sensor: str = "") -> int | None:
        """Width of the view's image if known to be without lens distortion."""
        return self.straight_widths.get(self._key(name, sensor) or "")

    def left_over(self, views: Iterable[tuple[str, str]]) -> list[str]:
        """Images that match none of the views (name, sensor)."""
        used = {self._key(*view) for view in views}
        return [name for name in self.files if name not in used]

    def _key(self, name: str, sensor: str) -> str | None:
        plain = _plain(name)
        candidates = (plain.as_posix(), f"{sensor}/{plain.name}", plain.name, flat_name(name))
        return next((each for each in candidates if each in self.files), None)


def flat_name(name: str) -> str:
    """File name of a view without suffix: _ for each /, shortened if long."""
    return shortened(_plain(name).as_posix().replace("/", "_").replace("\\", "_"), _MAX_NAME_BYTES)


def _plain(name: str) -> PurePosixPath:
    path = PurePosixPath(name)
    return path.with_suffix("") if path.suffix.lower() in SUFFIXES else path


def find_images(folder: Path) -> ImageOverride:
    """Find images in a folder and below; in a capture folder (a transfer's), only those of its views.

    Raises `CaptureError` if the folder does not exist.
    """
    if not folder.is_dir():
        raise CaptureError(f"--images {folder}: no such folder")
    if recognizes_capture_folder(folder):
        views = read_capture_folder(folder).views
        where = folder if (folder / f"{views[0].name}.png").is_file() else folder / "images"
        files = {view.name: where / f"{view.name}.png" for view in views}
        return ImageOverride(folder, files, {view.name: view.camera.width for view in views if view.lens is None})
    found = sorted(file for file in folder.rglob("*") if file.suffix.lower() in SUFFIXES)
    return ImageOverride(folder, {file.relative_to(folder).with_suffix("").as_posix(): file for file in found}, {})


def with_images(capture: Capture, folder: Path) -> Capture:
    """Take each view's image from a folder: NAME, SENSOR/NAME or the last part of NAME, with any image suffix.

    Images of another size are resized to the view's. A transfer's images have no lens distortion, so their views are
    undistorted, too, at the images' size. Views without an image are omitted and listed as problems, like images
    without a view. Raises `CaptureError` if no image matches a view.
    """
    pictures = find_images(folder)
    views: list[CaptureFrame] = []
    missing: list[str] = []
    for view in capture:
        file = pictures.file_of(view.name, view.sensor)
        if file is None:
            missing.append(view.name)
        else:
            views.append(_with_file(view, file, pictures))
    if not views:
        raise CaptureError(f"--images {folder}: has no picture of a view; expected {capture[0].name}.png, for one")
    problems = list(capture.problems)
    if missing:
        problems.append(f"{len(missing)} views have no picture in {folder}, {missing[0]!r} for one")
    unused = pictures.left_over((view.name, view.sensor) for view in capture)
    if unused:
        problems.append(f"{len(unused)} pictures in {folder} belong to no view, {unused[0]!r} for one")
    return replace(capture, views=tuple(views), problems=tuple(problems))


def _with_file(view: CaptureFrame, file: Path, pictures: ImageOverride) -> CaptureFrame:
    width = pictures.straight_width(view.name, view.sensor)
    view = view if width is None else undistort_frame(view, width)
    size = (view.camera.width, view.camera.height)
    return replace(view, image_source=lambda: sized_image(file, size))


def sized_image(file: Path, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """Read an image as display color and resize it to (width, height).

    Raises `CaptureError` if it is broken or its aspect ratio differs.
    """
    (width, height), upright = oriented_size(file, size, _PROPORTIONS)
    if abs(width * size[1] / (height * size[0]) - 1) > _PROPORTIONS:
        raise CaptureError(f"{file}: is {width}x{height} px, its view is {size[0]}x{size[1]}: other proportions")
    pixels = read_color(file, upright)
    if pixels.shape[1::-1] == size:
        return pixels
    shrinking = pixels.shape[1] > size[0]
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_CUBIC))
