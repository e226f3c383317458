"""Waymo Perception, first release: one TFRecord file of frames for each segment of a drive."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from .capture import Capture, CaptureError
from .driving_log import DrivingLog, LidarScan
from .geometry import BoxSample, rigid_from_numbers
from .io.records import TFRecord, records_in
from .waymo import CAMERAS, CLASSES, LASERS, WaymoCamera, WaymoLaser, check_jpeg, heading_pose, parsed

_US = 1e-6
_MAX_NUMBERS = 64 * 4000 * 6
_SUFFIXES = (".tfrecord", ".tfrecords")


def recognizes_waymo_records(path: Path) -> bool:
    return path.suffix in _SUFFIXES if path.is_file() else bool(_files_in(path))


def read_waymo_records(path: Path) -> Capture:
    """Read one segment, or the first file of a folder. Raises `CaptureError` if no frame is readable."""
    files = [path] if path.is_file() else _files_in(path)
    if not files:
        raise CaptureError(f"{path}: no .tfrecord in it")
    segment = _RecordSegment(DrivingLog(files[0].stem, road_m=0.0))
    if files[1:]:
        segment.record.problems.append(f"{files[0].name} is read; open one of the other {len(files) - 1} by its name")
    return segment.capture(files[0])


def _files_in(folder: Path) -> list[Path]:
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    return [file for file in found if file.suffix in _SUFFIXES]


@dataclass(slots=True)
class _RecordSegment:
    record: DrivingLog
    name: str = ""
    frames: list[tuple[TFRecord, float, Float64[np.ndarray, "4 4"]]] = field(
        default_factory=list[tuple[TFRecord, float, Float64[np.ndarray, "4 4"]]]
    )
    lasers: dict[int, WaymoLaser] = field(default_factory=dict[int, WaymoLaser])
    with_lidar: int = 0

    def capture(self, file: Path) -> Capture:
        try:
            for number, (place, content) in enumerate(records_in(file)):
                self._take(place, parsed("Frame", content), number)
        except CaptureError as error:
            if not self.record.views:
                raise CaptureError(str(error) if file.name in str(error) else f"{file}: {error}") from None
            self.record.problems.append(f"{error}; the {len(self.frames)} frames before are used")
        if not self.frames:
            raise CaptureError(f"{file}: no frame in it")
        self.record.name = self.name or file.stem
        if not self.record.stamps:
            self.record.stamps = [(time, pose) for _, time, pose in self.frames]
        self.record.scans, self.record.scan_count = self._scans(), self.with_lidar
        return self.record.capture()

    def _take(self, place: TFRecord, frame: Any, number: int) -> None:
        name = _text(frame.context.name)
        if self.name and name != self.name:
            self.record.problems.append(f"frame {number} left out: it is of another segment ({name})")
            return
        self.name = name
        time = frame.timestamp_micros * _US
        try:
            pose = rigid_from_numbers(frame.pose.transform)
        except ValueError as error:
            self.record.problems.append(f"frame {number} left out: {error}")
            return
        self.frames.append((place, time, pose))
        self.record.box_times_s.append(time)
        self._pictures(place, frame, number)
        self._boxes(frame, time, pose, number)
        if any(laser.ri_return1.range_image_compressed for laser in frame.lasers):
            self.with_lidar += 1
            for each in frame.context.laser_calibrations:
                if each.name not in self.lasers:
                    self._take_laser(each, number)

    def _take_laser(self, calibration: Any, number: int) -> None:
        try:
            self.lasers[calibration.name] = _laser(calibration)
        except ValueError as error:
            named = LASERS.get(calibration.name, str(calibration.name))
            self.record.problems.append(f"the calibration of lidar {named} in frame {number} left out: {error}")

    def _pictures(self, place: TFRecord, frame: Any, number: int) -> None:
        calibrations = {each.name: each for each in frame.context.camera_calibrations}
        for image in sorted(frame.images, key=lambda image: image.name):
            sensor = CAMERAS.get(image.name, f"CAMERA_{image.name}")
            try:
                if image.name not in calibrations:
                    raise ValueError("its calibration is missing")
                camera = _camera(sensor, calibrations[image.name])
                check_jpeg(image.image, (camera.width, camera.height))
                pose, source = rigid_from_numbers(image.pose.transform), partial(_jpeg, place, image.name)
                view = camera.view(f"{number:04d}_{sensor}", pose, image.pose_timestamp, image.shutter, source)
            except ValueError as error:
                self.record.problems.append(f"{sensor} of frame {number} left out: {error}")
                continue
            self.record.views.append(view)
            self.record.stamps.append((image.pose_timestamp, pose))

    def _boxes(self, frame: Any, time_s: float, pose: Float64[np.ndarray, "4 4"], number: int) -> None:
        for label in frame.laser_labels:
            box = label.box
            to_world = pose @ heading_pose((box.center_x, box.center_y, box.center_z), box.heading)
            size = (box.length, box.width, box.height)
            try:
                sample = BoxSample(_text(label.id), CLASSES.get(label.type, "unknown"), time_s, size, to_world)
            except ValueError as error:
                self.record.problems.append(f"a box of frame {number} left out: {error}")
            else:
                self.record.boxes.append(sample)

    def _scans(self) -> Iterator[LidarScan]:
        for number, (place, time, pose) in enumerate(self.frames if self.with_lidar else ()):
            clouds: list[Float64[np.ndarray, "p 3"]] = []
            lights: list[Float32[np.ndarray, " p"]] = []
            for laser in parsed("Frame", place.read()).lasers:
                try:
                    for points, light in self._returns(laser, pose):
                        clouds.append(points)
                        lights.append(light)
                except (ValueError, CaptureError, zlib.error) as error:
                    named = LASERS.get(laser.name, str(laser.name))
                    self.record.problems.append(f"lidar {named} of frame {number} left out: {error}")
            if clouds:
                top = self.lasers.get(1) or next(iter(self.lasers.values()))
                yield LidarScan(time, pose, np.concatenate(clouds), top.to_vehicle[:3, 3], np.concatenate(lights))

    def _returns(
        self, laser: Any, pose: Float64[np.ndarray, "4 4"]
    ) -> Iterator[tuple[Float64[np.ndarray, "p 3"], Float32[np.ndarray, " p"]]]:
        poses = None
        for image in (laser.ri_return1, laser.ri_return2):
            if not image.range_image_compressed:
                continue
            if laser.name not in self.lasers:
                raise ValueError("its calibration is missing")
            if image.range_image_pose_compressed:
                poses = _matrix(image.range_image_pose_compressed)
            yield self.lasers[laser.name].points(_matrix(image.range_image_compressed), poses, pose)


def _text(words: str | bytes) -> str:
    """Text of a message; protobuf returns invalid UTF-8 as bytes."""
    return words if isinstance(words, str) else words.decode(errors="replace")


def _camera(name: str, calibration: Any) -> WaymoCamera:
    to_vehicle = rigid_from_numbers(calibration.extrinsic.transform)
    return WaymoCamera(name, tuple(calibration.intrinsic), to_vehicle, calibration.width, calibration.height)


def _laser(calibration: Any) -> WaymoLaser:
    beams = np.array(calibration.beam_inclinations, np.float64)
    ends = np.array([calibration.beam_inclination_min, calibration.beam_inclination_max])
    to_vehicle = rigid_from_numbers(calibration.extrinsic.transform)
    return WaymoLaser(to_vehicle, beams if len(beams) else ends, not len(beams))


def _matrix(compressed: bytes) -> Float32[np.ndarray, "h w c"]:
    """Parse a serialized MatrixFloat compressed by zlib; ValueError if sizes disagree."""
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(compressed, _MAX_NUMBERS * 4 + 64)
    if not unpacker.eof:
        raise ValueError("a range image larger than any lidar's")
    matrix = parsed("MatrixFloat", content)
    values, shape = np.frombuffer(matrix.data, "<f4"), tuple(matrix.shape.dims)
    if len(shape) != 3 or min(shape) < 1 or int(np.prod(shape)) != values.size:
        raise ValueError(f"a range image of {values.size} numbers says that its shape is {shape}")
    return values.reshape(shape)


def _jpeg(place: TFRecord, camera: int) -> bytes:
    images = parsed("FramePictures", place.read()).images
    found = next((image.image for image in images if image.name == camera), None)
    if found is None:
        raise CaptureError(f"{place.file}: the picture of {CAMERAS.get(camera, camera)} is gone")
    return found
