"""The speed of a camera path: as its file says, as a person asks, or, for photos without times, as one walks."""

from dataclasses import dataclass, replace

from gsrain_engine.scene.paths.camera_path import CameraPath
from gsrain_engine.scene.paths.pace import WALKING_M_S, paced

_LOWEST, _HIGHEST = 1e-3, 1e3


@dataclass(frozen=True, slots=True)
class TimedPath:
    """A path as it is flown."""

    path: CameraPath
    line: str | None
    """One line for people, where the speed is not the path's own."""
    speed_m_s: float | None
    """None where the path has times of its own."""
    is_assumed: bool


def timed_path(
    path: CameraPath, speed_m_s: float | None, metres_per_unit: float = 1.0, *, is_still: bool = False
) -> TimedPath:
    """Time a path: at the speed asked for, by its own times, or at walking pace; of that, a still is at rest.

    Raises ValueError, which names the option, for a speed out of bounds.
    """
    if speed_m_s is not None:
        if not _LOWEST <= speed_m_s <= _HIGHEST:
            raise ValueError(f"--speed {speed_m_s:g}: must be within {_LOWEST:g}..{_HIGHEST:g} m/s")
        return TimedPath(paced(path, speed_m_s / metres_per_unit, is_timed=True), None, speed_m_s, False)
    if path.is_timed:
        return TimedPath(path, None, None, False)
    walked = paced(path, WALKING_M_S / metres_per_unit)
    if is_still:
        line = "photos without times: the camera is at rest (--speed M_S lets it move)"
        return TimedPath(walked, line, 0.0, True)
    line = f"photos without times: walking pace, {WALKING_M_S:g} m/s, is assumed (--speed M_S says otherwise)"
    return TimedPath(replace(walked, is_timed=True), line, WALKING_M_S, True)
