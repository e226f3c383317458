"""Views of the street's mesh with true depth: what matching is tested on."""

from functools import lru_cache

import numpy as np

from gsrain_engine.appearance.base import ClearView
from gsrain_engine.datasets.street import capture_street
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.street.layout import StreetParameters

SMALL = StreetParameters(length_m=120.0, parked_share=0.3, tree_spacing_m=30.0)
WIDTH, HEIGHT = 360, 240

PLACES = {
    "first": (0.0, 0.0, 0.0, "FRONT"),
    "second": (1.0, 0.0, 0.1, "FRONT"),
    "third": (2.0, 0.0, 0.2, "FRONT"),
    "left": (1.0, 0.6, 0.1, "LEFT"),
}
"""Metres along the street, heading in radians, seconds, sensor."""


@lru_cache(maxsize=1)
def street_views() -> dict[str, ClearView]:
    """Three views on the way, 1 m apart, and one of another camera beside the second."""
    cameras = [street_camera(x, heading) for x, heading, _, _ in PLACES.values()]
    capture = capture_street(cameras, [time_s for *_, time_s, _ in PLACES.values()], SMALL, names=list(PLACES))
    sensors = [sensor for *_, sensor in PLACES.values()]
    return {view.name: clear_view(view, sensor) for view, sensor in zip(capture, sensors, strict=True)}


def street_camera(x: float, heading: float, width: int = WIDTH) -> Camera:
    eye = np.array([x, 0.0, 1.5])
    ahead = np.array([np.cos(heading), np.sin(heading), -0.03])
    return Camera.from_fov(width, 2 * width // 3, 55, look_at(eye, eye + ahead, np.array([0, 0, 1.0])))


def clear_view(view, sensor=""):
    return ClearView(
        view.name,
        view.camera,
        view.time_s,
        view.image.astype(np.float32) / 255,
        view.depth,
        view.normals,
        view.sky.astype(np.float32),
        (~view.mask).astype(np.float32),
        sensor,
    )


def made_view(camera, depth, image=None, sky=None, vehicles=None, time_s=0.0, name="made", sensor=""):
    """A view of arrays; without an image a gray one."""
    depth = np.asarray(depth, np.float32)
    nothing = np.zeros(depth.shape, np.float32)
    return ClearView(
        name,
        camera,
        time_s,
        np.full((*depth.shape, 3), 0.5, np.float32) if image is None else np.asarray(image, np.float32),
        depth,
        np.zeros((*depth.shape, 3), np.float32),
        nothing if sky is None else np.asarray(sky, np.float32),
        nothing if vehicles is None else np.asarray(vehicles, np.float32),
        sensor,
    )
