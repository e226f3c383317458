"""Rainy copies of recordings whose images and lidar turns are files: nuScenes, KITTI, DGP, folders of images."""

import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from ..datasets.capture import Capture, CaptureFrame, LidarSource, LidarSweep
from ..datasets.io.arrays import RowFile
from ..datasets.kitti import kitti_surroundings
from ..render.images import write_image
from ..safe_io.limits import read_file
from ..scene.files import whole_folder
from ..scene.progress import Progress
from .lidar import LidarRain
from .pictures import RainyPictures

_JPEG_QUALITY = 95


def write_rainy_folder(
    capture: Capture, source: Path, target: Path, pictures: RainyPictures, lidar: LidarRain | None
) -> Iterator[Progress]:
    """Copy the folder of a recording with rain in the capture's images and lidar; yields progress after each.

    Images keep their names, sizes and formats. All other files, and images of other recordings in the folder, are the
    same files (hard links where the disk allows it, else copies). A drive of KITTI is copied with its calibration or
    poses, which lie outside of its folder. The copy appears when it is complete.

    Raises:
        ValueError: If images are no files of their own inside the folder.
        OSError: If the copy can't be written.
    """
    photos = _photos(capture, source)
    sweeps = {} if lidar is None else _sweeps(capture, source)
    place, outside = kitti_surroundings(source.resolve())
    steps = len(photos) + len(sweeps)
    with whole_folder(target) as whole:
        folder = whole / place
        for number, (file, view) in enumerate(photos.items()):
            yield Progress(number / steps, view.name)
            photo = view.image
            rainy, path = pictures.rainy(view, photo), folder / file.relative_to(source)
            if rainy is photo:
                link_file(file, path)
            else:
                write_image(path, Image.fromarray(rainy), _JPEG_QUALITY)
        for number, (rows, sweep) in enumerate(sweeps.items(), len(photos)):
            yield Progress(number / steps, rows.file.name)
            assert lidar is not None and sweep.source is not None
            path = folder / rows.file.relative_to(source)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(_rows_in_rain(rows, sweep.source, sweep.time_s, lidar))
        yield Progress(1.0, "Linking all other files")
        changed = {*photos, *(rows.file for rows in sweeps)}
        for file in files_below(source):
            if file not in changed:
                link_file(file, folder / file.relative_to(source))
        for file, name in outside.items():
            link_file(file, whole / name)


def _rows_in_rain(rows: RowFile, stored: LidarSource, time_s: float, lidar: LidarRain) -> bytes:
    columns = np.frombuffer(read_file(rows.file), np.float32).reshape(-1, rows.columns)
    return lidar.with_rain(columns, stored.sensor_to_world, time_s).tobytes()


def _photos(capture: Capture, source: Path) -> Mapping[Path, CaptureFrame]:
    photos: dict[Path, CaptureFrame] = {}
    for view in capture:
        file = view.image_file
        if file is None or not file.is_relative_to(source):
            raise ValueError(f"{capture.name}: the image of {view.name} is no file of its own in {source}")
        photos[file] = view
    return photos


def _sweeps(capture: Capture, source: Path) -> Mapping[RowFile, LidarSweep]:
    return {
        sweep.source.key: sweep
        for sweep in capture.sweeps
        if sweep.source is not None
        and isinstance(sweep.source.key, RowFile)
        and sweep.source.key.file.is_relative_to(source)
    }


def files_below(folder: Path) -> Iterator[Path]:
    """All files in a folder and below."""
    for parent, _, names in os.walk(folder):
        yield from (Path(parent) / name for name in names)


def link_file(file: Path, path: Path) -> None:
    """Make the same file appear elsewhere: a hard link, or a copy where the disk has none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(file, path)
    except OSError:  # another disk, or one without hard links
        shutil.copy2(file, path)
