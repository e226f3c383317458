"""IDM agents: longitudinal planner with emergency braking, oracle agent, and camera agent."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64, UInt8

from ...evaluation.detection.detector import Detection
from ..traffic.base import RoadUser, VehicleAhead
from ..vehicle import Vehicle
from .base import SPACING_S, LanePath, Observation, Rig, SensorRequirements, Trajectory, half_corridor_m
from .lead_tracking import LeadState, LeadTracker, road_user_class, sightings

_POINTS = 6
_SUBSTEPS = 10
_STANDS_M_S = 0.1  # speed below which a vehicle counts as standing


@dataclass(frozen=True, slots=True)
class IDMPlanner:
    """The Intelligent Driver Model (Treiber, Hennecke and Helbing 2000) with emergency braking.

    Gaps are close to those of its paper (2 m and 1.6 s); it accelerates and brakes harder than there (0.73 and 1.67
    m/s2), as in urban traffic, and within the limits of nuPlan's comfort metric (2.40 and 4.05 m/s2).
    """

    cruise_m_s: float
    """Desired speed on a free road."""
    standstill_gap_m: float = 2.0
    time_gap_s: float = 1.5
    acceleration_m_s2: float = 1.5
    braking_m_s2: float = 2.0
    max_comfortable_m_s2: float = 3.0
    """Maximum braking of the model without emergency."""
    hard_m_s2: float = 8.0
    """Maximum emergency braking."""
    hard_reserve: float = 1.25
    """Factor on the braking needed to stop short of the lead, because the gap may be overestimated."""
    hard_gap_m: float = 1.0
    """Gap left by an emergency stop."""
    hard_time_s: float = 0.8
    """Time gap below which the vehicle brakes fully. The model stops with twice that margin."""
    creep_m: float = 1.5
    """Additional gap needed to set off behind a standing vehicle."""

    def distances(self, speed_m_s: float, lead: VehicleAhead | None) -> Float64[np.ndarray, "6"]:
        """Return the distances covered 0.5 s, 1 s, ..., 3 s from now, non-decreasing; the lead keeps its speed."""
        step_s = SPACING_S / _SUBSTEPS
        speed, covered = max(speed_m_s, 0.0), 0.0
        distances: list[float] = []
        for step in range(_POINTS * _SUBSTEPS):
            there = lead and VehicleAhead(lead.gap_m + lead.speed_m_s * step * step_s - covered, lead.speed_m_s)
            acceleration = self.acceleration(speed, there)
            if speed + acceleration * step_s <= 0:
                covered += 0.5 * speed * speed / -acceleration if speed > 0 else 0.0
                speed = 0.0
            else:
                covered += (speed + 0.5 * acceleration * step_s) * step_s
                speed += acceleration * step_s
            if (step + 1) % _SUBSTEPS == 0:
                distances.append(covered)
        return np.array(distances)

    def acceleration(self, speed_m_s: float, lead: VehicleAhead | None) -> float:
        """Return the acceleration (m/s2) for a speed and a lead."""
        free = self.acceleration_m_s2 * (1 - (speed_m_s / self.cruise_m_s) ** 4)
        if lead is None:
            return max(free, -self.max_comfortable_m_s2)
        stands = speed_m_s < _STANDS_M_S and lead.speed_m_s < 5 * _STANDS_M_S
        if stands and lead.gap_m < self.standstill_gap_m + self.creep_m:
            return -self.max_comfortable_m_s2
        return min(self._follow(speed_m_s, lead, free), -self._hard(speed_m_s, lead))

    def _follow(self, speed_m_s: float, lead: VehicleAhead, free_m_s2: float) -> float:
        """Return the IDM acceleration; the desired gap grows with the speed and the closing speed."""
        closing = speed_m_s - lead.speed_m_s
        moving = speed_m_s * closing / (2 * np.sqrt(self.acceleration_m_s2 * self.braking_m_s2))
        desired = self.standstill_gap_m + max(0.0, speed_m_s * self.time_gap_s + float(moving))
        share = desired / max(lead.gap_m, 0.1)
        return max(free_m_s2 - self.acceleration_m_s2 * share * share, -self.max_comfortable_m_s2)

    def _hard(self, speed_m_s: float, lead: VehicleAhead) -> float:
        """Return emergency braking; minus infinity without an emergency."""
        closing = speed_m_s - lead.speed_m_s
        if closing <= 0:
            return -np.inf
        if lead.gap_m <= closing * self.hard_time_s or lead.gap_m <= self.hard_gap_m:
            return self.hard_m_s2
        needed = closing * closing / (2 * (lead.gap_m - self.hard_gap_m))
        return min(self.hard_reserve * needed, self.hard_m_s2) if needed > self.max_comfortable_m_s2 else -np.inf


def cruise_speed(first_m_s: float) -> float:
    """Return the desired speed for an initial speed: the same, or 10 m/s from standstill."""
    return first_m_s if first_m_s >= 1.0 else 10.0


_FORESIGHT_S = 1.5  # prediction time of lane changes at constant lateral speed; a lane change takes twice as long


class _IDMAgent:
    """Plans by the IDM from the first observation on, at the vehicle's initial speed."""

    def __init__(self) -> None:
        self._vehicle = Vehicle()
        self._planner: IDMPlanner | None = None

    def reset(self, seed: int, rig: Rig) -> None:
        self._vehicle, self._planner = rig.vehicle, None

    def close(self) -> None:
        """Do nothing: all resources are released automatically."""

    def _points(self, path: LanePath, lead: VehicleAhead | None) -> Float64[np.ndarray, "6 2"]:
        speed = path.state.speed_m_s
        if self._planner is None:
            self._planner = IDMPlanner(cruise_speed(speed), hard_m_s2=self._vehicle.most_braking_m_s2)
        return path.points(self._planner.distances(speed, lead))


class OracleIDMAgent(_IDMAgent):
    """Follows its lane by the IDM, with ground truth of all road users: without the losses of camera perception."""

    name = "oracle-idm"
    needs = SensorRequirements()

    def plan(self, observation: Observation) -> Trajectory:
        """Return a plan along the route behind the lead."""
        path = LanePath.of(observation.state, observation.route)
        known = find_oracle_lead(observation.road_users, path, self._vehicle)
        lead = known and {"id": known.id, "gap_m": known.lead.gap_m, "speed_m_s": known.lead.speed_m_s}
        return Trajectory(self._points(path, known and known.lead), {"lead": lead})


class OracleLead(NamedTuple):
    """Ground-truth lead in the lane."""

    id: str
    lead: VehicleAhead


def find_oracle_lead(users: Sequence[RoadUser], path: LanePath, vehicle: Vehicle) -> OracleLead | None:
    """Return the nearest road user ahead that is in the vehicle's lane or moves into it; None if the lane is free.

    Also the ground truth for leads from cameras.
    """
    found = [OracleLead(user.id, lead) for user in users if (lead := _as_lead(user, path, vehicle)) is not None]
    return min(found, key=lambda each: each.lead.gap_m, default=None)


def _as_lead(user: RoadUser, path: LanePath, vehicle: Vehicle) -> VehicleAhead | None:
    corners = [path.place(float(x), float(y)) for x, y in user.box.corners]
    middle = path.place(user.x_m, user.y_m)
    if middle.ahead_m < vehicle.middle_m or max(each.ahead_m for each in corners) < vehicle.front_m:
        return None
    turned = user.yaw_rad - path.route.at(path.along_m + middle.ahead_m)[2]
    half, sideways = half_corridor_m(vehicle), user.speed_m_s * float(np.sin(turned)) * _FORESIGHT_S
    low, high = min(each.left_m for each in corners), max(each.left_m for each in corners)
    if low + min(sideways, 0.0) > half or high + max(sideways, 0.0) < -half:
        return None
    gap = min(each.ahead_m for each in corners) - vehicle.front_m
    return VehicleAhead(gap, user.speed_m_s * float(np.cos(turned)))


_MIN_CONFIDENCE = 0.1
"""Minimum confidence of detections. Those from here to `lead_tracking.MIN_CONFIDENCE` only extend a known lead, as in
ByteTrack (Zhang et al. 2022): rain lowers confidence before it hides a car."""


@runtime_checkable
class ObjectDetector(Protocol):
    """Object detector for images, such as `evaluation.detection.detector.Detector`."""

    @property
    def name(self) -> str:
        """Name in roll-outs."""
        ...

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[Detection]:
        """Return the detections in an image (RGB)."""
        ...


class CameraIDMAgent(_IDMAgent):
    """Follows its lane by the IDM, with detections in the front camera's images.

    It uses images, its own state and the route, but never the observation's road users.
    """

    name = "camera-idm"
    needs = SensorRequirements(cameras=("front",))

    def __init__(self, detector: ObjectDetector) -> None:
        super().__init__()
        self._detector = detector
        self._tracker, self._time_s = LeadTracker(), None

    def reset(self, seed: int, rig: Rig) -> None:
        super().reset(seed, rig)
        self._tracker = LeadTracker()
        self._time_s: float | None = None

    def plan(self, observation: Observation) -> Trajectory:
        """Return a plan along the route behind the tracked lead.

        The notes hold the detector's name, its road users (`detections`), and the `lead`: filtered gap and speed, and
        the measured gap, None if the lead was missed.
        """
        if len(observation.views) != 1:
            raise ValueError(f"camera-idm sees by one front camera; it was shown {len(observation.views)} pictures")
        (view,) = observation.views.values()
        state, time_s = observation.state, observation.time_s
        path = LanePath.of(state, observation.route)
        found = [each for each in self._detector.detect(view.image) if each.confidence >= _MIN_CONFIDENCE]
        in_lane = sightings(found, view.camera, observation.height_m, path, self._vehicle)
        since_s = 0.0 if self._time_s is None else time_s - self._time_s
        lead = self._tracker.look(in_lane, path.along_m + self._vehicle.front_m, state.speed_m_s, since_s)
        self._time_s = time_s
        notes = {
            "detector": self._detector.name,
            "detections": [_detection_note(each) for each in found if road_user_class(each) is not None],
            "lead": lead and _lead_note(lead),
        }
        return Trajectory(self._points(path, lead and lead.lead), notes)


def _detection_note(detection: Detection) -> dict[str, Any]:
    return {
        "class": detection.class_name,
        "confidence": round(detection.confidence, 3),
        "box_xyxy": [round(side, 1) for side in detection.box_xyxy],
    }


def _lead_note(watched: LeadState) -> dict[str, Any]:
    sighting = watched.sighting
    return {
        "class": watched.track.class_name,
        "gap_m": round(watched.lead.gap_m, 3),
        "speed_m_s": round(watched.lead.speed_m_s, 3),
        "measured_gap_m": None if sighting is None else round(sighting.gap_m, 3),
        "box_xyxy": None if sighting is None else [round(side, 1) for side in sighting.detection.box_xyxy],
        "unseen_s": round(watched.track.unseen_s, 3),
    }
