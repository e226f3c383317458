"""COLMAP reconstructions, binary and text, and captures made of them."""

import struct
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from io import TextIOWrapper
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from ..safe_io.limits import open_file
from ..scene.camera import Camera
from ..scene.lens import Lens
from .capture import (
    Capture,
    CaptureError,
    CaptureFrame,
    abbreviated_names,
    check_inside,
    omissions,
    sensor_names,
    view_names,
)
from .geometry import Pose, camera_of_image, checked_camera, estimate_up_direction, rigid_from_quaternion
from .io.arrays import read_bytes
from .io.images import name_on_disk, oriented_size, read_color, read_mask
from .io.records import read_point_ply

_LAYOUTS = ("0", "sparse", "sparse/*", "colmap/sparse/*", "colmap_derived/sparse/*", "distorted/sparse/*",
            "dense/sparse", "dense/*/sparse")  # fmt: skip
_IMAGE_FOLDERS = ("images", "input", "image", ".")
_FOLDERS_UP = 4
_LARGEST_NUMBER = 1e12


def recognizes_colmap(path: Path) -> bool:
    """Return whether the folder, or a standard subfolder, holds a model."""
    return bool(_models(path))


def read_colmap(path: Path) -> Capture:
    """Read the model with the most images at or below a folder, binary or text.

    Images that are missing, broken, or of a camera model that OpenCV lacks are omitted and listed as problems. Masks in
    COLMAP's layout (masks/NAME.png next to images/, black is masked out) are included.
    COLMAP's newer rigs and frames are ignored. Raises `CaptureError`.
    """
    folders = sorted(_models(path), key=lambda folder: _images_file(folder).stat().st_size, reverse=True)
    model_folder, model, folder = _model_with_images(path, folders)
    others = [each for each in folders if each != model_folder]
    unread = abbreviated_names([str(each) for each in others])
    problems = (
        [f"Of several models {model_folder} is read, the largest with images; unread: {unread}."] if others else []
    )
    names_file = _images_file(model_folder)
    check_inside(folder.parent, [folder.name], names_file)
    check_inside(folder, (name_on_disk(folder, image.name) for image in model.images), names_file)
    masks = (_mask_file(folder, image.name) for image in model.images)
    check_inside(folder.parent, (str(mask) for mask in masks if mask is not None), names_file)
    images = sorted(model.images, key=lambda image: image.name)
    pictures = [image.name for image in images]
    views: list[CaptureFrame] = []
    left_out: list[str] = []
    for image, name, sensor in zip(images, view_names(pictures), sensor_names(pictures), strict=True):
        try:
            views.append(_view(model, image, folder, name, sensor))
        except CaptureError as error:
            left_out.append(str(error))
    if not views:
        raise CaptureError(f"{model_folder}: none of its {len(images)} images can be used ({left_out[0]})")
    problems += omissions(left_out, f"{len(left_out)} of {len(images)} images")
    finite = np.isfinite(model.points).all(axis=1)
    return Capture(
        path.resolve().name,
        tuple(views),
        points_m=model.points[finite] if finite.any() else None,
        point_colors=model.colors[finite] if finite.any() else None,
        is_metric=False,
        up=estimate_up_direction([view.camera for view in views]),
        problems=tuple(problems),
    )


def _view(model: "ColmapModel", image: "ColmapImage", folder: Path, name: str, sensor: str) -> CaptureFrame:
    if image.camera_id not in model.cameras:
        raise CaptureError(f"image {image.name!r} was taken by camera {image.camera_id}, which the model lacks")
    calibration = model.cameras[image.camera_id]
    lens = calibration.lens()  # first, because models that OpenCV lacks have no focal length to read
    if not all(abs(number) < _LARGEST_NUMBER for number in (*image.quaternion_wxyz, *image.translation)):
        raise CaptureError(f"image {image.name!r} has a pose whose numbers are not finite, or absurd")
    try:
        pose = rigid_from_quaternion(image.quaternion_wxyz, image.translation)
    except ValueError as error:
        raise CaptureError(f"image {image.name!r}: {error}") from None
    camera = checked_camera(calibration.pinhole(pose), f"camera {calibration.id} or the pose of {image.name!r}")
    file, mask = folder / name_on_disk(folder, image.name), _mask_file(folder, image.name)
    size, upright = oriented_size(file, (camera.width, camera.height))
    camera = camera_of_image(camera, size, str(file))
    mask_source = None if mask is None else partial(read_mask, mask)
    read = partial(read_color, file, upright)
    return CaptureFrame(name, camera, read, sensor=sensor, lens=lens, mask_source=mask_source)


def _models(path: Path) -> list[Path]:
    folders = [path, *(folder for layout in _LAYOUTS for folder in sorted(path.glob(layout)))]
    return [folder for folder in dict.fromkeys(folders) if _suffix(folder) is not None]


def _suffix(folder: Path) -> str | None:
    """Suffix of a model's files: .bin before .txt; None without a model."""
    pairs = ((suffix, [folder / f"{name}{suffix}" for name in ("cameras", "images")]) for suffix in (".bin", ".txt"))
    return next((suffix for suffix, files in pairs if all(file.is_file() for file in files)), None)


def _images_file(folder: Path) -> Path:
    return folder / f"images{_suffix(folder)}"


def _points_file(folder: Path) -> Path | None:
    """Points of a model: in the format of its other files, in the other one, or as PLY."""
    files = [folder / f"points3D{suffix}" for suffix in (_suffix(folder), ".bin", ".txt", ".ply")]
    return next((file for file in files if file.is_file()), None)


def _model_with_images(path: Path, folders: list[Path]) -> tuple[Path, "ColmapModel", Path]:
    """First model with images next to it or above it, and their folder; otherwise the first, images anywhere in `path`.

    So the model of undistorted images is not mixed with their originals. Raises `CaptureError` if there are no images.
    """
    first, *_ = folders
    largest = _read_model(first)
    for model_folder in folders:
        try:
            model = largest if model_folder == first else _read_model(model_folder)
        except CaptureError:  # the smaller ones are only alternatives
            continue
        above = [path, *(model_folder.resolve().parents[:_FOLDERS_UP]), model_folder]
        folder = _folder_with_images([base / name for base in above for name in _IMAGE_FOLDERS], model)
        if folder is not None:
            return model_folder, model, folder
    below = [each for each in (*path.glob("*/"), *path.glob("*/*/")) if each.is_dir()]
    folder = _folder_with_images(below, largest)
    if folder is not None:
        return first, largest, folder
    there, images = path / _IMAGE_FOLDERS[0], largest.images
    raise CaptureError(
        f"{first}: none of its {len(images)} images lies in {path} ({images[0].name}, say); put them into "
        f"{there}, or a link to where they are (ln -s FOLDER {there}, and --allow-outside)"
    )


def _folder_with_images(folders: list[Path], model: "ColmapModel") -> Path | None:
    """Folder with most of a model's first ten images; None if none has any."""
    names = [image.name for image in model.images[:10]]

    def count(folder: Path) -> int:
        return sum((folder / name_on_disk(folder, name)).is_file() for name in names)

    best = max(folders, key=count, default=None)
    return best if best is not None and count(best) else None


def _mask_file(folder: Path, name: str) -> Path | None:
    if not Path(name).name:  # "." of a damaged file
        return None
    names = dict.fromkeys((name_on_disk(folder, name), name.replace("\\", "/")))
    masks = folder.parent / "masks"
    candidates = [mask for each in names for mask in (masks / f"{each}.png", masks / Path(each).with_suffix(".png"))]
    return next((file for file in candidates if file.is_file()), None)


# Models

_PARAMETERS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
    "SIMPLE_DIVISION": 4,
    "DIVISION": 5,
    "SIMPLE_FISHEYE": 3,
    "FISHEYE": 4,
    "EUCM": 6,
    "EQUIRECTANGULAR": 2,
}
"""Number of parameters of each camera model, in the order of the model numbers in binary files."""

_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_FISHEYE")
_STRAIGHT = ("SIMPLE_PINHOLE", "PINHOLE")
_BROWN = ("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
_EQUIDISTANT = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_FISHEYE", "FISHEYE")


PANORAMA_ADVICE = (
    "cut perspective pictures out of the panoramas, as COLMAP's panorama_sfm.py or nerfstudio's "
    "ns-process-data --camera-type equirectangular does"
)


@dataclass(frozen=True, slots=True)
class ColmapCamera:
    """Intrinsics shared by images. The center of the first pixel is (0.5, 0.5), as in GSRAIN."""

    id: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]

    def lens(self) -> Lens | None:
        """Distortion in OpenCV's terms. Raises `CaptureError` for a model that OpenCV lacks."""
        bends = self.parameters[3 if self.model in _ONE_FOCAL else 4 :]
        padded = (*bends, *[0.0] * (4 - len(bends)))
        if self.model in _STRAIGHT or (self.model in _BROWN and not any(bends)):
            return None
        if self.model in _BROWN:
            return Lens("opencv", padded)
        if self.model in _EQUIDISTANT:
            return Lens("fisheye", padded)
        usable = ", ".join((*_STRAIGHT, *_BROWN, *_EQUIDISTANT))
        advice = (
            PANORAMA_ADVICE if self.model == "EQUIRECTANGULAR" else "COLMAP's image_undistorter makes such pictures"
        )
        raise CaptureError(
            f"camera {self.id} has the model {self.model}, which OpenCV doesn't have; usable are {usable}; {advice}"
        )

    def pinhole(self, world_to_camera: Pose) -> Camera:
        """Camera at a pose, without distortion."""
        p = self.parameters
        fx, fy, cx, cy = (p[0], p[0], p[1], p[2]) if self.model in _ONE_FOCAL else p[:4]
        return Camera(self.width, self.height, fx, fy, cx, cy, world_to_camera)


@dataclass(frozen=True, slots=True, eq=False)
class ColmapImage:
    """A registered image with its camera and pose."""

    name: str
    """Path below the image folder."""
    camera_id: int
    quaternion_wxyz: tuple[float, float, float, float]
    """World to camera rotation, not necessarily normalized; `translation` belongs to it."""
    translation: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class ColmapModel:
    """One reconstruction, in its own unit and axes."""

    cameras: dict[int, ColmapCamera]
    images: tuple[ColmapImage, ...]
    points: Float64[np.ndarray, "p 3"]
    colors: UInt8[np.ndarray, "p 3"]


def _read_model(folder: Path) -> ColmapModel:
    """Read a model, binary or text; raises `CaptureError` for damaged files and unknown cameras."""
    if _suffix(folder) == ".bin":
        cameras, images = _cameras(folder / "cameras.bin"), _images(folder / "images.bin")
    else:
        cameras, images = _text_cameras(folder / "cameras.txt"), _text_images(folder / "images.txt")
    file = _points_file(folder)
    points, colors = _NO_POINTS if file is None else _READERS_OF_POINTS[file.suffix](file)
    for camera in cameras.values():
        expected = _PARAMETERS.get(camera.model)
        if expected is None:
            raise CaptureError(f"{folder}: camera {camera.id} has the unknown model {camera.model}")
        if len(camera.parameters) != expected:
            counted = f"{len(camera.parameters)} parameters, {camera.model} has {expected}"
            raise CaptureError(f"{folder}: camera {camera.id} has {counted}")
    if not images:
        raise CaptureError(f"{folder}: the model has no registered image")
    return ColmapModel(cameras, images, points, colors)


# Binary files

_MODELS = tuple(_PARAMETERS)
_CAMERA, _IMAGE, _POINT = struct.Struct("<IiQQ"), struct.Struct("<I7dI"), struct.Struct("<Q3d3BdQ")
_COUNT = struct.Struct("<Q")
_OBSERVATION_BYTES, _TRACK_BYTES = 24, 8
_LONGEST_NAME = 4096


class _ByteCursor:
    """Cursor over a file's bytes that checks each read against the rest of the file."""

    def __init__(self, file: Path) -> None:
        self.file, self.data, self.at = file, read_bytes(file), 0

    def take(self, layout: struct.Struct) -> tuple[Any, ...]:
        start = self.at
        self.skip(layout.size)
        return layout.unpack_from(self.data, start)

    def skip(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise CaptureError(f"{self.file}: is cut off at byte {len(self.data)}, {size} more were to come")
        self.at += size

    def count(self, smallest: int) -> int:
        """Read a count of records of at least `smallest` bytes each."""
        (count,) = self.take(_COUNT)
        if count > (len(self.data) - self.at) // smallest:
            raise CaptureError(f"{self.file}: says {count} records, its {len(self.data)} bytes can't hold them")
        return count

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + _LONGEST_NAME)
        if end < 0:
            raise CaptureError(f"{self.file}: the image's name at byte {self.at} has no end")
        text = self.data[self.at : end]
        self.at = end + 1
        return text.decode("utf-8", errors="surrogateescape")


def _cameras(file: Path) -> dict[int, ColmapCamera]:
    data = _ByteCursor(file)
    cameras: dict[int, ColmapCamera] = {}
    for _ in range(data.count(_CAMERA.size)):
        id_, model, width, height = data.take(_CAMERA)
        if not 0 <= model < len(_MODELS):
            raise CaptureError(f"{file}: camera {id_} has model number {model}, known are 0..{len(_MODELS) - 1}")
        parameters = data.take(struct.Struct(f"<{_PARAMETERS[_MODELS[model]]}d"))
        cameras[id_] = ColmapCamera(id_, _MODELS[model], width, height, parameters)
    return cameras


def _images(file: Path) -> tuple[ColmapImage, ...]:
    data = _ByteCursor(file)
    images: list[ColmapImage] = []
    for _ in range(data.count(_IMAGE.size + 1 + _COUNT.size)):
        _, qw, qx, qy, qz, tx, ty, tz, camera_id = data.take(_IMAGE)
        images.append(ColmapImage(data.name(), camera_id, (qw, qx, qy, qz), (tx, ty, tz)))
        data.skip(data.count(_OBSERVATION_BYTES) * _OBSERVATION_BYTES)
    return tuple(images)


_Points = tuple[Float64[np.ndarray, "p 3"], UInt8[np.ndarray, "p 3"]]


def _points(file: Path) -> _Points:
    data = _ByteCursor(file)
    count = data.count(_POINT.size)
    points, colors = np.empty((count, 3)), np.empty((count, 3), np.uint8)
    for k in range(count):
        _, x, y, z, r, g, b, _, length = data.take(_POINT)
        points[k] = x, y, z
        colors[k] = r, g, b
        data.skip(length * _TRACK_BYTES)
    return points, colors


# Text files

_MAX_TEXT_BYTES = 1 << 34


def _text_cameras(file: Path) -> dict[int, ColmapCamera]:
    cameras: dict[int, ColmapCamera] = {}
    for number, line in _records(_lines(file)):
        with _expecting(file, number, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"):
            id_, model, width, height, *parameters = line.split()
            numbers = tuple(float(each) for each in parameters)
            cameras[int(id_)] = ColmapCamera(int(id_), model, int(width), int(height), numbers)
    return cameras


def _text_images(file: Path) -> tuple[ColmapImage, ...]:
    """Read two lines an image; the second, with the image's observations, may be empty and is skipped.

    Some programs (NVIDIA's cuSFM) write one line an image: a second line that is no list of observations is an image.
    """
    images: list[ColmapImage] = []
    lines = _lines(file)
    while (record := next(_records(lines), None)) is not None:
        number, line = record
        with _expecting(file, number, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"):
            _, qw, qx, qy, qz, tx, ty, tz, camera_id, name = line.split(maxsplit=9)
            turn, shift = (float(qw), float(qx), float(qy), float(qz)), (float(tx), float(ty), float(tz))
            images.append(ColmapImage(name, int(camera_id), turn, shift))
        following = next(lines, None)
        if following is not None and _is_image(following[1]):
            lines = chain([following], lines)
    return tuple(images)


def _text_points(file: Path) -> _Points:
    rows: list[list[float]] = []
    for number, line in _records(_lines(file)):
        with _expecting(file, number, "POINT3D_ID X Y Z R G B ERROR TRACK[] with colors within 0..255"):
            row = [float(each) for each in line.split(maxsplit=7)[1:7]]
            if len(row) != 6 or not all(0 <= color <= 255 for color in row[3:]):
                raise ValueError
            rows.append(row)
    table = np.array(rows, np.float64).reshape(-1, 6)
    return table[:, :3], table[:, 3:].astype(np.uint8)


def _is_image(line: str) -> bool:
    """Return whether a line has an image's ten fields, and is no list of observations: triples of numbers."""
    fields = line.split(maxsplit=9)
    if len(fields) < 10 or not (fields[0].isdecimal() and fields[8].isdecimal()):
        return False
    words = [*fields[:9], *fields[9].split()]
    return not (len(words) % 3 == 0 and all(_is_number(word) for word in words))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _ply_points(file: Path) -> _Points:
    """Points of points3D.ply, which 3DGS and its kin write in place of points3D.bin; gray without colors."""
    points, colors = read_point_ply(file)
    return points, np.full((len(points), 3), _GRAY, np.uint8) if colors is None else colors


_GRAY = 128
_NO_POINTS: _Points = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
_READERS_OF_POINTS = {".bin": _points, ".txt": _text_points, ".ply": _ply_points}


@contextmanager
def _expecting(file: Path, number: int, fields: str) -> Generator[None]:
    """Turn the ValueError of a line into a `CaptureError` that names the expected fields."""
    try:
        yield
    except ValueError:
        raise CaptureError(f"{file}, line {number}: expected {fields}") from None


def _records(lines: Iterable[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Lines other than empty ones and comments."""
    return ((number, line) for number, line in lines if line and not line.startswith("#"))


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    try:
        with TextIOWrapper(open_file(file, _MAX_TEXT_BYTES), encoding="utf-8-sig") as stream:
            for number, line in enumerate(stream, 1):
                yield number, line.strip()
    except (OSError, UnicodeDecodeError) as error:
        raise CaptureError(f"{file}: can't be read as text ({error})") from None
