"""Turns of a lidar to rain on: sweeps of a capture, or virtual ones along a scene's drive."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float64

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture
from gsrain_engine.scene.scene import Scene

from .beams import Beams
from .sensor import LidarSensor
from .sweep_beams import MATT, ROOF_M, full_intensity, range_told_by, sweep_beams
from .sweep_in_rain import levelled_frame
from .virtual_scan import scan_scene


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """One turn of a lidar, and where the rain's regions stand around it."""

    name: str
    beams: Beams
    anchor_to_world: Float64[np.ndarray, "4 4"]
    """Frame of the rain's regions: the vehicle's, levelled."""
    sensor: LidarSensor


def capture_turns(
    capture: Capture, sensor: LidarSensor, count: int = 1, *, full: float | None = None, told_range: bool = True
) -> Iterator[Turn]:
    """Yield some sweeps of a capture, evenly over it. With `told_range` the sensor's range is that which they tell.

    Raises `ValueError` where there is no sweep, or the capture is not in metres with z up.
    """
    if not capture.sweeps:
        raise ValueError(f"{capture.name}: has no lidar sweeps")
    if not capture.is_metric or abs(capture.up[2] - 1) > 1e-6:
        raise ValueError(f"{capture.name}: its world is not in metres with z up, where rain falls")
    for number in evenly(len(capture.sweeps), count):
        sweep = capture.sweeps[number]
        scale = full_intensity(sweep) if full is None else full
        told = range_told_by(sweep, scale) if told_range else None
        own = sensor
        if told is not None:
            own = msgspec.structs.replace(sensor, range_m=min(max(told, 1.0), 1000.0))
        pose = None if capture.ego is None else capture.ego.pose(sweep.time_s)
        frame = (
            levelled_frame((1.0, 0.0, 0.0), sweep.origin_m)
            if pose is None
            else levelled_frame(pose[:3, 0], pose[:3, 3])
        )
        yield Turn(f"sweep{number:04d}", sweep_beams(sweep, own, capture.ego, scale), frame, own)


def scene_turns(
    scene: Scene, sensor: LidarSensor, times_s: Sequence[float], *, matt: float = MATT, height_m: float = ROOF_M
) -> Iterator[Turn]:
    """Yield virtual turns of a sensor on the ego vehicle's roof, `height_m` over the road, level.

    Raises `ValueError` for a scene without an ego track, and for times at which the vehicle isn't there.
    """
    for number, time_s in enumerate(times_s):
        ego = scene.ego_to_world(time_s)
        if ego is None:
            raise ValueError(
                f"scene {scene.name!r} has no ego vehicle at {time_s:g} s, whose roof a lidar could stand on"
            )
        frame = levelled_frame(ego[:3, 0], ego[:3, 3])
        pose = frame.copy()
        pose[2, 3] += height_m - EGO_HEIGHT_M
        yield Turn(f"scan{number:04d}", scan_scene(scene, time_s, pose, sensor, matt), frame, sensor)


def evenly(total: int, count: int) -> list[int]:
    """Indices of some of many things, evenly over them, from the first one on."""
    count = min(count, total)
    return [i * total // count for i in range(count)]
