"""Detections of a camera agent as boxes in the image."""

import msgspec
import pytest

from gsrain_engine.editor.drive import RolloutInScene
from gsrain_engine.editor.overlays_drive import detection_boxes
from gsrain_engine.simulation.sensors import camera_of_width, placed_camera

from .driven import driven

NOTES = {
    "detections": [
        {"box_xyxy": [100.0, 80.0, 200.0, 160.0], "class": "car", "confidence": 0.9},
        {"box_xyxy": [10.0, 10.0, 20.0, 20.0], "class": "bus", "confidence": 0.1},
        {"box_xyxy": [300.0, 80.0, 330.0, 100.0], "class": "car", "confidence": 0.4},
    ],
    "lead": {"box_xyxy": [100.0, 80.0, 200.0, 160.0], "gap_m": 12.34, "speed_m_s": 1.0},
    "detector": "any",
}


@pytest.fixture
def shown():
    scene, rollout = driven()
    return RolloutInScene(rollout, scene)


def noted(shown, notes):
    return msgspec.structs.replace(shown.played.rollout.steps[0], notes=notes)


def test_detections_lie_where_the_agent_has_seen_them(shown):
    front = shown.front_camera
    twice = placed_camera(camera_of_width(front, 2 * front.width), shown.played.rig_to_world(0.0))
    lead, other = detection_boxes(noted(shown, NOTES), front, twice)
    assert lead.low_px == pytest.approx((200.0, 160.0), abs=1.0)
    assert lead.high_px == pytest.approx((400.0, 320.0), abs=1.0)
    assert (lead.is_lead, lead.words) == (True, "car 0.90, 12.3 m")
    assert (other.is_lead, other.words) == (False, "car 0.40")
