"""Whom the oracle takes for its lead."""

import numpy as np
import pytest

from gsrain_engine.simulation.agents.base import Agent, LanePath
from gsrain_engine.simulation.agents.idm import OracleIDMAgent, find_oracle_lead
from gsrain_engine.simulation.agents.neuroncap import NeuroNCAPBaselineAgent
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.traffic.base import RoadUser

from .seen_road import RIG, ROUTE, VEHICLE, car, observation, state


def _lead(*users, of=None, route=ROUTE):
    return find_oracle_lead(users, LanePath.of(of or state(), route), VEHICLE)


def test_the_nearest_in_the_lane_leads_by_its_bumper():
    of = state(20.0)
    found = _lead(car("far", 40.0, of, speed_m_s=5.0), car("near", 12.0, of), car("beside", 5.0, of, 3.5), of=of)
    assert found.id == "near"
    assert found.lead.gap_m == pytest.approx(12.0)
    assert found.lead.speed_m_s == 0.0


def test_nobody_behind_or_beside_leads():
    assert (
        _lead(car("behind", -12.0, state()), car("left", 8.0, state(), 3.0), car("right", 8.0, state(), -2.3)) is None
    )


def test_a_car_that_stands_half_in_the_lane_leads():
    assert _lead(car("half", 8.0, state(), -1.9)).id == "half"


def test_one_that_comes_over_leads_before_it_is_there():
    turned = -np.arctan2(1.2, 8.0)  # 1.2 m/s to the right: 1.8 m within the foresight
    over = car("cut-in", 10.0, state(), 3.3, float(turned), 8.09)
    assert _lead(over).lead.speed_m_s == pytest.approx(8.0, abs=0.01)
    assert _lead(car("straight", 10.0, state(), 3.3, 0.0, 8.09)) is None
    assert _lead(car("leaving", 10.0, state(), 3.3, float(-turned), 8.09)) is None


def test_on_a_bend_the_next_lanes_traffic_stays_in_its_lane():
    angles = np.linspace(0, np.pi / 2, 200)
    bend = Route(np.stack([60 * np.sin(angles), 60 - 60 * np.cos(angles)], axis=1))
    of, lane = state(0.0), 3.2
    angle = 25.0 / 60
    radius = 60 - lane
    users = [
        RoadUser(name, "car", (4.5, 1.8, 1.4), r * np.sin(angle), 60 - r * np.cos(angle), angle, 15.0)
        for name, r in (("next lane", radius), ("own lane", 60.0))
    ]
    assert _lead(users[0], of=of, route=bend) is None
    assert _lead(users[1], of=of, route=bend).lead.gap_m == pytest.approx(25 - 2.25 - 3.6, abs=0.3)


def test_oncoming_traffic_in_the_lane_comes_nearer_by_itself():
    found = _lead(car("wrong way", 30.0, state(), 0.0, np.pi, 6.0))
    assert found.lead.speed_m_s == pytest.approx(-6.0)


def test_the_agent_brakes_for_its_lead_says_so_and_holds_its_speed_without():
    agent = OracleIDMAgent()
    assert isinstance(agent, Agent)
    agent.reset(0, RIG)
    free = agent.plan(observation(state()))
    assert free.points[:, 0] == pytest.approx(np.arange(1, 7) * 5.0)
    assert free.notes == {"lead": None}
    behind = agent.plan(observation(state(), users=(car("lead", 20.0, state()),)))
    assert behind.points[-1, 0] < 20
    assert behind.notes["lead"] == {"id": "lead", "gap_m": pytest.approx(20.0), "speed_m_s": 0.0}


def test_neuroncaps_baseline_stops_for_whose_middle_is_in_its_corridor_and_keeps_the_corridor():
    agent = NeuroNCAPBaselineAgent()
    assert isinstance(agent, Agent)
    agent.reset(0, RIG)
    at = lambda x, y: RoadUser("it", "car", (4.5, 1.8, 1.4), x, y, 0.0)  # noqa: E731
    for place in ((22.1, 0.0), (1.9, 0.0), (10.0, 2.6)):
        assert agent.plan(observation(state(), users=(at(*place),))).points[0, 0] == pytest.approx(5.0)
    stop = agent.plan(observation(state(), users=(at(21.9, -2.4),)))
    assert (stop.points == 0).all() and stop.points.shape == (6, 2)
    assert stop.notes == {"in_corridor": ["it"]}
    slower = agent.plan(observation(state(speed_m_s=2.0), users=(at(21.9, 0.0),)))
    assert (slower.points == 0).all()
    agent.reset(0, RIG)
    assert agent.plan(observation(state(speed_m_s=2.0), users=(at(21.9, 0.0),))).points[0, 0] == pytest.approx(1.0)
