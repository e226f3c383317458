"""Where the cameras of a capture went, also between their pictures."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from gsrain_engine.datasets.capture import View

_PARTS = 4
"""Of each stretch between two pictures."""
_LONGEST = 4.0
"""Of a stretch that is one, over the usual one: beyond, the camera was somewhere else meanwhile."""


def camera_way(views: Sequence[View]) -> Float64[np.ndarray, "p 3"]:
    """Places of the cameras in the capture's world, and three more between each two pictures of a sensor."""
    stretches: list[tuple[np.ndarray, np.ndarray]] = []
    for sensor in dict.fromkeys(view.sensor for view in views):
        own = sorted((view for view in views if view.sensor == sensor), key=lambda view: view.time_s)
        stretches += [(one.camera.position, other.camera.position) for one, other in pairwise(own)]
    lengths = np.array([np.linalg.norm(end - start) for start, end in stretches])
    longest = _LONGEST * float(np.median(lengths[lengths > 0])) if (lengths > 0).any() else 0.0
    between = [
        start + (end - start) * part / _PARTS
        for (start, end), length in zip(stretches, lengths, strict=True)
        if 0 < length <= longest
        for part in range(1, _PARTS)
    ]
    return np.array([view.camera.position for view in views] + between)
