"""Parts without their colours, for what only asks where Gaussians are: harmonics are most of what a scene weighs."""

import numpy as np

from gsrain_engine.scene.members import Part


def colorless(part: Part) -> Part:
    """Return a part all in grey; it takes no memory until somebody reads it."""
    count = len(part.gaussians)
    return part._replace(gaussians=part.gaussians.with_sh(np.zeros((count, 1, 3), np.float32)), colors=None)
