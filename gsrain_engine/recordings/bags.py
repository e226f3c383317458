"""Rainy copies of MCAP files and ROS 2 bags: the same messages, with other pixels and points."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ..datasets.bags.containers import METADATA, BagMessage
from ..datasets.bags.messages import CloudMessage, read_cloud, read_image
from ..datasets.bags.pixels import with_colors
from ..datasets.bags.reader import BagRecording, MessageKey
from ..datasets.capture import LidarSweep
from ..datasets.geometry import invert_pose, transform_points
from ..safe_io.files import whole_folder
from ..scene.progress import Progress
from .folders import FileCopies
from .lidar import LidarRain, like_recorded
from .pictures import RainyPictures


def write_rainy_bag(
    recording: BagRecording,
    source: Path,
    target: Path,
    pictures: RainyPictures,
    lidar: LidarRain | None,
    files: FileCopies,
) -> Iterator[Progress]:
    """Copy an MCAP file, or a bag's folder or file, with rain in its images and clouds; yields progress.

    Topics, types, times, sequence numbers and all other messages stay as they are, byte for byte. An organized cloud
    keeps its size: lost points are not numbers. The copy appears when it is complete.

    Raises:
        CaptureError: If a container or a message of an image or a cloud is damaged.
        OSError: If the copy can't be written.
    """
    rain = _BagRain(recording, pictures, lidar)
    if source.is_file():
        yield Progress(0.0, source.name)
        yield from rain.copied(0, target)
        files.changed.append(target.name)
        yield Progress(1.0, "Written")
        return
    with whole_folder(target) as folder:
        for number, container in enumerate(recording.containers):
            path = folder / container.path.relative_to(source)
            path.parent.mkdir(parents=True, exist_ok=True)
            yield from rain.copied(number, path)
            files.changed.append(container.path.relative_to(source).as_posix())
        yield Progress(1.0, f"Copying {METADATA}")
        files.add_rest(source, folder, {container.path for container in recording.containers})


class _BagRain:
    def __init__(self, recording: BagRecording, pictures: RainyPictures, lidar: LidarRain | None) -> None:
        self._recording, self._pictures, self._lidar = recording, pictures, lidar
        self._done, self._messages = 0, len(recording.images) + (0 if lidar is None else len(recording.clouds))

    def copied(self, number: int, target: Path) -> Iterator[Progress]:
        """Copy a container; yields progress after each changed message."""
        container = self._recording.containers[number]
        for _ in container.copy(target, partial(self._change, number), self._pictures.threads):
            self._done += 1
            yield Progress(min(self._done / self._messages, 1.0), container.path.name)

    def _change(self, number: int, message: BagMessage) -> Callable[[], bytes | None] | None:
        key = MessageKey(number, message.place)
        view, sweep = self._recording.images.get(key), self._recording.clouds.get(key)
        if view is not None:
            make = self._pictures.begin(view)
            return lambda: with_colors(read_image(message), make)
        if sweep is not None and self._lidar is not None:
            lidar = self._lidar
            return lambda: _cloud_in_rain(read_cloud(message), sweep, lidar)
        return None


def _cloud_in_rain(cloud: CloudMessage, sweep: LidarSweep, lidar: LidarRain) -> bytes:
    assert sweep.source is not None
    points, name = cloud.points_m, cloud.intensity_field
    echoes = np.flatnonzero(np.isfinite(points).all(axis=1))
    light = None if name is None else cloud.rows[name][echoes]

    origin = cloud.to_frame[:3, 3]
    rainy = lidar.rainy(points[echoes], light, sweep.source.sensor_to_world, origin, sweep.time_s)
    own = transform_points(invert_pose(cloud.to_frame), rainy.points_m)
    found = cloud.rows_at(echoes[rainy.rows])
    for axis, column in zip("xyz", own.T, strict=True):
        found[axis] = column
    if name is not None and light is not None:
        found[name] = like_recorded(rainy.intensities, light)
    if cloud.height == 1:
        return cloud.with_rows(found)
    whole = cloud.rows_at(np.arange(len(cloud.rows)))
    for axis in "xyz":
        if whole.dtype[axis].kind != "f":
            raise ValueError(f"{cloud.topic.name}: an organized cloud of whole numbers can't be without a point")
        whole[axis][echoes] = np.nan
    for name in found.dtype.names or ():
        whole[name][echoes[rainy.rows]] = found[name]
    return cloud.with_rows(whole)
