"""One grey channel of a view's normals, -1 to 1, for an encoder that takes it beside red, green and blue."""

from typing import Literal

import numpy as np
from jaxtyping import Float, Float32

from gsrain_engine.scene.camera import Camera

from .axes import right_down_outward

GuideKind = Literal["up", "luma"]

_LUMA = np.array([0.299, 0.587, 0.114])
"""Rec. 601, as in Pillow's mode L."""


def grey_guide(
    normals: Float[np.ndarray, "h w 3"], camera: Camera, kind: GuideKind = "up"
) -> Float32[np.ndarray, "h w"]:
    """Return the guide of unit world normals (z up) towards the eye; 0 where they are 0: unknown surfaces and the sky.

    `up` is their upward part: 1 on level ground, 0 on walls, whatever way the camera turns. `luma` is the luma of the
    picture that a normal estimator draws, (n + 1) / 2 with n in camera axes away from the eye, brought to -1..1: 0.587
    on level ground before a level camera, 0.114 on a wall that faces it. The paper turns normals to grey without saying
    how; both are ways to read it.
    """
    if kind == "up":
        return np.clip(normals[..., 2], -1, 1).astype(np.float32)
    return np.clip(right_down_outward(normals, camera) @ _LUMA, -1, 1).astype(np.float32)
