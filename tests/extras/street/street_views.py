"""Views of the street's mesh with true depth: what matching is tested on."""

from functools import lru_cache

import numpy as np

from gsrain_engine.appearance.base import ClearView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_extras.street.ground_truth import capture_street

from .built_street import SHORT, surfaces_of

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
    capture = capture_street(
        cameras, [time_s for *_, time_s, _ in PLACES.values()], surfaces_of(SHORT), names=list(PLACES)
    )
    sensors = [sensor for *_, sensor in PLACES.values()]
    return {view.name: clear_view(view, sensor) for view, sensor in zip(capture, sensors, strict=True)}


def street_camera(x: float, heading: float) -> Camera:
    eye = np.array([x, 0.0, 1.5])
    ahead = np.array([np.cos(heading), np.sin(heading), -0.03])
    return Camera.from_fov(WIDTH, HEIGHT, 55, look_at(eye, eye + ahead, np.array([0, 0, 1.0])))


def clear_view(view, sensor):
    image, normals = view.image.astype(np.float32) / 255, view.normals
    sky, vehicles = view.sky.astype(np.float32), (~view.mask).astype(np.float32)
    return ClearView(view.name, view.camera, view.time_s, image, view.depth, normals, sky, vehicles, sensor)


def made_view(camera, depth, sky=None, vehicles=None, time_s=0.0, name="made"):
    """A gray view of arrays."""
    nothing = np.zeros(depth.shape, np.float32)
    sky, vehicles = (nothing if each is None else each.astype(np.float32) for each in (sky, vehicles))
    gray = np.full((*depth.shape, 3), 0.5, np.float32)
    return ClearView(name, camera, time_s, gray, depth.astype(np.float32), 0 * gray, sky, vehicles)
