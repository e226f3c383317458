"""What is usually wrong with poses, as poses that would then be right."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from ..capture import Capture, View
from ..geometry.rigid_poses import inverse

_FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One explanation of poses that don't fit."""

    told: str
    """What is wrong, as the end of a sentence."""
    poses: tuple[Float64[np.ndarray, "4 4"], ...]
    """World to camera of the views asked for, if that is so."""


def hypotheses(capture: Capture, views: Sequence[View]) -> list[Hypothesis]:
    """Usual mistakes for some views of one camera: inverted, other axes, the poses of another camera of the rig."""
    given = [view.camera.world_to_camera for view in views]
    usual = [
        Hypothesis("the matrices are camera to world, not world to camera", tuple(inverse(pose) for pose in given)),
        Hypothesis("the camera axes are OpenGL's (y up, z backward)", tuple(_FLIPPED @ pose for pose in given)),
        Hypothesis(
            "the matrices are camera to world, with OpenGL's axes", tuple(inverse(pose @ _FLIPPED) for pose in given)
        ),
    ]
    others = [sensor for sensor in capture.sensors if sensor != views[0].sensor]
    return usual + [Hypothesis(f"the poses are those of {o}", _poses_of(capture, o, views)) for o in others]


def _poses_of(capture: Capture, sensor: str, views: Sequence[View]) -> tuple[Float64[np.ndarray, "4 4"], ...]:
    """Poses of another camera at the times of some views; where times don't tell, at their places in the row."""
    own, other = ([v for v in capture if v.sensor == each] for each in (views[0].sensor, sensor))
    places = {view.name: k for k, view in enumerate(own)}
    nearest = [
        min(enumerate(other), key=lambda each: (abs(each[1].time_s - view.time_s), abs(each[0] - places[view.name])))[1]
        for view in views
    ]
    return tuple(view.camera.world_to_camera for view in nearest)
