"""Lead vehicle tracking: sightings from camera detections, and an alpha-beta filter per track."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...evaluation.detection.detector import Detection
from ...scene.camera import Camera
from ...scene.objects import coco_class
from ..traffic.base import VehicleAhead
from ..vehicle import Vehicle
from .base import LanePath, half_corridor_m

_ACCELERATION_M_S2 = 4.0  # standard deviation of a lead's acceleration; makes braking with 8 m/s2 rare but possible
_GATE = 3.0  # gate in standard deviations; sightings farther from the prediction belong to another road user
_GATE_M = 1.5  # additional gate width, for detectors with unsteady boxes
_COAST_S, _NEAR_COAST_S = 1.0, 30.0
_NEAR_M, _STANDS_M_S = 6.0, 0.5
"""Distance and speed below which a lost road user counts as standing for up to half a minute.

Other tracks last one second without sightings, longer than wipers and gusts of rain take. Detectors lose vehicles so
near that they leave the image at the bottom; one that drives on is detected again, and setting off behind one that
stays would hit it.
"""

MIN_CONFIDENCE = 0.3
"""Minimum confidence to start or confirm a track; less confident sightings only extend tracks. COCO detectors find
most objects with few false alarms at 0.25 to 0.4."""

_SURE = 0.6  # confidence that suffices for one sighting; less confident ones must be seen twice


@dataclass(frozen=True, slots=True)
class Sighting:
    """A road user in the lane ahead in an image, with the gap along the route to its nearest part."""

    detection: Detection
    gap_m: float
    error_m: float


@dataclass(frozen=True, slots=True)
class LeadTrack:
    """A tracked road user in the lane. Positions along the route cancel the ego motion."""

    class_name: str
    along_m: float
    """Position of its nearest part along the route."""
    speed_m_s: float
    place_variance_m2: float
    covariance_m2_s: float
    speed_variance_m2_s2: float
    count: int = 1  # of sightings
    unseen_s: float = 0.0
    sure: bool = False

    @classmethod
    def begun(cls, sighting: Sighting, front_along_m: float, own_speed_m_s: float) -> "LeadTrack":
        """Start a track: its prior speed ranges from standing to about the ego speed."""
        half = 0.5 * own_speed_m_s
        return cls(
            sighting.detection.class_name, front_along_m + sighting.gap_m, half, sighting.error_m**2, 0.0,
            (half + 1.0) ** 2, sure=sighting.detection.confidence >= _SURE,
        )  # fmt: skip

    def later(self, dt_s: float) -> "LeadTrack":
        """Predict the track at constant speed."""
        q = (_ACCELERATION_M_S2 * dt_s) ** 2
        lost_standing = self.unseen_s > 0 and abs(self.speed_m_s) < _STANDS_M_S
        speed = 0.0 if lost_standing else self.speed_m_s
        return replace(
            self,
            along_m=self.along_m + speed * dt_s,
            speed_m_s=speed,
            place_variance_m2=self.place_variance_m2
            + dt_s * (2 * self.covariance_m2_s + dt_s * self.speed_variance_m2_s2)
            + q * dt_s * dt_s / 4,
            covariance_m2_s=self.covariance_m2_s + dt_s * self.speed_variance_m2_s2 + q * dt_s / 2,
            speed_variance_m2_s2=self.speed_variance_m2_s2 + q,
            unseen_s=self.unseen_s + dt_s,
        )

    def updated(self, sighting: Sighting, front_along_m: float) -> "LeadTrack":
        """Update the track with a sighting.

        Gains are optimal for the errors (Kalman's, for constant speed): alpha corrects the position, beta over the time
        between sightings the speed. With equal errors they converge to Kalata's (1984); a fixed pair can't fit both
        near and far, because the error of a distance grows with its square.
        """
        surprise = front_along_m + sighting.gap_m - self.along_m
        total = self.place_variance_m2 + sighting.error_m**2
        alpha, speed_gain = self.place_variance_m2 / total, self.covariance_m2_s / total
        return replace(
            self,
            class_name=sighting.detection.class_name,
            along_m=self.along_m + alpha * surprise,
            speed_m_s=self.speed_m_s + speed_gain * surprise,
            place_variance_m2=(1 - alpha) * self.place_variance_m2,
            covariance_m2_s=(1 - alpha) * self.covariance_m2_s,
            speed_variance_m2_s2=self.speed_variance_m2_s2 - speed_gain * self.covariance_m2_s,
            count=self.count + 1,
            unseen_s=0.0,
            sure=self.sure or sighting.detection.confidence >= MIN_CONFIDENCE,
        )

    def distance(self, sighting: Sighting, front_along_m: float) -> float | None:
        """Return the distance of a sighting from the prediction (m); None outside the gate."""
        away = abs(front_along_m + sighting.gap_m - self.along_m)
        return away if away <= _GATE_M + _GATE * np.sqrt(self.place_variance_m2 + sighting.error_m**2) else None

    def believed(self, front_along_m: float) -> bool:
        """Return whether the track is still valid. A tentative track ends with its first miss."""
        if not self.sure:
            return self.unseen_s == 0
        near = self.along_m - front_along_m < _NEAR_M
        return self.unseen_s <= (_NEAR_COAST_S if near else _COAST_S) + 1e-9


_DOUBLE_M = 4.0
"""Distance within which boxes are duplicates of one object (car and truck, whole and cab) and start no track."""


class LeadState(NamedTuple):
    """The lead, its track, and its sighting in the current image; None if missed."""

    lead: VehicleAhead
    track: LeadTrack
    sighting: Sighting | None


class LeadTracker:
    """Tracks road users over time. Deterministic."""

    def __init__(self) -> None:
        self._tracks: list[tuple[LeadTrack, Sighting | None]] = []

    def look(self, found: Sequence[Sighting], front_along_m: float, speed_m_s: float, dt_s: float) -> LeadState | None:
        """Update all tracks with the sightings after `dt_s`; returns the nearest confirmed one, None in a free lane.

        `front_along_m` is the position of the front bumper along the route.
        """
        left = list(found)
        tracks: list[tuple[LeadTrack, Sighting | None]] = []
        for track, _ in sorted(self._tracks, key=lambda each: each[0].along_m):
            track = track.later(dt_s)
            near = [(away, each) for each in left if (away := track.distance(each, front_along_m)) is not None]
            sighting = min(near, key=lambda each: each[0])[1] if near else None
            if sighting is not None:
                left.remove(sighting)
                track = track.updated(sighting, front_along_m)
            if track.believed(front_along_m):
                tracks.append((track, sighting))
        for sighting in sorted(left, key=lambda each: -each.detection.confidence):
            place = front_along_m + sighting.gap_m
            new = sighting.detection.confidence >= MIN_CONFIDENCE
            if new and all(abs(place - track.along_m) > _DOUBLE_M + sighting.error_m for track, _ in tracks):
                tracks.append((LeadTrack.begun(sighting, front_along_m, speed_m_s), sighting))
        self._tracks = tracks
        sure = [each for each in tracks if each[0].sure]
        if not sure:
            return None
        track, sighting = min(sure, key=lambda each: each[0].along_m)
        return LeadState(VehicleAhead(track.along_m - front_along_m, track.speed_m_s), track, sighting)


WIDTHS_M = {"car": 1.8, "truck": 2.5, "bus": 2.5, "train": 2.9, "motorcycle": 0.8, "bicycle": 0.6, "person": 0.5}
"""Road user classes, with their assumed width seen from behind."""

OVERHANGS_M = {"car": 0.8, "truck": 1.0, "bus": 2.0, "train": 1.0}
"""Distance from the rear bumper to the tires' contact, where boxes end at the bottom. Zero for other classes."""

_OTHER_WORDS = {"rider": "person", "cyclist": "bicycle", "motorcyclist": "motorcycle"}
_EDGE = 0.03  # margin as a share of the image; a box that ends closer to the edge may be truncated
_BOX_ERROR = 0.002  # standard error of a box edge between images, as a share of the image width (1.6 px in 800)
_MIN_ERROR_M = 0.3
_WIDTH_ERROR = 0.1
"""Relative error of an assumed width. The gap is shortened by it, to avoid hitting cars of unusual width, and cars
that fill the image and exceed their boxes."""

_FARTHEST_M = 80.0  # maximum distance; beyond it the lower box edge is closer to the horizon than its error


def sightings(
    detections: Iterable[Detection], camera: Camera, height_m: float, path: LanePath, vehicle: Vehicle
) -> list[Sighting]:
    """Return the sightings in the lane ahead, on level ground at a height in the world."""
    found = (_sighting(each, camera, height_m, path, vehicle) for each in detections)
    return [each for each in found if each is not None]


def road_user_class(detection: Detection) -> str | None:
    """Return the COCO class of a detection; None if it is not a road user."""
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
    above = float(camera.position[2]) - height_m
    down = -float(camera.camera_to_world[2, :3] @ _ray(camera, middle, bottom))
    depth = above / down if down > 0 else np.inf  # where the ray meets the ground; nowhere above the horizon
    cut_below = bottom > (1 - _EDGE) * camera.height
    overhang, error = OVERHANGS_M.get(name, 0.0), 0.0
    if cut_below:  # the contact point is outside the image, so it is nearer than the edge suggests
        by_width = camera.fx * WIDTHS_M[name] / max(right - left, 1.0)
        if by_width < depth:
            error = _WIDTH_ERROR * by_width
            depth, overhang = by_width, error
    if not 0 < depth <= _FARTHEST_M:
        return None
    x, y, _ = camera.position + depth * (camera.camera_to_world[:3, :3] @ _ray(camera, middle, camera.cy))
    place = path.place(float(x), float(y))
    width = min((right - left) * depth / camera.fx, WIDTHS_M[name])
    if (left < _EDGE * camera.width) != (right > (1 - _EDGE) * camera.width):
        # Truncated on one side: its center lies farther out than the box, whose center alone must be in the lane.
        width = 0.0
    if abs(place.left_m) - width / 2 > half_corridor_m(vehicle):
        return None
    by_edge = _BOX_ERROR * camera.width * depth * depth / (camera.fy * above)
    gap = place.ahead_m - overhang - vehicle.front_m
    return Sighting(detection, gap, float(np.hypot(_MIN_ERROR_M, max(error, by_edge))))


def _ray(camera: Camera, u: float, v: float) -> np.ndarray:
    if camera.lens is not None:
        x, y, z = np.nan_to_num(camera.directions(np.array([[u, v]]))[0], nan=0.5).tolist()
        return np.array([x, y, z]) / max(z, 1e-3)
    return np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
