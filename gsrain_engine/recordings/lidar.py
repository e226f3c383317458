"""Lidar turns of a recording in rain, in the form in which they are stored."""

from dataclasses import dataclass
from threading import Lock

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64, Real

from ..datasets.capture import Capture, LidarSweep
from ..datasets.geometry import Pose, invert_pose, transform_points
from ..evaluation.lidar.scan import scan_in_rain, sweep_turn
from ..evaluation.lidar.sensor import LidarSensor
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation

_SMALLEST_M = 1e-3  # smaller changes of a point are not written: they are those of its rounding


@dataclass(frozen=True, slots=True, eq=False)
class RainyRows:
    """Points in rain, each in the beam of a row as it was recorded."""

    rows: Int64[np.ndarray, " m"]
    """Rising, each at most once."""
    points_m: Float64[np.ndarray, "m 3"]
    """In the frame in which they are stored."""
    intensities: Float32[np.ndarray, " m"] | None
    is_false: Bool[np.ndarray, " m"]
    """Points that are drops."""


class LidarRain:
    """Rain on the lidar of a capture: lost echoes, range noise, echoes of drops.

    Extinction, drops and their echoes are those of `scan_in_rain`, by the same rain that falls in the pictures. The
    recorded turns count as those of clear weather. The sensor's range at 10 % is estimated from each turn. Turns may be
    made in several threads.
    """

    def __init__(
        self, capture: Capture, rain: RainSettings, sensor: LidarSensor, *, full: float | None, estimates_range: bool
    ) -> None:
        self._rainfall, self._ego = RainSimulation.start(rain), capture.ego
        self._sensor, self._full, self._estimates_range = sensor, full, estimates_range
        self._counting = Lock()
        self.turns = 0
        """Numbers so far, also of points: recorded, in rain, of drops."""
        self.recorded = self.written = self.false = 0

    def rainy(
        self,
        stored_m: Float[np.ndarray, "n 3"],
        intensities: Real[np.ndarray, " n"] | None,
        stored_to_world: Pose,
        origin_m: Float[np.ndarray, "3"],
        time_s: float,
    ) -> RainyRows:
        """Return the points of one turn in rain; `origin_m` is the sensor's position in the frame of the points."""
        points = transform_points(stored_to_world, np.asarray(stored_m, np.float64))
        origin = transform_points(stored_to_world, np.asarray(origin_m, np.float64)[None])[0]
        light = None if intensities is None else np.ascontiguousarray(intensities, np.float32)
        sweep = LidarSweep(time_s, points.astype(np.float32), origin, light)
        turn = sweep_turn(sweep, self._sensor, self._ego, full=self._full, estimates_range=self._estimates_range)
        found = scan_in_rain(turn.beams, turn.sensor, self._rainfall, turn.anchor_to_world)
        before = points[found.beams]
        after = found.sweep.points_m.astype(np.float64)
        same = ~found.is_false & (np.linalg.norm(after - before, axis=1) < _SMALLEST_M)
        back = transform_points(invert_pose(stored_to_world), after)
        back[same] = stored_m[found.beams[same]]
        with self._counting:
            self.turns, self.recorded = self.turns + 1, self.recorded + len(points)
            self.written, self.false = self.written + len(after), self.false + int(found.is_false.sum())
        return RainyRows(found.beams, back, found.sweep.intensities, found.is_false)


_STEPS = (1.0, 1 / 255, 0.01)
"""Steps of intensities that data sets round to: whole numbers beyond 1, bytes over 255, two decimals (KITTI)."""
_ROUNDED = 1e-3  # of a step


def like_recorded(intensities: Float32[np.ndarray, " m"] | None, recorded: Real[np.ndarray, " n"]) -> np.ndarray:
    """Intensities with the steps and the type of the recorded ones: whole numbers stay whole."""
    found = np.zeros(0) if intensities is None else intensities
    if recorded.dtype.kind in "iu":
        bounds = np.iinfo(recorded.dtype)
        return np.clip(np.rint(found), bounds.min, bounds.max).astype(recorded.dtype)
    for step in _STEPS if len(recorded) else ():
        counts = recorded.astype(np.float64) / step
        if (step < 1 or recorded.max() > 1) and (np.abs(counts - np.rint(counts)) < _ROUNDED).all():
            return (np.rint(found / step) * step).astype(recorded.dtype)
    return found.astype(recorded.dtype)
