"""What a box in a camera's picture says about the lane ahead: how far away, and whether in the way."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gsrain_engine.evaluate.detection.detector import Detection
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.coco_classes import coco_class

from ...vehicle.vehicle import Vehicle
from ..lane_path import LanePath, OnPath, half_corridor_m

WIDTHS_M = {"car": 1.8, "truck": 2.5, "bus": 2.5, "train": 2.9, "motorcycle": 0.8, "bicycle": 0.6, "person": 0.5}
"""Who may be in the way, and how wide it is seen from behind."""
OVERHANGS_M = {"car": 0.8, "truck": 1.0, "bus": 2.0, "train": 1.0}
"""From the rear bumper to where the tyres touch the road: a box ends at the tyres. Others end where they stand."""
_OTHER_WORDS = {"rider": "person", "cyclist": "bicycle", "motorcyclist": "motorcycle"}
_EDGE = 0.03
"""Share of the picture: a box that ends so near to its edge may be cut off by it."""
_BOX_ERROR = 0.002
"""Standard error of a box's edge from picture to picture, as a share of the picture's width (1.6 px in 800)."""
_LEAST_ERROR_M = 0.3
_WIDTH_ERROR = 0.1
"""Of a width that is only assumed. The gap is taken to be shorter by as much: cars of unusual width, and boxes that do
not reach around all of a car that fills the picture, must not be hit."""
_FARTHEST_M = 80.0
"""Beyond it the lower edge of a box is nearer to the horizon than its error."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """A road user in the lane ahead, as one picture shows it."""

    detection: Detection
    gap_m: float
    """From the front bumper to the nearest of it, along the route."""
    error_m: float
    """Standard error of the gap."""


def sightings(
    detections: Iterable[Detection], camera: Camera, height_m: float, path: LanePath, vehicle: Vehicle
) -> list[Sighting]:
    """Return who is in the lane ahead; the ground is level, at a height in the world."""
    found = (_sighting(each, camera, height_m, path, vehicle) for each in detections)
    return [each for each in found if each is not None]


def road_user_class(detection: Detection) -> str | None:
    """Return the class of COCO that a detection falls into; none where it is nobody on the road."""
    name = coco_class(detection.class_name)
    name = _OTHER_WORDS.get(name, name)
    return name if name in WIDTHS_M else None


def _sighting(
    detection: Detection, camera: Camera, height_m: float, path: LanePath, vehicle: Vehicle
) -> Sighting | None:
    name = road_user_class(detection)
    if name is None:
        return None
    left, _, right, bottom = detection.box_xyxy
    middle = (left + right) / 2
    focal, above = camera.fy, float(camera.position[2]) - height_m
    depth = _depth_of_ground(camera, middle, bottom, above)
    cut_below = bottom > (1 - _EDGE) * camera.height
    overhang, error = OVERHANGS_M.get(name, 0.0), 0.0
    if cut_below:  # the ground below it is not in the picture: it is nearer than what the edge shows
        by_width = camera.fx * WIDTHS_M[name] / max(right - left, 1.0)
        if by_width < depth:
            error = _WIDTH_ERROR * by_width
            depth, overhang = by_width, error
    if not 0 < depth <= _FARTHEST_M:
        return None
    place = _placed(camera, middle, depth, path)
    width = min((right - left) * depth / camera.fx, WIDTHS_M[name])
    if (left < _EDGE * camera.width) != (right > (1 - _EDGE) * camera.width):
        # Cut off at one side: its middle lies farther out than that of the box, which alone must be in the way.
        width = 0.0
    if abs(place.left_m) - width / 2 > half_corridor_m(vehicle):
        return None
    by_edge = _BOX_ERROR * camera.width * depth * depth / (focal * above)
    gap = place.ahead_m - overhang - vehicle.front_m
    return Sighting(detection, gap, float(np.hypot(_LEAST_ERROR_M, max(error, by_edge))))


def _depth_of_ground(camera: Camera, u: float, v: float, above_m: float) -> float:
    """Distance along the optical axis at which the ray through a pixel meets the ground; infinite above the horizon."""
    down = -float(camera.camera_to_world[2, :3] @ _ray(camera, u, v))
    return above_m / down if down > 0 else np.inf


def _placed(camera: Camera, u: float, depth_m: float, path: LanePath) -> OnPath:
    """Where a column of the picture is on the path, at a distance along the optical axis."""
    x, y, _ = camera.position + depth_m * (camera.camera_to_world[:3, :3] @ _ray(camera, u, camera.cy))
    return path.place(float(x), float(y))


def _ray(camera: Camera, u: float, v: float) -> np.ndarray:
    return np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
