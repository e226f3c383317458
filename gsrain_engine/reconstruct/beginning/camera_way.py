"""Where the cameras of a capture went, also between their pictures."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from gsrain_engine.datasets.capture import View

_PARTS = 8
"""Of each stretch between two pictures."""
_LONGEST = 0.5
"""Of a stretch, over the usual depth of what cameras see: so far they see that the way is free."""


def camera_way(views: Sequence[View], usual_depth: float) -> Float64[np.ndarray, "p 3"]:
    """Places of the cameras in the capture's world, and some more between each two pictures of a sensor.

    Args:
        views: In any order.
        usual_depth: Of what they see, in the capture's unit; stretches that are long beside it are left open.
    """
    stretches: list[tuple[np.ndarray, np.ndarray]] = []
    for sensor in dict.fromkeys(view.sensor for view in views):
        own = sorted((view for view in views if view.sensor == sensor), key=lambda view: view.time_s)
        stretches += [(one.camera.position, other.camera.position) for one, other in pairwise(own)]
    lengths = [float(np.linalg.norm(end - start)) for start, end in stretches]
    between = [
        start + (end - start) * part / _PARTS
        for (start, end), length in zip(stretches, lengths, strict=True)
        if 0 < length <= _LONGEST * usual_depth
        for part in range(1, _PARTS)
    ]
    return np.array([view.camera.position for view in views] + between)
