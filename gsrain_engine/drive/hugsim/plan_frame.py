"""From a HUGSIM plan to ours: other axes, and another point of the vehicle."""

import numpy as np
from jaxtyping import Float64

_SAME_PLACE_M = 0.05


def to_vehicle_frame(
    plan: Float64[np.ndarray, "n 2"], front_m: tuple[float, float]
) -> Float64[np.ndarray, "n 2"]:  # fmt: skip
    """Return where the rear axle is to be (x forward, y left), for a plan of the front camera (x right, y forward).

    HUGSIM's point of reference is the front camera, `front_m` (forward, left) of our rear axle; both plans begin at
    their own point. Behind a front that moves on straight from point to point the rear axle follows on a tractrix: the
    angle d between heading and motion shrinks as tan(d / 2) exp(-length / wheelbase), with the camera's distance ahead
    of the axle for the wheelbase. Where the camera stands above the axle, as in HUGSIM's own setting, points stay as
    they are.
    """
    forward = plan[:, ::-1] * (1.0, -1.0) + 0.0  # not -0
    ahead, left = front_m
    if ahead < _SAME_PLACE_M:
        return np.ascontiguousarray(forward)
    heading, before = 0.0, np.zeros(2)
    rear: list[np.ndarray] = []
    start = np.array([ahead, left])
    for point in forward:
        step = point - before
        length = float(np.hypot(*step))
        if length > 0:
            motion = float(np.arctan2(step[1], step[0]))
            apart = float(np.arctan2(np.sin(motion - heading), np.cos(motion - heading)))
            heading = motion - 2 * float(np.arctan(np.tan(apart / 2) * np.exp(-length / ahead)))
        cosine, sine = np.cos(heading), np.sin(heading)
        arm = np.array([cosine * ahead - sine * left, sine * ahead + cosine * left])
        rear.append(start + point - arm)
        before = point
    return np.array(rear)
