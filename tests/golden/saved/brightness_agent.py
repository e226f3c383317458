"""An agent that drives as fast as its camera's picture is bright: rain that is drawn otherwise leads elsewhere."""

from types import SimpleNamespace

import numpy as np


class BrightnessAgent:
    """Uses no module of the program, and no name of a picture's field."""

    name = "brightness"
    needs = SimpleNamespace(cameras=("front",), depth=False, semantic=False)

    def reset(self, seed, rig):
        """Begin a drive."""

    def plan(self, observation):
        """Return a way straight ahead."""
        (view,) = observation.views.values()
        values = [getattr(view, name) for name in dir(view) if not name.startswith("_")]
        pixels = next(each for each in values if isinstance(each, np.ndarray) and each.dtype == np.uint8)
        mean = float(pixels.mean(dtype=np.float64))
        reached_m = mean / 16 * 0.5 * np.arange(1, 7)
        return SimpleNamespace(points=np.stack([reached_m, np.zeros(6)], axis=1), notes={"mean": mean})

    def close(self):
        """Nothing is held."""
