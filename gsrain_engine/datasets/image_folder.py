"""A plain folder of pictures: no poses, so it serves for transfer and evaluation, not for reconstruction."""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from gsrain_engine.scene.camera import Camera

from .capture import Capture, CaptureError, View
from .files.picture_file import CONVERT, picture_size, pictures_in, read_color, unread_pictures_in
from .named_problems import some_names
from .nearest_kind import nearest_kind

ASSUMED_HORIZONTAL_FOV_DEG = 60.0
"""Of cameras that nobody calibrated: between a phone's (about 65) and a narrow driving camera's (50)."""

NO_POSES = (
    "No poses and no calibration: each view stands at the origin with an assumed horizontal field of view of "
    f"{ASSUMED_HORIZONTAL_FOV_DEG:g} degrees; good for transfer and evaluation. To reconstruct a scene, run COLMAP on "
    "these pictures and open its folder."
)


def recognizes_image_folder(path: Path) -> bool:
    """Whether a folder, or the folder `images` in it, holds pictures."""
    return bool(pictures_in(_folder(path)))


def read_image_folder(path: Path) -> Capture:
    """Read a folder of pictures; broken ones are left out and named. Raises `CaptureError` where none is whole."""
    near = nearest_kind(path)
    problems = [] if near is None else [f"Read as pictures alone: nearest to the folder is {near}."]
    unread = unread_pictures_in(_folder(path))
    if unread:
        count = f"{len(unread)} more pictures are" if len(unread) > 1 else "1 more picture is"
        problems.append(f"{count} left out, {CONVERT}: {some_names([file.name for file in unread])}.")
    return capture_without_poses(path, pictures_in(_folder(path)), problems=problems)


def capture_without_poses(
    path: Path,
    files: Sequence[Path],
    attributes: Mapping[str, Mapping[str, str]] | None = None,
    problems: Sequence[str] = (),
) -> Capture:
    """Views that all stand at the origin, look along +x, and know nothing of each other; `attributes` by file stem."""
    attributes = attributes or {}
    stems = Counter(file.stem for file in files)
    views: list[View] = []
    broken: list[str] = []
    for file in files:
        try:
            camera = camera_without_calibration(*picture_size(file, upright=True))
        except CaptureError as error:
            broken.append(str(error))
        else:
            name = file.stem if stems[file.stem] == 1 else file.name
            known = dict(attributes.get(file.stem, {}))
            views.append(View(name, camera, partial(read_color, file, True), attributes=known))
    if not views:
        raise CaptureError(f"{path}: no picture in it can be read" + (f" ({broken[0]})" if broken else ""))
    left_out = [f"{len(broken)} of {len(files)} pictures are left out: {some_names(broken)}."] if broken else []
    told = (NO_POSES, *problems, *left_out)
    return Capture(path.resolve().name, tuple(views), is_metric=False, has_poses=False, problems=told)


def camera_without_calibration(width: int, height: int) -> Camera:
    """A level pinhole camera at the origin of a z-up world, looking along +x."""
    focal = width / 2 / np.tan(np.radians(ASSUMED_HORIZONTAL_FOV_DEG) / 2)
    level = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return Camera(width, height, float(focal), float(focal), width / 2, height / 2, level)


def _folder(path: Path) -> Path:
    """Where the pictures lie: directly in the folder, else in `images` below it."""
    return path if pictures_in(path) else path / "images"
