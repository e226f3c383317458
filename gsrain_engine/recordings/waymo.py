"""Rainy copies of Waymo Perception: records of frames (v1), and tables (v2), with other JPEGs and range images."""

import io
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32
from PIL import Image

from ..datasets.capture import Capture, CaptureFrame, LidarSource
from ..datasets.geometry import Pose, rigid_from_numbers
from ..datasets.io.records import masked_crc32c, parquet_module, records_in
from ..datasets.waymo import (
    RETURNS,
    WAYMO_CAMERA,
    WAYMO_CAMERAS,
    WAYMO_LASER,
    WAYMO_TIME,
    PixelPoses,
    WaymoLaser,
    WaymoTables,
    parsed,
    ranges_of_row,
    unpacked_matrix,
    unpacked_ranges,
)
from ..safe_io.files import whole_file, whole_folder
from ..scene.progress import Progress
from ..threads import results_in_order
from .folders import FileCopies
from .lidar import LidarRain
from .pictures import MakePicture, RainyPictures

_JPEG_QUALITY = 95
_NO_RETURN = -1.0


class _Turn(NamedTuple):
    source: LidarSource
    time_s: float


class _FrameRain:
    """Rain on the images and range images of a segment."""

    def __init__(self, capture: Capture, pictures: RainyPictures, lidar: LidarRain | None) -> None:
        self.views = {view.name: view for view in capture}
        self.lidar, self.threads, self._begin = lidar, pictures.threads, pictures.begin
        self.turns: Mapping[Any, _Turn] = {
            sweep.source.key: _Turn(sweep.source, sweep.time_s) for sweep in capture.sweeps if sweep.source is not None
        }

    def begin_jpeg(self, frame: int, camera: int, recorded: bytes) -> Callable[[], bytes] | None:
        """Return what encodes an image in rain, or gives the recorded JPEG if it does not rain; None without a view."""
        view = self.views.get(f"{frame:04d}_{WAYMO_CAMERAS.get(camera, f'CAMERA_{camera}')}")
        return None if view is None else partial(_jpeg, view, self._begin(view), recorded)

    def ranges(
        self,
        turn: _Turn,
        laser: WaymoLaser,
        ranges: Float32[np.ndarray, "h w c"],
        pixel_poses: Float32[np.ndarray, "u v d"] | None,
        vehicle_to_world: Pose,
    ) -> Float32[np.ndarray, "h w c"]:
        """Return a range image in rain: other ranges and intensities, and all channels -1 where a return is lost."""
        assert self.lidar is not None
        points, light = laser.points(ranges, pixel_poses, vehicle_to_world)
        pixels = np.flatnonzero(ranges[..., 0] > 0)
        origin = laser.to_vehicle[:3, 3]
        rainy = self.lidar.rainy(points, light, turn.source.sensor_to_world, origin, turn.time_s)
        found = ranges.reshape(-1, ranges.shape[2]).copy()
        kept = pixels[rainy.rows]
        longer = np.linalg.norm(rainy.points_m - origin, axis=1) - np.linalg.norm(points[rainy.rows] - origin, axis=1)
        rows = found[kept]
        rows[:, 0] += longer
        if rainy.intensities is not None and rows.shape[1] > 1:
            rows[:, 1] = rainy.intensities
        found[pixels] = _NO_RETURN
        found[kept] = rows
        return found.reshape(ranges.shape)


def _jpeg(view: CaptureFrame, make: MakePicture, recorded: bytes) -> bytes:
    stream, photo = io.BytesIO(), view.image
    rainy = make(photo)
    if rainy is photo:
        return recorded
    Image.fromarray(rainy).save(stream, "JPEG", quality=_JPEG_QUALITY, subsampling=0)
    return stream.getvalue()


# First release


def write_rainy_records(
    capture: Capture,
    file: Path,
    source: Path,
    target: Path,
    pictures: RainyPictures,
    lidar: LidarRain | None,
    files: FileCopies,
) -> Iterator[Progress]:
    """Copy a file of records, or its folder, with rain in the JPEGs and range images of its frames.

    Everything else of a frame stays: labels, calibrations, poses, and fields that are not read here. Raises
    `CaptureError` for a damaged file.
    """
    files.changed.append(target.name if source.is_file() else file.relative_to(source).as_posix())
    if source.is_file():
        with whole_file(target) as partial:
            yield from _write_records(capture, file, partial, pictures, lidar)
        return
    with whole_folder(target) as folder:
        yield from _write_records(capture, file, folder / file.relative_to(source), pictures, lidar)
        files.add_rest(source, folder, [file])


def _write_records(
    capture: Capture, file: Path, target: Path, pictures: RainyPictures, lidar: LidarRain | None
) -> Iterator[Progress]:
    rain, lasers = _FrameRain(capture, pictures, lidar), dict[int, WaymoLaser]()
    size = max(file.stat().st_size, 1)

    def begin(number: int, start: int, content: bytes) -> Callable[[], bytes] | None:
        frame = parsed("Frame", content)
        jpegs = [rain.begin_jpeg(number, image.name, image.image) for image in frame.images]
        turn = None if rain.lidar is None else rain.turns.get(start)
        for each in () if turn is None else frame.context.laser_calibrations:
            if each.name not in lasers:
                lasers[each.name] = WaymoLaser.of_record(each)
        is_changed = turn is not None or any(jpegs)
        return partial(_rainy_frame, frame, jpegs, dict(lasers), rain, turn) if is_changed else None

    calls = (
        ((number, record.start, content), begin(number, record.start, content))
        for number, (record, content) in enumerate(records_in(file))
    )
    with target.open("wb") as stream, closing(results_in_order(calls, rain.threads)) as results:
        for (number, start, content), changed in results:
            stream.write(_framed(content if changed is None else changed))
            yield Progress((start + len(content)) / size, f"Frame {number}")


def _rainy_frame(
    frame: Any,
    jpegs: Sequence[Callable[[], bytes] | None],
    lasers: Mapping[int, WaymoLaser],
    rain: _FrameRain,
    turn: _Turn | None,
) -> bytes:
    for image, jpeg in zip(frame.images, jpegs, strict=True):
        if jpeg is not None:
            image.image = jpeg()
    if turn is not None:
        _rain_on_lasers(frame, lasers, rain, turn)
    return frame.SerializeToString(deterministic=True)


def _rain_on_lasers(frame: Any, lasers: Mapping[int, WaymoLaser], rain: _FrameRain, turn: _Turn) -> None:
    pose = rigid_from_numbers(frame.pose.transform)
    for laser in frame.lasers:
        poses = None
        for image in (laser.ri_return1, laser.ri_return2):
            if not image.range_image_compressed or laser.name not in lasers:
                continue
            if image.range_image_pose_compressed:
                poses = unpacked_ranges(image.range_image_pose_compressed)
            ranges = unpacked_ranges(image.range_image_compressed)
            found = rain.ranges(turn, lasers[laser.name], ranges, poses, pose)
            matrix = unpacked_matrix(image.range_image_compressed)
            matrix.data = found.astype("<f4").tobytes()
            image.range_image_compressed = zlib.compress(matrix.SerializeToString(deterministic=True))


def _framed(content: bytes) -> bytes:
    """Return a TFRecord: see `records_in`."""
    length = struct.pack("<Q", len(content))
    return b"".join([
        length, struct.pack("<I", masked_crc32c(length)), content, struct.pack("<I", masked_crc32c(content))
    ])  # fmt: skip


# Second release


def write_rainy_tables(
    tables: WaymoTables,
    capture: Capture,
    target: Path,
    pictures: RainyPictures,
    lidar: LidarRain | None,
    files: FileCopies,
) -> Iterator[Progress]:
    """Copy the folder of the tables with rain in the images and range images of one segment; all else is copied.

    Raises `CaptureError` for a damaged table.
    """
    rain = _FrameRain(capture, pictures, lidar)
    images, ranges = tables.table("camera_image").path, tables.table("lidar").path
    changed = [images, *([ranges] if lidar is not None and rain.turns else [])]
    with whole_folder(target) as folder:
        yield from _write_images(tables, rain, folder / images.relative_to(tables.root))
        if ranges in changed:
            yield from _write_ranges(tables, rain, folder / ranges.relative_to(tables.root))
        files.changed += [each.relative_to(tables.root).as_posix() for each in changed]
        files.add_rest(tables.root, folder, changed)


def _write_images(tables: WaymoTables, rain: _FrameRain, target: Path) -> Iterator[Progress]:
    table, column = tables.table("camera_image"), "[CameraImageComponent].image"
    times = sorted({row[WAYMO_TIME] for _, _, row in table.row_groups([WAYMO_TIME, WAYMO_CAMERA])})
    numbers = {time: number for number, time in enumerate(times)}
    for part, group, write in _copied_groups(table.path, target):
        yield Progress(0.5 * part, "Images")
        rows = zip(*(group[name].to_pylist() for name in (WAYMO_TIME, WAYMO_CAMERA, column)), strict=True)
        calls = ((jpeg, rain.begin_jpeg(numbers[time], camera, jpeg)) for time, camera, jpeg in rows)
        with closing(results_in_order(calls, rain.threads)) as results:
            write(group, {column: [jpeg if rainy is None else rainy for jpeg, rainy in results]})


def _write_ranges(tables: WaymoTables, rain: _FrameRain, target: Path) -> Iterator[Progress]:
    lasers, pixel_poses = tables.lasers(), PixelPoses(tables.table("lidar_pose"))
    for part, group, write in _copied_groups(tables.table("lidar").path, target):
        yield Progress(0.5 + 0.5 * part, "Lidar")
        names = [f"{name}.values" for name in RETURNS if f"{name}.values" in group.column_names]
        columns: dict[str, list[Any]] = {name: [] for name in names}
        read = [WAYMO_TIME, WAYMO_LASER, *names, *(name.removesuffix("values") + "shape" for name in names)]
        for row in group.select(read).to_pylist():
            time, number = row[WAYMO_TIME], row[WAYMO_LASER]
            turn, laser = rain.turns.get(time), lasers.get(number)
            poses = pixel_poses.of(time, number)
            for name in names:
                ranges = None if turn is None else ranges_of_row(row, name.removesuffix(".values"))
                if turn is None or laser is None or ranges is None or time not in tables.poses:
                    columns[name].append(row[name])
                else:
                    columns[name].append(rain.ranges(turn, laser, ranges, poses, tables.poses[time]).ravel())
        write(group, columns)


def _copied_groups(file: Path, target: Path) -> Iterator[tuple[float, Any, Any]]:
    """Yield the share done, each row group of a table, and a function that writes it with other columns."""
    parquet, arrow = parquet_module(), __import__("pyarrow")
    opened = parquet.ParquetFile(file)
    count = opened.num_row_groups
    codec = opened.metadata.row_group(0).column(0).compression if count else "SNAPPY"
    target.parent.mkdir(parents=True, exist_ok=True)
    with parquet.ParquetWriter(target, opened.schema_arrow, compression=codec) as writer:

        def write(group: Any, columns: Mapping[str, list[Any]]) -> None:
            for name, values in columns.items():
                place = group.column_names.index(name)
                field = group.schema.field(place)
                group = group.set_column(place, field, arrow.array(values, field.type))
            writer.write_table(group)

        for number in range(count):
            yield number / count, opened.read_row_group(number), write
