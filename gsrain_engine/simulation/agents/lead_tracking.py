"""Whoever drives or stands ahead in the lane, as far as a planner needs to know."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...evaluation.detection.detector import Detection
from ...scene.camera import Camera
from ...scene.objects import coco_class
from ..vehicle import Vehicle
from .base import LanePath, PathCoordinates, half_corridor_m


@dataclass(frozen=True, slots=True)
class LeadVehicle:
    """What is ahead in the lane at a moment."""

    gap_m: float
    """From the front bumper to the nearest of it, along the route; 0 or less where they touch."""
    speed_m_s: float
    """Its own speed along the route; below 0 it comes nearer by itself."""


# § What is believed of one road user in the lane, from sightings over time: an alpha-beta filter.

_ACCELERATION_M_S2 = 4.0
"""Standard deviation of what a lead does to its speed: so that braking with 8 m/s2 is rare, not unheard of."""

_GATE = 3.0
"""Standard deviations; what lies farther from where somebody was expected is somebody else."""

_GATE_M = 1.5
"""Room in addition, for detectors whose boxes jump."""

_COAST_S, _NEAR_COAST_S = 1.0, 30.0

_NEAR_M, _STANDS_M_S = 6.0, 0.5
"""Without sightings somebody is believed for a second: longer than wipers and gusts of rain take. Detectors lose who is
so near that it leaves the picture below; if it drives on, it is seen again, and if not, setting off would hit it: until
then it is taken to stand where it stood, for half a minute at most."""

MIN_CONFIDENCE = 0.3
"""Less confident sightings begin nothing and confirm nothing; they keep in view who is known. Detectors of COCO find
the most, at few false alarms, from 0.25 to 0.4 on."""

_SURE = 0.6
"""Confidence that is enough to act on a first sight; the less confident must be seen twice."""

# § What a box in a camera's picture says about the lane ahead: how far away, and whether in the way.


@dataclass(frozen=True, slots=True)
class Sighting:
    """A road user in the lane ahead, as one picture shows it."""

    detection: Detection
    gap_m: float
    """From the front bumper to the nearest of it, along the route."""
    error_m: float
    """Standard error of the gap."""


@dataclass(frozen=True, slots=True)
class LeadTrack:
    """Somebody in the lane. Its place is counted along the route, in which the own motion is known and cancels."""

    class_name: str
    along_m: float
    """Nearest of it, on the route."""
    speed_m_s: float
    """Along the route."""
    place_variance_m2: float
    covariance_m2_s: float
    speed_variance_m2_s2: float
    seen: int = 1
    """Sightings."""
    unseen_s: float = 0.0
    """Since the last one."""
    sure: bool = False

    @classmethod
    def begun(cls, sighting: Sighting, front_along_m: float, own_speed_m_s: float) -> "LeadTrack":
        """Return what is believed on first sight: that it is about as fast as the own vehicle, or slower, or stands."""
        half = 0.5 * own_speed_m_s
        return cls(
            sighting.detection.class_name, front_along_m + sighting.gap_m, half, sighting.error_m**2, 0.0,
            (half + 1.0) ** 2, sure=sighting.detection.confidence >= _SURE,
        )  # fmt: skip

    def later(self, dt_s: float) -> "LeadTrack":
        """Return what is believed a time later, at constant speed."""
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
        """Return what is believed after a sighting of it.

        Gains are the best for the errors (Kalman's, for constant speed): alpha corrects the place, beta over the time
        between sightings the speed. With equal errors they settle at Kalata's (1984); with a fixed pair near and far
        could not both be right, for the error of a distance grows with its square.
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
            seen=self.seen + 1,
            unseen_s=0.0,
            sure=self.sure or sighting.detection.confidence >= MIN_CONFIDENCE,
        )

    def distance(self, sighting: Sighting, front_along_m: float) -> float | None:
        """Return how far from the expected place a sighting is (m); none where it is too far to be the same."""
        away = abs(front_along_m + sighting.gap_m - self.along_m)
        return away if away <= _GATE_M + _GATE * np.sqrt(self.place_variance_m2 + sighting.error_m**2) else None

    def believed(self, front_along_m: float) -> bool:
        """Whether it is still taken to be there. The unsure one that is missed once was none."""
        if not self.sure:
            return self.unseen_s == 0
        near = self.along_m - front_along_m < _NEAR_M
        return self.unseen_s <= (_NEAR_COAST_S if near else _COAST_S) + 1e-9


# § Keeps track of everybody who was seen in the lane ahead, and says who leads.

_DOUBLE_M = 4.0
"""Boxes of one thing (car and truck, the whole and its cab) lie so near to each other: they begin nothing new."""


class LeadState(NamedTuple):
    """Who leads, and what it was last seen as."""

    lead: LeadVehicle
    track: LeadTrack
    sighting: Sighting | None
    """Of this moment; none where it was missed."""


class LeadTracker:
    """Remembers from moment to moment. The same sightings give the same answer."""

    def __init__(self) -> None:
        self._tracks: list[tuple[LeadTrack, Sighting | None]] = []

    def look(self, seen: Sequence[Sighting], front_along_m: float, speed_m_s: float, dt_s: float) -> LeadState | None:
        """Take in what is seen a time after the last look; `front_along_m` is the front bumper's place on the route.

        Returns the nearest one that is sure to be there; none where the lane is free.
        """
        left = list(seen)
        tracks: list[tuple[LeadTrack, Sighting | None]] = []
        for track, _ in sorted(self._tracks, key=lambda each: each[0].along_m):
            track = track.later(dt_s)
            sighting = _nearest(track, left, front_along_m)
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
        return LeadState(LeadVehicle(track.along_m - front_along_m, track.speed_m_s), track, sighting)


def _nearest(track: LeadTrack, seen: Sequence[Sighting], front_along_m: float) -> Sighting | None:
    """The sighting that lies nearest to where somebody was expected, if near enough."""
    near = [(away, each) for each in seen if (away := track.distance(each, front_along_m)) is not None]
    return min(near, key=lambda each: each[0])[1] if near else None


WIDTHS_M = {"car": 1.8, "truck": 2.5, "bus": 2.5, "train": 2.9, "motorcycle": 0.8, "bicycle": 0.6, "person": 0.5}
"""Who may be in the way, and how wide it is seen from behind."""

OVERHANGS_M = {"car": 0.8, "truck": 1.0, "bus": 2.0, "train": 1.0}
"""From the rear bumper to where the tyres touch the road: a box ends at the tyres. Others end where they stand."""

_OTHER_WORDS = {"rider": "person", "cyclist": "bicycle", "motorcyclist": "motorcycle"}

_EDGE = 0.03
"""Share of the picture: a box that ends so near to its edge may be cut off by it."""

_BOX_ERROR = 0.002
"""Standard error of a box's edge from picture to picture, as a share of the picture's width (1.6 px in 800)."""

_MIN_ERROR_M = 0.3

_WIDTH_ERROR = 0.1
"""Of a width that is only assumed. The gap is taken to be shorter by as much: cars of unusual width, and boxes that do
not reach around all of a car that fills the picture, must not be hit."""

_FARTHEST_M = 80.0
"""Beyond it the lower edge of a box is nearer to the horizon than its error."""


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
    return Sighting(detection, gap, float(np.hypot(_MIN_ERROR_M, max(error, by_edge))))


def _depth_of_ground(camera: Camera, u: float, v: float, above_m: float) -> float:
    """Distance along the optical axis at which the ray through a pixel meets the ground; infinite above the horizon."""
    down = -float(camera.camera_to_world[2, :3] @ _ray(camera, u, v))
    return above_m / down if down > 0 else np.inf


def _placed(camera: Camera, u: float, depth_m: float, path: LanePath) -> PathCoordinates:
    """Where a column of the picture is on the path, at a distance along the optical axis."""
    x, y, _ = camera.position + depth_m * (camera.camera_to_world[:3, :3] @ _ray(camera, u, camera.cy))
    return path.place(float(x), float(y))


def _ray(camera: Camera, u: float, v: float) -> np.ndarray:
    return np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
