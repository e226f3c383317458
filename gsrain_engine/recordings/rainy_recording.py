"""Recordings of any kind, opened so that rainy copies of them can be written."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ..datasets.bags.containers import recognizes_bag
from ..datasets.bags.reader import read_bag_recording
from ..datasets.capture import Capture
from ..datasets.io.sweep_files import SweepFile
from ..datasets.nuscenes import read_nuscenes, recognizes_nuscenes
from ..datasets.open_capture import capture_format, open_capture
from ..datasets.waymo import (
    open_waymo_tables,
    read_waymo_records,
    recognizes_waymo_records,
    recognizes_waymo_tables,
    waymo_record_files,
)
from ..scene.progress import Progress
from .bags import write_rainy_bag
from .folders import FileCopies, write_rainy_folder
from .lidar import LidarRain
from .pictures import RainyPictures
from .waymo import write_rainy_records, write_rainy_tables

WriteCopy = Callable[[Path, RainyPictures, LidarRain | None, FileCopies], Iterator[Progress]]
"""Writes a rainy copy to a path, which is a file where the recording is one; counts files in the `FileCopies`."""

WriteRecording = Callable[[Capture, Path, Path, RainyPictures, LidarRain | None, FileCopies], Iterator[Progress]]
"""The same of a capture and the path that it was read from, as a `CaptureFormat` has it."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording as a capture, and the function that writes a copy of it."""

    capture: Capture
    folder: Path
    """Folder of its files, in which a copy must not be."""
    write: WriteCopy
    is_file: bool = False
    """True if the copy is one file."""
    has_lidar: bool = False
    """True if its lidar can be written in rain."""
    untouched: tuple[str, ...] = ()
    """Recorded by a sensor, and left as it was."""


def open_recording(source: Path, *, key_frames_only: bool = False) -> Recording:
    """Open a recording for copies: nuScenes, KITTI, Argoverse 2, DGP, Waymo, MCAP, ROS 2 bags, and folders of images.

    `key_frames_only` leaves out what nuScenes recorded between its annotated samples. Raises `CaptureError` if it can't
    be read, and ValueError if its unit of length is unknown.
    """
    kind = capture_format(source)
    name = "" if kind is None else kind.name
    if recognizes_bag(source):
        recording = _bag(source)
    elif recognizes_waymo_records(source):
        recording = _waymo_records(source)
    elif name.startswith("Waymo") and recognizes_waymo_tables(source):
        recording = _waymo_tables(source)
    else:
        if name == "nuScenes" and recognizes_nuscenes(source):
            capture = read_nuscenes(source, key_frames_only=key_frames_only)
        else:
            capture = open_capture(source)
        write = None if kind is None else kind.write
        recording = _folder(source, capture) if write is None else _foreign(source, capture, write)
    capture = recording.capture
    if capture.has_poses and not capture.is_metric:
        raise ValueError(f"{capture.name}: its unit of length is unknown, and rain falls in meters")
    return recording


def _bag(source: Path) -> Recording:
    found = read_bag_recording(source)
    untouched = tuple(f"{topic.name}: {why}" for topic, why in found.untouched.items())
    write = partial(write_rainy_bag, found, source)
    folder = source if source.is_dir() else source.parent
    return Recording(found.capture, folder, write, source.is_file(), bool(found.clouds), untouched)


def _waymo_records(source: Path) -> Recording:
    capture, file = read_waymo_records(source), waymo_record_files(source)[0]
    write = partial(write_rainy_records, capture, file, source)
    folder = source if source.is_dir() else source.parent
    return Recording(capture, folder, write, source.is_file(), bool(capture.sweeps))


def _waymo_tables(source: Path) -> Recording:
    tables = open_waymo_tables(source)
    capture = tables.capture()
    return Recording(capture, tables.root, partial(write_rainy_tables, tables, capture), False, bool(capture.sweeps))


def _foreign(source: Path, capture: Capture, write: WriteRecording) -> Recording:
    folder = source if source.is_dir() else source.parent
    return Recording(capture, folder, partial(write, capture, source), source.is_file(), bool(capture.sweeps))


def _folder(source: Path, capture: Capture) -> Recording:
    folder = source if source.is_dir() else source.parent  # NUSCENES/scene-0061 names a scene, not a folder
    has_lidar = any(sweep.source is not None and isinstance(sweep.source.key, SweepFile) for sweep in capture.sweeps)
    untouched = ("its lidar, in a format that can only be read",) if capture.sweeps and not has_lidar else ()
    return Recording(capture, folder, partial(write_rainy_folder, capture, folder), False, has_lidar, untouched)
