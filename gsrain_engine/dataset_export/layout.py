"""`DatasetLayout`: names of the files of a data set, the form of its lidar, and tables for the readers of a layout."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from ..datasets.geometry import Pose
from ..safe_io.file_names import file_word
from .source import DatasetSource, LidarRows, PlacedBox

MICROSECONDS = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class LabeledDataset:
    """Everything that a layout's tables are made of."""

    source: DatasetSource
    boxes: Sequence[Sequence[PlacedBox]]
    """Of each moment."""
    lidar_points: Sequence[Sequence[int]]
    """Echoes in clear air in each of these boxes."""
    lidar_to_world: Sequence[Pose | None]
    """Of each moment; None without a turn."""
    objects: Mapping[tuple[int, str], Sequence[Mapping[str, Any]]]
    """Objects of each picture, by moment and camera, as `ObjectLabels.objects`."""


class DatasetLayout(ABC):
    """A layout. Names of files are relative to the folder of one rain."""

    name: ClassVar[str]
    summary: ClassVar[str]
    has_lidar: ClassVar[bool] = True
    needs_poses: ClassVar[bool] = False

    @abstractmethod
    def picture_file(self, source: DatasetSource, moment: int, camera: str) -> str:
        """Return the file of a picture; its suffix is that of its format."""

    def sweep_files(self, source: DatasetSource, moment: int) -> Sequence[str]:
        """Return the files of a lidar's turn: one, or several that are the same."""
        return ()

    def sweep_bytes(self, rows: LidarRows) -> bytes:
        """Return the content of a turn's file."""
        return b""

    @abstractmethod
    def write_tables(self, dataset: LabeledDataset, folder: Path) -> None:
        """Write the files that are the same in each rain into a folder, from which each rain's gets them."""


def camera_word(camera: str) -> str:
    """Return the name of a camera as a part of file names."""
    return file_word(camera.replace("/", "_"))


def timestamp_us(time_s: float, source: DatasetSource) -> int:
    """Return a time in microseconds after the first of a source, which can't be negative."""
    shots = [source.shot(0, camera) for camera in source.cameras]
    first_s = min([source.moments[0].time_s, source.sweep_time_s(0), *(each.time_s for each in shots if each)])
    return round((time_s - first_s) * MICROSECONDS)
