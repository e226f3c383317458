"""Capture folders (images, per-pixel data, cameras.json) and plain image folders.

NAME.png is the image, NAME.depth.npy depth in meters (float32), NAME.normals.npy world normals (float16),
NAME.labels.png class numbers; NAME.mask.png and NAME.sky.png are white where True. cameras.json holds for each view its
name, time and camera, and optionally sensor, lens and attributes. The world has meters and z up, unless world.json
differs: {"up": [x, y, z], "is_metric": false}; "has_poses": false marks unknown camera poses.
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from PIL import Image

from ..safe_io.errors import SceneFormatError
from ..scene.camera import DEFAULT_EXPOSURE_S, Camera
from .capture import Capture, CaptureError, CaptureFrame, abbreviated_names, check_inside, omissions
from .io.arrays import read_floats, read_json_object, read_json_rows
from .io.images import CONVERT, image_size, images_in, read_color, read_labels, read_mask, unread_images_in
from .layout_hints import foreign_poses, nearest_layout

CAMERAS, WORLD = "cameras.json", "world.json"
_NO_POSES = "No poses: these pictures were made of pictures without any; good for evaluation, not for reconstruction."
_LARGEST = 1e12  # larger numbers indicate a damaged file


def write_views(folder: Path, views: Iterable[CaptureFrame]) -> Iterator[CaptureFrame]:
    """Write views as they arrive and yield each once it is on disk; cameras.json is written last."""
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for view in views:
        rows.append(write_view(folder, view))
        yield view
    write_cameras(folder, rows)


def write_view(folder: Path, view: CaptureFrame) -> dict[str, Any]:
    """Write the pixels of one view; returns its row of cameras.json."""
    Image.fromarray(view.image).save(folder / f"{view.name}.png")
    if view.depth is not None:
        np.save(folder / f"{view.name}.depth.npy", view.depth, allow_pickle=False)
    if view.normals is not None:
        np.save(folder / f"{view.name}.normals.npy", view.normals.astype(np.float16), allow_pickle=False)
    if view.labels is not None:
        Image.fromarray(view.labels).save(folder / f"{view.name}.labels.png")
    for name, flags in (("mask", view.mask), ("sky", view.sky)):
        if flags is not None:
            Image.fromarray(flags.astype(np.uint8) * 255).save(folder / f"{view.name}.{name}.png")
    values: dict[str, Any] = {"name": view.name, "time_s": view.time_s, **view.camera.to_json()}
    if view.camera.exposure_s != DEFAULT_EXPOSURE_S:
        values["exposure_s"] = view.camera.exposure_s
    if view.sensor:
        values["sensor"] = view.sensor
    if view.lens is not None:
        values["lens"] = msgspec.to_builtins(view.lens)
    if view.attributes:
        values["attributes"] = dict(view.attributes)
    return values


def write_cameras(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write cameras.json from the rows of all views, which completes the capture folder."""
    (folder / CAMERAS).write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def write_world(folder: Path, up: tuple[float, float, float], *, is_metric: bool, has_poses: bool = True) -> None:
    """Write the up direction of the views' world, whether its unit is the meter, and whether poses are known."""
    values = {"up": list(up), "is_metric": is_metric} | ({} if has_poses else {"has_poses": False})
    (folder / WORLD).write_text(json.dumps(values) + "\n", encoding="utf-8")


def recognizes_capture_folder(path: Path) -> bool:
    """Return whether a folder, or `images` in it (as written by `gsrain street`), holds cameras.json and images."""
    return _folder(path) is not None


def read_capture_folder(path: Path) -> Capture:
    """Read a capture folder; missing or broken images are omitted and listed as problems."""
    folder = _folder(path) or path
    file = folder / CAMERAS
    views: list[CaptureFrame] = []
    problems: list[str] = []
    rows = read_json_rows(file)
    check_inside(folder, (f"{row.get('name')}.{ending}" for row in rows for ending in _ENDINGS), file)
    for index, values in enumerate(rows):
        try:
            views.append(_view(folder, values, f"{file}, view {index}"))
        except SceneFormatError as error:
            raise CaptureError(str(error)) from None
        except CaptureError as error:
            problems.append(str(error))
    if not views:
        raise CaptureError(
            f"{file}: none of its {len(problems)} views can be used ({(problems or ['it lists none'])[0]})"
        )
    up, is_metric, has_poses = _world(folder / WORLD)
    notes = (*(() if has_poses else (_NO_POSES,)), *problems)
    return Capture(folder.resolve().name, tuple(views), is_metric=is_metric, up=up, has_poses=has_poses, problems=notes)


def _world(file: Path) -> tuple[tuple[float, float, float], bool, bool]:
    """Read the up direction, whether the unit is the meter, and whether poses are known; defaults: z, True, True."""
    if not file.is_file():
        return (0.0, 0.0, 1.0), True, True
    values = read_json_object(file)
    try:
        x, y, z = (_number(each, str(file), "up") for each in values["up"])
        is_metric, has_poses = values["is_metric"], values.get("has_poses", True)
    except (KeyError, TypeError, ValueError) as error:
        raise CaptureError(f"{file}: expected up (three numbers) and is_metric ({error})") from None
    if not isinstance(is_metric, bool) or not isinstance(has_poses, bool) or not 1e-6 < math.hypot(x, y, z) < 1e6:
        raise CaptureError(f"{file}: is_metric and has_poses must be true or false, and up a direction")
    return (x, y, z), is_metric, has_poses


def _read_measured(file: Path) -> np.ndarray:
    """Read floats, with 0 for values that are not finite."""
    return np.nan_to_num(read_floats(file), copy=False, nan=0, posinf=0, neginf=0)


_OTHER_PIXELS: dict[str, tuple[str, Callable[[Path], np.ndarray]]] = {
    "depth": ("depth.npy", _read_measured),
    "normals": ("normals.npy", _read_measured),
    "labels": ("labels.png", read_labels),
    "mask": ("mask.png", read_mask),
    "sky": ("sky.png", read_mask),
}
_ENDINGS = ("png", *(ending for ending, _ in _OTHER_PIXELS.values()))


def _view(folder: Path, values: dict[str, Any], where: str) -> CaptureFrame:
    name = values.get("name")
    if not isinstance(name, str) or not name:
        raise SceneFormatError(where, "has no name")
    camera = Camera.from_json(values, f"{where} ({name})")
    picture = folder / f"{name}.png"
    size = image_size(picture)
    if size != (camera.width, camera.height):
        raise CaptureError(f"{picture}: is {size[0]}x{size[1]} px, its camera says {camera.width}x{camera.height}")
    others = {
        f"{pixels}_source": partial(read, folder / f"{name}.{suffix}")
        for pixels, (suffix, read) in _OTHER_PIXELS.items()
        if (folder / f"{name}.{suffix}").is_file()
    }
    time_s = _number(values.get("time_s", 0.0), where, "time_s")
    attributes = values.get("attributes", {})
    if not isinstance(attributes, dict):
        raise SceneFormatError(where, "attributes must be an object")
    attributes = {str(key): str(value) for key, value in attributes.items()}
    sensor = str(values.get("sensor", ""))
    return CaptureFrame(
        name,
        replace(camera, lens=None),
        partial(read_color, picture),
        time_s,
        sensor,
        camera.lens,
        attributes=attributes,
        **others,
    )


def _number(value: Any, where: str, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _LARGEST:
        raise SceneFormatError(where, f"{name} must be a finite number, not {value!r}")
    return float(value)


def _folder(path: Path) -> Path | None:
    below = (path, path / "images")
    return next((each for each in below if (each / CAMERAS).is_file() and any(each.glob("*.png"))), None)


# Plain image folders

ASSUMED_HORIZONTAL_FOV_DEG = 60.0
"""Field of view of uncalibrated cameras: between a phone's (about 65) and a narrow driving camera's (50)."""

NO_POSES = (
    "No poses and no calibration: each view stands at the origin with an assumed horizontal field of view of "
    f"{ASSUMED_HORIZONTAL_FOV_DEG:g} degrees; good for transfer and evaluation. To reconstruct a scene, run COLMAP on "
    "these pictures and open its folder."
)


def recognizes_image_folder(path: Path) -> bool:
    """Return whether a folder, or the folder `images` in it, holds images."""
    return bool(images_in(_image_folder(path)))


def read_image_folder(path: Path) -> Capture:
    """Read a folder of images; broken ones are omitted and listed. Raises `CaptureError` if none is readable."""
    near = nearest_layout(path)
    problems = [] if near is None else [f"Read as pictures alone: nearest to the folder is {near}."]
    poses = foreign_poses(path)
    if poses is not None:
        problems.append(f"Read as pictures alone: {poses}.")
    unread = unread_images_in(_image_folder(path))
    if unread:
        count = f"{len(unread)} more pictures are" if len(unread) > 1 else "1 more picture is"
        problems.append(f"{count} left out, {CONVERT}: {abbreviated_names([file.name for file in unread])}.")
    return capture_without_poses(path, images_in(_image_folder(path)), problems=problems)


def capture_without_poses(
    path: Path,
    files: Sequence[Path],
    attributes: Mapping[str, Mapping[str, str]] | None = None,
    problems: Sequence[str] = (),
) -> Capture:
    """Capture of independent views at the origin that look along +x; `attributes` are by file stem."""
    attributes = attributes or {}
    stems = Counter(file.stem for file in files)
    views: list[CaptureFrame] = []
    broken: list[str] = []
    for file in files:
        try:
            camera = camera_without_calibration(*image_size(file, upright=True))
        except CaptureError as error:
            broken.append(str(error))
            continue
        name = file.stem if stems[file.stem] == 1 else file.name
        known = dict(attributes.get(file.stem, {}))
        views.append(CaptureFrame(name, camera, partial(read_color, file, True), attributes=known))
    if not views:
        raise CaptureError(f"{path}: no picture in it can be read" + (f" ({broken[0]})" if broken else ""))
    notes = (NO_POSES, *problems, *omissions(broken, f"{len(broken)} of {len(files)} pictures"))
    return Capture(path.resolve().name, tuple(views), is_metric=False, has_poses=False, problems=notes)


def camera_without_calibration(width: int, height: int) -> Camera:
    """Level pinhole camera at the origin of a z-up world, looking along +x."""
    focal = width / 2 / np.tan(np.radians(ASSUMED_HORIZONTAL_FOV_DEG) / 2)
    level = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return Camera(width, height, float(focal), float(focal), width / 2, height / 2, level)


def _image_folder(path: Path) -> Path:
    """Folder of the images: the given one, otherwise `images` below it."""
    return path if images_in(path) else path / "images"
