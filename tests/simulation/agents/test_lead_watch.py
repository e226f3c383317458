"""Tracking of lead vehicles from detections that are noisy, missed, doubled or false."""

import numpy as np
import pytest

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.simulation.agents.lead_tracking import LeadTracker, Sighting

DT = 0.25


def sighting(gap_m, confidence=0.9, error_m=0.5):
    return Sighting(Detection("car", confidence, (0.0, 0.0, 1.0, 1.0)), gap_m, error_m)


def _watched(gaps, own_speed_m_s=10.0, errors=None):
    """Look at gaps, one a moment (None: missed), from a car at constant speed; yields what is believed."""
    watch = LeadTracker()
    for k, gap in enumerate(gaps):
        error = 0.5 if errors is None else errors[k]
        seen = [] if gap is None else [sighting(gap, error_m=error)]
        yield watch.look(seen, k * DT * own_speed_m_s, own_speed_m_s, DT if k else 0.0)


@pytest.mark.parametrize("lead_m_s", [0.0, 6.0, 12.0])
def test_gap_and_speed_come_out_of_noise(lead_m_s):
    rng = np.random.default_rng(5)
    gaps = 40 + (lead_m_s - 10.0) * DT * np.arange(13)
    errors = np.full(13, 1.0)
    last = list(_watched(list(gaps + rng.normal(0, 1.0, 13)), errors=errors))[-1]
    assert last.lead.gap_m == pytest.approx(gaps[-1], abs=1.2)
    assert last.lead.speed_m_s == pytest.approx(lead_m_s, abs=1.5)


def test_the_speed_is_known_sooner_the_smaller_the_error():
    gaps = list(40 - 10.0 * DT * np.arange(6))
    slow, fast = (list(_watched(gaps, errors=[error] * 6))[-1] for error in (4.0, 0.3))
    assert abs(fast.lead.speed_m_s) < 0.5 < slow.lead.speed_m_s


def test_on_first_sight_it_is_taken_for_half_as_fast():
    (first,) = _watched([30.0])
    assert first.lead == (type(first.lead))(30.0, 5.0)


def test_a_lead_that_is_missed_goes_on_for_a_second_and_is_given_up_then():
    gaps = [*(40 - 10.0 * DT * np.arange(8)), *[None] * 5]
    believed = list(_watched(gaps))
    assert [each is not None for each in believed] == [True] * 12 + [False]
    assert believed[11].sighting is None
    assert believed[11].lead.gap_m == pytest.approx(40 - 10.0 * DT * 11, abs=0.5)


def test_one_that_stands_near_and_is_lost_there_is_believed_to_stay():
    believed = list(_watched([2.2, 2.1, 2.0, *[None] * 121], own_speed_m_s=0.0))
    assert [each is not None for each in believed] == [True] * 123 + [False]
    assert believed[4].lead.speed_m_s == 0.0
    assert believed[122].lead.gap_m == believed[4].lead.gap_m


def test_one_that_was_lost_near_while_it_drove_off_is_given_up():
    gaps = [*(2.0 + 3.0 * DT * np.arange(5)), *[None] * 8]
    believed = list(_watched(list(gaps), own_speed_m_s=0.0))
    assert believed[5] is not None
    assert believed[-1] is None


def test_what_is_hardly_seen_keeps_a_known_lead_in_view_and_begins_none():
    watch = LeadTracker()
    assert watch.look([sighting(20.0, 0.15)], 0.0, 0.0, 0.0) is None
    assert watch.look([sighting(20.0, 0.4)], 0.0, 0.0, DT) is None
    assert watch.look([sighting(20.0, 0.15)], 0.0, 0.0, DT) is None
    watch.look([sighting(20.0, 0.9)], 0.0, 0.0, DT)
    for _ in range(8):
        kept = watch.look([sighting(20.0, 0.15)], 0.0, 0.0, DT)
    assert kept.sighting is not None and kept.track.count == 11


def test_the_unsure_must_be_seen_twice_on_end():
    watch = LeadTracker()
    assert watch.look([sighting(30.0, 0.4)], 0.0, 0.0, 0.0) is None
    assert watch.look([], 0.0, 0.0, DT) is None
    assert watch.look([sighting(30.0, 0.4)], 0.0, 0.0, DT) is None
    assert watch.look([sighting(30.0, 0.4)], 0.0, 0.0, DT) is not None


def test_a_jump_is_not_taken_for_motion():
    believed = list(_watched([20.0, 20.0, 20.0, 45.0, 20.0, 20.0], own_speed_m_s=0.0))
    assert all(each.lead.gap_m == pytest.approx(20.0, abs=0.5) for each in believed)
    assert believed[3].sighting is None


def test_who_cuts_in_leads_at_once_and_the_other_is_remembered():
    watch = LeadTracker()
    for k in range(3):
        watch.look([sighting(30.0)], 0.0, 0.0, DT if k else 0.0)
    cut_in = watch.look([sighting(30.0), sighting(12.0)], 0.0, 0.0, DT)
    assert cut_in.lead.gap_m == 12.0
    for _ in range(5):
        left = watch.look([sighting(30.0)], 0.0, 0.0, DT)
    assert left.lead.gap_m == pytest.approx(30.0, abs=0.2)
    assert left.track.count == 9


def test_two_boxes_of_one_thing_are_one():
    watch = LeadTracker()
    for k in range(2):
        watch.look([sighting(20.0, 0.9), sighting(18.0, 0.35)], 0.0, 0.0, DT if k else 0.0)
    believed = watch.look([sighting(20.0)], 0.0, 0.0, DT)
    assert believed.lead.gap_m == pytest.approx(20.0, abs=0.1)
