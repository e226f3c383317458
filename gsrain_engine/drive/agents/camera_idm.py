"""A driver that sees with one camera: detector, lane, distance from the ground, filter, intelligent driver model."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.evaluate.detection.detector import Detection

from ..vehicle.vehicle import Vehicle
from .agent import Needs, Plan
from .idm_planner import IDMPlanner, cruise_speed
from .lane_path import LanePath
from .leads.lead_watch import LeadWatch, WatchedLead
from .leads.sighting import road_user_class, sightings
from .observation import CameraView, Observation, Rig

_LEAST_CONFIDENCE = 0.1
"""Less confident detections are not looked at. Those from here to `lead_track.LEAST_CONFIDENCE` keep a lead in view
that is known already, as ByteTrack's do (Zhang et al. 2022): rain lowers confidence sooner than it hides a car."""
_DIGITS = 3


@runtime_checkable
class Sees(Protocol):
    """Finds objects in a picture; `evaluate.detection.detector.Detector` does."""

    @property
    def name(self) -> str:
        """What records call it."""
        ...

    def detect(self, image: UInt8[np.ndarray, "h w 3"]) -> list[Detection]:
        """Return what is in a picture (RGB)."""
        ...


class CameraIDMAgent:
    """Follows its lane by the intelligent driver model, with what a detector finds in the front camera's pictures.

    It looks at pictures, its own state and the route; never at the observation's road users.
    """

    name = "camera-idm"
    needs = Needs(cameras=("front",))

    def __init__(self, detector: Sees) -> None:
        self._detector = detector
        self._vehicle = Vehicle()
        self._planner: IDMPlanner | None = None
        self._watch, self._time_s = LeadWatch(), 0.0

    def reset(self, seed: int, rig: Rig) -> None:
        self._vehicle, self._planner = rig.vehicle, None
        self._watch, self._time_s = LeadWatch(), 0.0

    def plan(self, observation: Observation) -> Plan:
        """Return points along the route, behind whoever is seen ahead in the lane.

        The plan's notes hold the detector's name, what it found of road users (`detections`), and the `lead`: its gap
        and speed as filtered, its gap as measured now, None where it was missed.
        """
        state = observation.state
        if self._planner is None:
            cruise = cruise_speed(state.speed_m_s)
            self._planner = IDMPlanner(cruise, hard_m_s2=self._vehicle.most_braking_m_s2)
            self._time_s = observation.time_s
        path = LanePath.of(state, observation.route)
        view = _front(observation)
        found = [each for each in self._detector.detect(view.image) if each.confidence >= _LEAST_CONFIDENCE]
        seen = sightings(found, view.camera, observation.height_m, path, self._vehicle)
        front = path.along_m + self._vehicle.front_m
        watched = self._watch.look(seen, front, state.speed_m_s, observation.time_s - self._time_s)
        self._time_s = observation.time_s
        points = self._planner.points(path, watched and watched.lead)
        return Plan(points, self._notes(found, watched))

    def close(self) -> None:
        """Nothing is held that does not go by itself."""

    def _notes(self, found: list[Detection], watched: WatchedLead | None) -> dict[str, Any]:
        return {
            "detector": self._detector.name,
            "detections": [_detection_note(each) for each in found if road_user_class(each) is not None],
            "lead": None if watched is None else _lead_note(watched),
        }


def _front(observation: Observation) -> CameraView:
    if len(observation.views) != 1:
        raise ValueError(f"camera-idm sees by one front camera; it was shown {len(observation.views)} pictures")
    return next(iter(observation.views.values()))


def _detection_note(detection: Detection) -> dict[str, Any]:
    return {
        "class": detection.class_name,
        "confidence": round(detection.confidence, _DIGITS),
        "box_xyxy": [round(side, 1) for side in detection.box_xyxy],
    }


def _lead_note(watched: WatchedLead) -> dict[str, Any]:
    sighting = watched.sighting
    return {
        "class": watched.track.class_name,
        "gap_m": round(watched.lead.gap_m, _DIGITS),
        "speed_m_s": round(watched.lead.speed_m_s, _DIGITS),
        "measured_gap_m": None if sighting is None else round(sighting.gap_m, _DIGITS),
        "box_xyxy": None if sighting is None else [round(side, 1) for side in sighting.detection.box_xyxy],
        "unseen_s": round(watched.track.unseen_s, _DIGITS),
    }
