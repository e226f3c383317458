"""The small scene without its road and with two flat cars ahead, of which the near one hides half of the far one."""

from dataclasses import replace

import numpy as np

from gsrain_engine.scene.scene import Actor, PoseTrack
from small_scene import patch, small_scene

NEAR_M, FAR_M = 10.0, 20.0
SIZE_LWH = (4.0, 2.0, 1.5)


def flat_car(name, x, y, color, class_name="Car"):
    """A car whose rear is all there is of it, at the middle of its length, standing at a place of the world."""
    rear = patch((0, -1.0, 0.0), np.array([0, 2.0, 0]), np.array([0, 0, 1.5]), 40, color)
    track = PoseTrack(np.zeros(1), np.array([[x, y, 0.0]]), np.array([[1.0, 0, 0, 0]]), np.ones(1, bool))
    return Actor(name, class_name, SIZE_LWH, rear, track)


def boxy_scene(name="boxy"):
    """The ego stands at the origin, its camera at 1.5 m looks along +x: `near` 10 m ahead, `far` 20 m, half hidden."""
    scene = small_scene(name)
    still = replace(scene.ego, positions=np.tile([0.0, 0, 1.5], (len(scene.ego.times), 1)))
    # Seen from the origin, the far car's left edge is at 0; the near car spans -0.1..0.1 of the tangent.
    cars = flat_car("near", NEAR_M, 0.0, (0.9, 0.05, 0.05)), flat_car("far", FAR_M, -2.0, (0.1, 0.2, 0.9))
    return replace(scene, layers=scene.layers[1:], actors=cars, ego=still)
