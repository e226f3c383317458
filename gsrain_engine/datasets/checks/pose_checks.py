"""Whether a capture's poses are what they claim to be: against its lidar, and against what neighbouring views share.

A wrong convention (inverted matrices, OpenGL's axes, cameras mixed up) makes a reconstruction that never gets sharp;
here it is found within seconds, and named.
"""

from collections.abc import Callable

from ..capture import Capture
from .lidar_check import check_by_lidar
from .match_check import check_by_matches
from .pose_verdict import PoseCheck

_CHECKS = (check_by_matches, check_by_lidar)


def check_poses(capture: Capture, on_progress: Callable[[float], None] | None = None) -> tuple[PoseCheck, ...]:
    """Check each camera by all that the capture offers; nothing where it has no poses, or nothing to compare.

    `on_progress` is called with the fraction that is done.
    """
    if not capture.has_poses:
        return ()
    checks: list[PoseCheck] = []
    for k, sensor in enumerate(capture.sensors, 1):
        found = (check(capture, sensor) for check in _CHECKS)
        checks += [each for each in found if each is not None]
        if on_progress is not None:
            on_progress(k / len(capture.sensors))
    return tuple(checks)
