"""The tables of nuScenes that a capture needs, read row by row as the data set's schema has them.

Facts: docs/schema_nuscenes.md of github.com/nutonomy/nuscenes-devkit. Rotations are w x y z, sizes width length height.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from gsrain_engine.untrusted.limits import read_file

from ..capture import CaptureError

Row = TypeVar("Row")


class Scene(msgspec.Struct, frozen=True, gc=False):
    """20 seconds of a drive."""

    token: str
    name: str


class Sample(msgspec.Struct, frozen=True, gc=False):
    """A time that was annotated."""

    token: str
    timestamp: int
    """Microseconds."""
    scene_token: str


class SampleData(msgspec.Struct, frozen=True, gc=False):
    """A file of one sensor."""

    token: str
    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    filename: str
    timestamp: int
    is_key_frame: bool


class Placed(msgspec.Struct, frozen=True, gc=False):
    """An ego pose: vehicle to world."""

    token: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


class CalibratedSensor(msgspec.Struct, frozen=True, gc=False):
    """Where a sensor sits: sensor to vehicle."""

    token: str
    sensor_token: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    camera_intrinsic: list[list[float]] = []


class Sensor(msgspec.Struct, frozen=True, gc=False):
    """A sensor's name and kind."""

    token: str
    channel: str
    modality: str


class Annotation(msgspec.Struct, frozen=True, gc=False):
    """A box at the time of a sample, in the world."""

    token: str
    sample_token: str
    instance_token: str
    translation: tuple[float, float, float]
    size: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


class Instance(msgspec.Struct, frozen=True, gc=False):
    """A thing that was annotated."""

    token: str
    category_token: str


class Category(msgspec.Struct, frozen=True, gc=False):
    """A class of things."""

    token: str
    name: str


@dataclass(frozen=True)
class NuScenesTables:
    """The tables of one version of the data set, read when they are asked for. Each raises `CaptureError`."""

    folder: Path

    @cached_property
    def scenes(self) -> dict[str, Scene]:
        return self._rows("scene", Scene)

    @cached_property
    def samples(self) -> dict[str, Sample]:
        """Times that were annotated."""
        return self._rows("sample", Sample)

    @cached_property
    def sample_data(self) -> dict[str, SampleData]:
        return self._rows("sample_data", SampleData)

    @cached_property
    def ego_poses(self) -> dict[str, Placed]:
        return self._rows("ego_pose", Placed)

    @cached_property
    def calibrated_sensors(self) -> dict[str, CalibratedSensor]:
        return self._rows("calibrated_sensor", CalibratedSensor)

    @cached_property
    def sensors(self) -> dict[str, Sensor]:
        return self._rows("sensor", Sensor)

    def read_poses(self) -> None:
        """Read what every file of a sensor needs, so that a broken table is named once."""
        _ = self.ego_poses, self.calibrated_sensors, self.sensors

    @cached_property
    def annotations(self) -> dict[str, Annotation]:
        """Boxes; none in the test split."""
        return self._rows("sample_annotation", Annotation)

    @cached_property
    def class_names(self) -> dict[str, str]:
        categories = self._rows("category", Category)
        instances = self._rows("instance", Instance)
        return {
            token: categories[each.category_token].name if each.category_token in categories else "unknown"
            for token, each in instances.items()
        }

    def _rows(self, name: str, kind: type[Row]) -> dict[str, Row]:
        file = self.folder / f"{name}.json"
        try:
            rows: list[Any] = msgspec.json.decode(read_file(file), type=list[kind])
        except FileNotFoundError:
            raise CaptureError(f"{file}: this table of nuScenes is missing") from None
        except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise CaptureError(f"{file}: {error}") from None
        return {row.token: row for row in rows}
