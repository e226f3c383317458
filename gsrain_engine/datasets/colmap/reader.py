"""COLMAP reconstructions as captures: its cameras, images and points, in the unit and the axes that COLMAP chose."""

from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from ..capture import Capture, CaptureError, View
from ..files.inside import check_inside
from ..files.picture_file import picture_size, read_color, read_mask
from ..geometry.rigid_poses import rigid_from_quaternion
from ..geometry.scaled_camera import camera_of_picture, checked_camera
from ..geometry.up_direction import up_of_cameras
from ..named_problems import some_names
from ..view_names import sensor_names, view_names
from .binary import read_colmap_binary
from .model import PARAMETERS, ColmapCamera, ColmapImage, ColmapModel
from .text import read_colmap_text

_LAYOUTS = (".", "0", "sparse", "sparse/*", "colmap/sparse/*", "colmap_derived/sparse/*", "distorted/sparse/*")
_IMAGE_FOLDERS = ("images", "input", "image", ".")
_FOLDERS_UP = 4
_LARGEST_NUMBER = 1e12


def recognizes_colmap(path: Path) -> bool:
    """Whether a model lies in the folder, or in one of the usual folders below it."""
    return bool(_models(path))


def read_colmap(path: Path) -> Capture:
    """Read the model with the most images at or below a folder, binary or text; newer rigs and frames aren't needed.

    Images that are missing, broken, or taken by a camera model that OpenCV lacks are left out and named. Masks of
    COLMAP's own layout (masks/NAME.png beside images/, black is left out) come along. Raises `CaptureError`.
    """
    model_folder, *others = sorted(_models(path), key=_images_bytes, reverse=True)
    model = _read_model(model_folder)
    if not model.images:
        raise CaptureError(f"{model_folder}: the model has no registered image")
    unread = some_names([str(each) for each in others])
    problems = [f"Of several models {model_folder} is the largest; unread: {unread}."] if others else []
    names_file = model_folder / ("images.bin" if (model_folder / "images.bin").is_file() else "images.txt")
    folder = _image_folder(path, model_folder, model, names_file)
    check_inside(folder, (image.name for image in model.images), names_file)
    masks = (_mask_file(folder, image.name) for image in model.images)
    check_inside(folder.parent, (str(mask) for mask in masks if mask is not None), names_file)
    images = sorted(model.images, key=lambda image: image.name)
    pictures = [image.name for image in images]
    views: list[View] = []
    left_out: list[str] = []
    for image, name, sensor in zip(images, view_names(pictures), sensor_names(pictures), strict=True):
        try:
            views.append(_view(model, image, folder, name, sensor))
        except CaptureError as error:
            left_out.append(str(error))
    if not views:
        raise CaptureError(f"{model_folder}: none of its {len(images)} images can be used ({left_out[0]})")
    problems += [f"{len(left_out)} of {len(images)} images are left out: {some_names(left_out)}."] if left_out else []
    finite = np.isfinite(model.points).all(axis=1)
    return Capture(
        path.resolve().name,
        tuple(views),
        points_m=model.points[finite] if finite.any() else None,
        point_colors=model.colors[finite] if finite.any() else None,
        is_metric=False,
        up=up_of_cameras([view.camera for view in views]),
        problems=tuple(problems),
    )


def _view(model: ColmapModel, image: ColmapImage, folder: Path, name: str, sensor: str) -> View:
    if image.camera_id not in model.cameras:
        raise CaptureError(f"image {image.name!r} was taken by camera {image.camera_id}, which the model lacks")
    taken_by = model.cameras[image.camera_id]
    file = folder / image.name
    lens = taken_by.lens()  # what OpenCV lacks has no focal length to look for, either
    camera = checked_camera(taken_by.pinhole(_pose(image)), f"camera {taken_by.id} or the pose of {image.name!r}")
    camera = camera_of_picture(camera, picture_size(file), str(file))
    mask = _mask_file(folder, image.name)
    return View(
        name,
        camera,
        partial(read_color, file),
        sensor=sensor,
        lens=lens,
        mask_source=partial(read_mask, mask) if mask is not None else None,
    )


def _pose(image: ColmapImage) -> Float64[np.ndarray, "4 4"]:
    if not all(abs(number) < _LARGEST_NUMBER for number in (*image.quaternion_wxyz, *image.translation)):
        raise CaptureError(f"image {image.name!r} has a pose whose numbers are not finite, or absurd")
    try:
        return rigid_from_quaternion(image.quaternion_wxyz, image.translation)
    except ValueError as error:
        raise CaptureError(f"image {image.name!r}: {error}") from None


def _models(path: Path) -> list[Path]:
    folders = [folder for layout in _LAYOUTS for folder in ([path] if layout == "." else sorted(path.glob(layout)))]
    return [folder for folder in dict.fromkeys(folders) if _is_model(folder)]


def _is_model(folder: Path) -> bool:
    return any(
        all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images")) for suffix in (".bin", ".txt")
    )


def _images_bytes(folder: Path) -> int:
    return max((folder / name).stat().st_size for name in ("images.bin", "images.txt") if (folder / name).is_file())


def _read_model(folder: Path) -> ColmapModel:
    binary = (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file()
    model = read_colmap_binary(folder) if binary else read_colmap_text(folder)
    for camera in model.cameras.values():
        _check_parameters(folder, camera)
    return model


def _check_parameters(folder: Path, camera: ColmapCamera) -> None:
    expected = PARAMETERS.get(camera.model)
    if expected is None:
        raise CaptureError(f"{folder}: camera {camera.id} has the unknown model {camera.model}")
    if len(camera.parameters) != expected:
        counted = f"{len(camera.parameters)} parameters, {camera.model} has {expected}"
        raise CaptureError(f"{folder}: camera {camera.id} has {counted}")


def _image_folder(path: Path, model_folder: Path, model: ColmapModel, names_file: Path) -> Path:
    """Where the pictures lie: beside the model or above it, or in any other folder of `path`.

    It is the one that has the most of the first ones. Raises `CaptureError` where none has any, and where it is a link
    that leads out of the folder it stands in.
    """
    above = [path, *(model_folder.resolve().parents[:_FOLDERS_UP]), model_folder]
    wanted = [image.name for image in model.images[:10]]
    usual = [base / name for base in above for name in _IMAGE_FOLDERS]
    for folders in (usual, [each for each in (*path.glob("*/"), *path.glob("*/*/")) if each.is_dir()]):
        best = max(folders, key=lambda folder: _holds(folder, wanted), default=None)
        if best is not None and _holds(best, wanted):
            check_inside(best.parent, [best.name], names_file)
            return best
    there = path / _IMAGE_FOLDERS[0]
    raise CaptureError(
        f"{model_folder}: none of its {len(model.images)} images lies in {path} ({wanted[0]}, say); put them into "
        f"{there}, or a link to where they are (ln -s FOLDER {there}, and --allow-outside)"
    )


def _holds(folder: Path, names: list[str]) -> int:
    return sum((folder / name).is_file() for name in names)


def _mask_file(folder: Path, name: str) -> Path | None:
    candidates = (folder.parent / "masks" / f"{name}.png", folder.parent / "masks" / Path(name).with_suffix(".png"))
    return next((file for file in candidates if file.is_file()), None)
