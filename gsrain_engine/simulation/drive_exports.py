"""Exports of drives: further formats of `gsrain drive --export`, ours and those of installed packages.

An export is an entry point of the group `gsrain.drive_exports`, those of this program included; Parquet is built in.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ..optional_packages import require_package
from ..plugins import DRIVE_EXPORTS, Extension, find_extension, find_extensions
from ..render.export_settings import Lod
from ..render.renderer import Renderer
from ..scene.scene import RigCamera, Scene
from .playback import RolloutPlayback
from .rollout import CameraImage, Rollout
from .rollout_io import write_rollout_parquet
from .video import RolloutVideo

if TYPE_CHECKING:
    from .lidar_turns import LidarTurnInRain  # its kernels take a second to load

_LIDAR = "64"


@dataclass(frozen=True)
class DriveExport:
    """A format of `--export`."""

    suffixes: tuple[str, ...]
    """Suffixes of the file or folder whose path `write` gets, and of those that it writes next to it."""
    write: Callable[["FinishedDrive", Path], None]
    """Writes a drive to this path, atomically; raises ValueError for a drive that the format can't hold."""
    packages: tuple[str, ...] = ()
    """Modules of `OPTIONAL_PACKAGES` that it needs."""
    is_folder: bool = False
    """True if it writes a folder, not files."""
    cameras: Literal["none", "front", "all"] = "none"
    """Cameras of the rig whose images it contains."""
    lidar: bool = False
    """True if it contains a lidar's turns."""


class FinishedDrive:
    """A roll-out in its scene, with the records of the vehicle's sensors, which are drawn when they are read."""

    on_record: Callable[[], object] = staticmethod(lambda: None)
    """Called after each image and each turn of the lidar."""

    def __init__(
        self,
        export: DriveExport,
        rollout: Rollout,
        scene: Scene,
        renderer: Renderer | None = None,
        lod: Lod | None = None,
    ) -> None:
        """Prepare a drive for an export; without a renderer there are no images. `lod` is that of a recording."""
        self.rollout = rollout
        self.scene = scene
        self._export, self._renderer = export, renderer
        self._lod: Lod | None = lod

    @property
    def record_count(self) -> int:
        """Number of images and turns of the lidar that the export contains."""
        return len(self.rollout.steps) * (len(self._mounts) + self._export.lidar)

    def camera_images(self) -> Iterator[CameraImage]:
        """Images of the export's cameras, in the order of steps: all of a camera, then of the next."""
        for mounted in self._mounts:
            assert self._renderer is not None
            for image in RolloutVideo(self._played, self._renderer, self._lod, mounted).camera_images():
                yield image
                self.on_record()

    def lidar_turns(self) -> "Iterator[LidarTurnInRain]":
        """Turns of a lidar on the roof, one a step, in the rain and the spray of vehicles."""
        from ..evaluation.lidar.sensor import SENSORS
        from .lidar_turns import rollout_lidar_turns

        for turn in rollout_lidar_turns(self._played, SENSORS[_LIDAR]):
            yield turn
            self.on_record()

    @cached_property
    def _played(self) -> RolloutPlayback:
        return RolloutPlayback(self.rollout, self.scene)

    @cached_property
    def _mounts(self) -> list[RigCamera | None]:
        """Cameras that are drawn; None is the one that faces forward most."""
        if self._renderer is None or self._export.cameras == "none":
            return []
        return [None] if self._export.cameras == "front" else [*self._played.rig.cameras]


BUILT_IN = {
    "parquet": DriveExport(
        (".parquet",), lambda drive, path: write_rollout_parquet(path, drive.rollout), packages=("pyarrow",)
    )
}


def drive_export_names() -> tuple[str, ...]:
    """Names of all exports, built-in ones first."""
    return (*BUILT_IN, *(each.name for each in find_extensions(DRIVE_EXPORTS) if each.name not in BUILT_IN))


def find_drive_export(name: str, feature: str) -> DriveExport:
    """Return an export by its name.

    `feature` is what asks for it, in errors: "--export ros2". Raises ValueError if there is none of that name, or a
    package that it needs is missing.
    """
    extension = None if name in BUILT_IN else find_extension(DRIVE_EXPORTS, name)
    if extension is None and name not in BUILT_IN:
        raise ValueError(f"{feature}: there is only {', '.join(drive_export_names())}")
    found = BUILT_IN[name] if extension is None else _guarded(extension, extension.load(DriveExport))
    for package in found.packages:
        require_package(package, feature)
    return found


def _guarded(extension: Extension, export: DriveExport) -> DriveExport:
    """Wrap third-party code: its errors become one sentence."""
    if not export.suffixes or not all(each.startswith(".") for each in export.suffixes):
        raise extension.unfit(f"its suffixes are {export.suffixes}: expected one or more that begin with a dot")
    return replace(export, write=partial(_written, extension, export.write))


def _written(
    extension: Extension, write: Callable[[FinishedDrive, Path], None], drive: FinishedDrive, path: Path
) -> None:
    try:
        write(drive, path)
    except (ValueError, OSError, MemoryError):
        raise
    except Exception as error:  # third-party code may raise anything
        raise extension.unfit(error) from error
