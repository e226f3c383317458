"""A scene whose drive bends: a quarter of a circle of 40 m to the left, 5 m/s."""

from dataclasses import replace

import numpy as np

from gsrain_engine.scene.scene import PoseTrack
from small_scene import small_scene

RADIUS_M = 40.0


def curved_scene():
    """About 1,000 Gaussians, and an ego vehicle that turns from +x to +y."""
    times = np.linspace(0.0, RADIUS_M * np.pi / 2 / 5.0, 40)
    turned = times * 5.0 / RADIUS_M
    places = np.stack([RADIUS_M * np.sin(turned), RADIUS_M * (1 - np.cos(turned)), np.full(40, 1.5)], axis=1)
    quaternions = np.stack([np.cos(turned / 2), 0 * turned, 0 * turned, np.sin(turned / 2)], axis=1)
    return replace(small_scene("curved"), ego=PoseTrack(times, places, quaternions, np.ones(40, bool)))
