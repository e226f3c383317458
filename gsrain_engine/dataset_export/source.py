"""`DatasetSource`: moments, cameras, boxes and lidar of whatever a data set is made of; what rain doesn't change."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64, UInt8, UInt16

from ..datasets.geometry import Pose, invert_pose, transform_points
from ..evaluation.lidar.scan import LidarTurn, scan_in_rain
from ..evaluation.lidar.sensor import LidarSensor
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..render.provenance import PictureProvenance
from ..render.renderer import Renderer
from ..scene.camera import Camera
from ..water.spray import spray_of

_MARGIN_M = 0.1  # of a box around the points that count as its own


@dataclass(frozen=True, kw_only=True)
class DatasetChoice:
    """Parts of a source that become the data set."""

    cameras: tuple[str, ...] = ()
    """Names; none are those of the first rig, of a recording all."""
    rate_hz: float | None = None
    """Moments per second; None is 2, of a recording all."""
    moments: int | None = None
    """Maximum number of moments, from the first."""
    width_px: int | None = None
    """Width of the pictures; None is the cameras' own."""
    sensor: LidarSensor | None = None
    """Lidar on the roof, or that of the recording; None leaves it out."""


class Shot(NamedTuple):
    """A picture's time, and its camera in the world: a pinhole, meters."""

    time_s: float
    camera: Camera


class DatasetMoment(NamedTuple):
    """A time of the data set, at which each sensor records."""

    time_s: float
    vehicle_to_world: Pose
    """Vehicle's frame: x forward, y left, z up, on the ground; meters."""


class PlacedBox(NamedTuple):
    """A labeled object at a moment."""

    id: str
    class_name: str
    size_lwh_m: tuple[float, float, float]
    to_world: Pose
    """From its frame (x forward, y left, z up, origin at the bottom center)."""


class LidarRows(NamedTuple):
    """A turn of a lidar as it is stored."""

    time_s: float
    lidar_to_world: Pose
    """Lidar's frame: the axes of the vehicle, meters."""
    points_m: Float64[np.ndarray, "p 3"]
    """In the frame of the lidar."""
    intensities: Float32[np.ndarray, " p"]
    """1 is a white, matt surface at normal incidence in clear air; retroreflectors exceed it."""
    rings: Float32[np.ndarray, " p"]


class ObjectLabels(NamedTuple):
    """Labels of one picture, the same in any rain."""

    objects: Sequence[Mapping[str, Any]]
    """As `render.label_export.object_annotation` describes them, the nearest first."""
    instances: UInt16[np.ndarray, "h w"] | None
    """Position in `objects`, counted from 1, of each pixel; None for a source that can't tell."""
    depth_m: Float32[np.ndarray, "h w"] | None
    """Along the view axis, 0 where unknown; None for a source without any."""


@runtime_checkable
class PicturesInRain(Protocol):
    """Pictures of a source in one rain."""

    def picture(self, moment: int, camera: str) -> tuple[UInt8[np.ndarray, "h w 3"], PictureProvenance]:
        """Draw a picture, which depends on nothing but the moment."""
        ...


class DatasetSource(ABC):
    """A scene, a recording or a scenario as moments of a rig. World frame, meters, z up."""

    kind: ClassVar[str]
    """Word for messages: scene, recording or scenario."""
    name: str
    cameras: tuple[str, ...]
    moments: tuple[DatasetMoment, ...]
    has_poses: bool = True
    has_lidar: bool = False
    left_out: tuple[str, ...] = ()
    """One sentence for each kind of label or sensor that the source lacks."""
    facts: Mapping[str, Any]
    """Plain values on which the result depends, such as hashes of inputs."""
    _rings: int = 1
    _turn: tuple[int, LidarTurn | None] = (-1, None)

    @abstractmethod
    def shot(self, moment: int, camera: str) -> Shot | None:
        """Return a picture's camera, or None where there is no picture."""

    @abstractmethod
    def boxes(self, moment: int) -> Sequence[PlacedBox]:
        """Return all labeled objects of a moment."""

    @abstractmethod
    def labels(self, renderer: Renderer, moment: int, camera: str) -> ObjectLabels:
        """Return the labels of a picture."""

    @abstractmethod
    def in_rain(self, renderer: Renderer, rain: RainSettings) -> PicturesInRain:
        """Return the pictures in a rain."""

    @abstractmethod
    def clear_turn(self, moment: int) -> LidarTurn | None:
        """Return the lidar's turn in clear air at a moment; None without one."""

    def camera_to_vehicle(self, camera: str) -> Pose:
        """Return the pose of a camera on the vehicle: that of its first picture."""
        for number, moment in enumerate(self.moments):
            if (shot := self.shot(number, camera)) is not None:
                return invert_pose(moment.vehicle_to_world) @ shot.camera.camera_to_world
        raise ValueError(f"{self.name}: camera {camera!r} has no picture")

    def turn(self, moment: int) -> LidarTurn | None:
        """Return `clear_turn`, made once for all rains of a moment."""
        if self._turn[0] != moment:
            self._turn = moment, self.clear_turn(moment) if self.has_lidar else None
        return self._turn[1]

    def rows(self, moment: int, rainfall: RainSimulation) -> LidarRows | None:
        """Return the lidar's turn at a moment in a rain; None without one."""
        turn = self.turn(moment)
        if turn is None:
            return None
        spray = None if turn.scene is None else spray_of(turn.scene, rainfall, turn.beams.time_s)
        found = scan_in_rain(turn.beams, turn.sensor, rainfall, turn.anchor_to_world, spray=spray)
        to_world = self.lidar_to_world(moment)
        assert to_world is not None
        light = found.sweep.intensities
        shown = np.zeros(len(found.beams)) if light is None else light / turn.beams.full_intensity
        rings = found.beams * self._rings // max(len(turn.beams), 1)
        points = transform_points(invert_pose(to_world), found.sweep.points_m.astype(np.float64))
        columns = shown.astype(np.float32), rings.astype(np.float32)
        return LidarRows(self.sweep_time_s(moment), to_world, points, *columns)

    def lidar_to_world(self, moment: int) -> Pose | None:
        """Return the pose of the lidar, whose axes are those of the vehicle; None without a turn."""
        turn = self.turn(moment)
        if turn is None:
            return None
        to_world = self.moments[moment].vehicle_to_world.copy()
        to_world[:3, 3] = turn.beams.origin_m
        return to_world

    def sweep_time_s(self, moment: int) -> float:
        """Return the time of the lidar's turn at a moment, by the clock of the pictures."""
        return self.moments[moment].time_s

    def lidar_points(self, moment: int, boxes: Sequence[PlacedBox]) -> list[int]:
        """Return the number of echoes in clear air in each of some boxes."""
        turn = self.turn(moment)
        if turn is None:
            return [0] * len(boxes)
        points = turn.beams.points_m[np.isfinite(turn.beams.ranges_m)].astype(np.float64)
        return [_count_inside(points, box) for box in boxes]


def _count_inside(points_m: Float64[np.ndarray, "p 3"], box: PlacedBox) -> int:
    half = np.array(box.size_lwh_m) / 2
    near = points_m[np.abs(points_m - box.to_world[:3, 3]).max(axis=1) < 2 * half.max() + _MARGIN_M]
    local = transform_points(invert_pose(box.to_world), near) - [0.0, 0.0, half[2]]
    return int(np.count_nonzero((np.abs(local) <= half + _MARGIN_M).all(axis=1)))
