"""Wet colours, as a recolouring has found them, on the members of a scene."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.scene import Scene


def with_colors(scene: Scene, colors: Mapping[str, Float32[np.ndarray, "_ _ 3"]]) -> Scene:
    """Return the scene with wet colours, by `layers/NAME` and `actors/ID`; what is not named keeps what it has.

    Colours are of all of a member's Gaussians, or of those that are not deleted: files know no others.
    """
    for key, sh in colors.items():
        member = scene.member(key)
        deleted = member.marks.deleted
        if deleted is not None and len(sh) < len(member.gaussians):
            whole = member.gaussians.sh.copy()
            whole[(~deleted).indices] = sh
            sh = whole
        scene = scene.with_member(key, wet_sh=sh)
    return scene
