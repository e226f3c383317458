"""Rainy copies of recordings made of files: nuScenes, KITTI, Argoverse 2, DGP, folders of images."""

import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from ..appearance.capture_photos import COPY_JPEG_QUALITY
from ..datasets.capture import Capture, CaptureFrame, LidarSweep
from ..datasets.io.sweep_files import SweepFile
from ..datasets.kitti import kitti_surroundings
from ..render.images import write_image
from ..safe_io.files import whole_folder
from ..safe_io.limits import open_file
from ..scene.progress import Progress
from ..threads import results_in_order
from .lidar import LidarRain, like_recorded
from .pictures import MakePicture, RainyPictures

_COPIED_BYTES = 1 << 30


@dataclass(slots=True)
class FileCopies:
    """Files of a recording that its rainy copy does not change, and what became of all files of the copy."""

    hard_links: bool = False
    """True to store unchanged files once, where the disk can: then editing one edits the recording's, too."""
    changed: list[str] = field(default_factory=list[str])
    """Names of the files in rain, relative to the copy; of a copy that is one file, its name."""
    copied: int = 0
    linked: int = 0
    left_out: list[str] = field(default_factory=list[str])
    """Entries that can't be copied, with the reasons."""

    def add(self, file: Path, path: Path) -> None:
        """Copy one file, or what a link points to, with its times and permissions.

        Copies share their blocks on file systems that can (Btrfs, XFS). Raises OSError.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        if self.hard_links:
            with suppress(OSError):  # another disk, or one without hard links
                os.link(file.resolve(), path)
                self.linked += 1
                return
        with open_file(file) as stream, path.open("xb") as copy:
            with suppress(OSError, AttributeError):  # other disks, other systems
                while os.copy_file_range(stream.fileno(), copy.fileno(), _COPIED_BYTES):
                    pass
            shutil.copyfileobj(stream, copy)  # what is left
        shutil.copystat(file, path)
        self.copied += 1

    def add_rest(self, source: Path, target: Path, changed: Collection[Path]) -> None:
        """Copy all files and folders, empty ones too, but those files that are `changed`.

        What links point to is copied; links to nothing or to a folder around them, pipes, sockets and devices are left
        out. Raises OSError.
        """
        waiting = [(source, target, frozenset[Path]())]
        while waiting:
            folder, copy, around = waiting.pop()
            copy.mkdir(parents=True, exist_ok=True)
            around |= {folder.resolve()}
            for file in sorted(folder.iterdir()):
                if file in changed:
                    continue
                if file.is_dir() and file.resolve() not in around:
                    waiting.append((file, copy / file.name, around))
                elif file.is_file():
                    self.add(file, copy / file.name)
                else:
                    why = "a link to a folder around it" if file.is_dir() else "neither a file nor a folder"
                    self.left_out.append(f"{file.relative_to(source)}: {why}")


def write_rainy_folder(
    capture: Capture, source: Path, target: Path, pictures: RainyPictures, lidar: LidarRain | None, files: FileCopies
) -> Iterator[Progress]:
    """Copy the folder of a recording with rain in the capture's images and lidar; yields progress after each.

    Images keep their names, sizes and formats. All other files, and images of other recordings in the folder, are
    copied by `files`. A drive of KITTI is copied with its calibration or poses, which lie outside of its folder. The
    copy appears when it is complete.

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
        yield Progress(0.0, "Images")
        calls = (
            ((file, view), partial(_write_picture, view, pictures.begin(view), folder / file.relative_to(source)))
            for file, view in photos.items()
        )
        with closing(results_in_order(calls, pictures.threads)) as results:
            for number, ((file, view), is_changed) in enumerate(results, 1):
                if is_changed:
                    files.changed.append((place / file.relative_to(source)).as_posix())
                else:
                    files.add(file, folder / file.relative_to(source))
                yield Progress(number / steps, view.name)
        turns = (
            (stored, partial(_write_sweep, stored, sweep, lidar, folder / stored.file.relative_to(source)))
            for stored, sweep in sweeps.items()
        )
        with closing(results_in_order(turns, pictures.threads)) as results:
            for number, (stored, _) in enumerate(results, len(photos) + 1):
                files.changed.append((place / stored.file.relative_to(source)).as_posix())
                yield Progress(number / steps, stored.file.name)
        yield Progress(1.0, "Copying all other files")
        files.add_rest(source, folder, {*photos, *(stored.file for stored in sweeps)})
        for file, name in outside.items():
            files.add(file, whole / name)


def _write_picture(view: CaptureFrame, make: MakePicture, path: Path) -> bool:
    """Write the picture of a view, unless it is the photograph itself; returns whether it was written."""
    photo = view.image
    rainy = make(photo)
    if rainy is not photo:
        write_image(path, Image.fromarray(rainy), COPY_JPEG_QUALITY)
    return rainy is not photo


def _write_sweep(stored: SweepFile, sweep: LidarSweep, lidar: LidarRain | None, path: Path) -> None:
    assert lidar is not None and sweep.source is not None
    turn, origin = stored.read(), np.array(stored.origin_m)
    rainy = lidar.rainy(turn.points_m, turn.intensities, sweep.source.sensor_to_world, origin, sweep.time_s)
    light = None if turn.intensities is None else like_recorded(rainy.intensities, turn.intensities)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(turn.encode(rainy.rows, rainy.points_m, light))


def _photos(capture: Capture, source: Path) -> Mapping[Path, CaptureFrame]:
    photos: dict[Path, CaptureFrame] = {}
    for view in capture:
        file = view.image_file
        if file is None or not file.is_relative_to(source):
            raise ValueError(f"{capture.name}: the image of {view.name} is no file of its own in {source}")
        photos[file] = view
    return photos


def _sweeps(capture: Capture, source: Path) -> Mapping[SweepFile, LidarSweep]:
    return {
        sweep.source.key: sweep
        for sweep in capture.sweeps
        if sweep.source is not None
        and isinstance(sweep.source.key, SweepFile)
        and sweep.source.key.file.is_relative_to(source)
    }
