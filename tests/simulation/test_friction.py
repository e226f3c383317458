"""Friction on wet roads: published coefficients, hydroplaning, braking distances and bends of simulated vehicles."""

import numpy as np
import pytest
import scipy

from gsrain_engine.rain.wetness import water_depth_mm
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.agents.base import NOTHING
from gsrain_engine.simulation.friction import FLOATING, friction_coefficient, hydroplaning_speed_m_s
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control, Vehicle, VehicleState, grip_share, step_bicycle
from gsrain_engine.water.spray import displaced_mm
from simulation.small_drive import lead, scenario, track

CAR = Vehicle()
KM_H = 1 / 3.6
BOSCH = {  # depth of the water in mm: speed in km/h: coefficients of worn and new tires
    0.2: {50: (0.5, 0.65), 90: (0.2, 0.6), 130: (0.2, 0.55)},
    1.0: {50: (0.4, 0.55), 90: (0.1, 0.3), 130: (0.1, 0.2)},
    2.0: {50: (0.25, 0.5), 90: (0.05, 0.05), 130: (0.0, 0.0)},
}


@pytest.mark.parametrize(("film_mm", "km_h"), [(film, speed) for film, row in BOSCH.items() for speed in row])
def test_coefficients_lie_between_those_of_worn_and_new_tires(film_mm, km_h):
    worn, new = BOSCH[film_mm][km_h]
    assert worn - 0.051 <= friction_coefficient(km_h * KM_H, film_mm) <= new + 0.051


def test_dry_coefficients_are_those_of_new_tires_and_water_and_speed_only_lower_them():
    assert [round(friction_coefficient(v * KM_H, 0.0), 3) for v in (50, 90, 130)] == [0.85, 0.80, 0.75]
    table = np.array(
        [[friction_coefficient(v, h) for v in (5, 15, 25, 35, 60)] for h in (0, 0.01, 0.1, 0.5, 2.3, 2.5, 8)]
    )
    assert (np.diff(table, axis=0) <= 0).all() and (np.diff(table, axis=1) <= 0).all() and table.min() == FLOATING


def test_tires_float_in_deep_water_as_on_runways_and_later_with_more_pressure():
    """Horne and Dreher: 6.36 sqrt(p) km/h on a flooded surface, as for the 165 kPa of the equation's own tires."""
    horne = 6.36 * np.sqrt(165) * KM_H
    assert hydroplaning_speed_m_s(8.0, 165) == pytest.approx(horne, rel=0.2)
    assert hydroplaning_speed_m_s(8.0, 660) == pytest.approx(2 * hydroplaning_speed_m_s(8.0, 165))
    assert hydroplaning_speed_m_s(2.399) == pytest.approx(hydroplaning_speed_m_s(2.4), rel=0.1)
    assert hydroplaning_speed_m_s(0.0) == np.inf


@pytest.mark.parametrize(
    ("film_mm", "mph"), [(0.254, 85.84), (1.0, 60.19), (2.39, 48.03), (2.54, 47.77), (8.0, 45.31), (25.4, 43.00)]
)
def test_tires_of_the_equation_float_at_its_speeds(film_mm, mph):
    """Gallaway's equation by hand, in inches and mph, at the 165 kPa of its tires."""
    assert hydroplaning_speed_m_s(film_mm, 165) / KM_H / 1.609344 == pytest.approx(mph, rel=1e-3)


ROAD = Scene("road", ego=track([0.0, 50.0], [(0, 0, 1.5), (1500, 0, 1.5)]), ground_m=0.0)


def run(control, **fields):
    """Drive a free road at a constant control until standstill or the end; returns distance and simulation."""
    simulation = Simulation(scenario(step_s=0.05, duration_s=60.0, leave_m=1000.0, **fields), ROAD, NOTHING)
    simulation.reset()
    while simulation.end is None and simulation.observation().state.speed_m_s > 0:
        simulation.advance(control)
    return float(simulation.rig_to_world[0, 3]), simulation


def braking_m(speed_m_s, intensity_mm_h, friction):
    braking = Control(-8.0, 0.0)
    return run(braking, speed_m_s=speed_m_s, rain={"intensity_mm_h": intensity_mm_h}, friction=friction)[0]


def test_braking_distances_are_the_integral_of_speed_over_friction_and_plausible():
    """Dry 0.82 g, within the 0.7 to 0.9 g of tests; wet at least AASHTO's 3.4 m/s2 up to 100 km/h in steady rain."""
    v = 100 * KM_H
    dry = braking_m(v, 8.5, "dry")
    assert dry == pytest.approx(v**2 / 16, rel=1e-3) and 0.7 < v**2 / (2 * dry * 9.81) < 0.9
    assert braking_m(v, 0.0, "wet") == pytest.approx(v**2 / (2 * 9.81 * 0.8), rel=0.06)  # 0.79 to 0.91 at all speeds
    speeds = np.linspace(0, v, 4001)
    found = []
    for rate in (2.5, 8.5, 25.0, 50.0):
        film = displaced_mm(water_depth_mm(rate))
        limit = np.array([min(8.0, 9.81 * friction_coefficient(each, film)) for each in speeds])
        found.append(braking_m(v, rate, "wet"))
        assert found[-1] == pytest.approx(scipy.integrate.trapezoid(speeds / limit, speeds), rel=0.02)
    assert dry < found[0] < found[1] < found[2] < found[3]
    assert v**2 / (2 * found[1]) > 3.4 and 1.2 < found[1] / dry < 2.0


def test_a_wet_bend_is_left_and_a_dry_one_is_not():
    """At 20 m/s a circle of 60 m needs 6.7 m/s2: more than a wet road transmits, less than a dry one."""
    steer = float(np.arctan(CAR.wheelbase_m / 60))
    state = VehicleState(0.0, 0.0, 0.0, 20.0, steer)
    grip = 9.81 * friction_coefficient(20.0, 0.455)
    for limit, across in ((grip, grip), (8.0, 400 / 60)):
        share = grip_share(CAR, state, 0.0, limit)
        turned = step_bicycle(CAR, state, Control(0.0, 0.0), 0.1, share).yaw_rad
        assert turned / 0.1 * 20.0 == pytest.approx(across, rel=1e-6)
    share = grip_share(CAR, state, -6.0, grip)  # braking in the bend: both parts together fill the circle
    assert share * np.hypot(6.0, 400 / 60) == pytest.approx(grip)


def test_road_users_brake_no_harder_than_the_road_allows_and_planners_are_not_asked():
    """A lead that brakes from 25 m/s in 50 mm/h takes longer to stop than on a dry road."""
    user = lead(
        ahead_m=60.0,
        speed_m_s=25.0,
        model="saloon",
        behaviour={"kind": "brake", "after_s": 0.0, "deceleration_m_s2": 8.0},
    )
    gone = {}
    for friction in ("dry", "wet"):
        fields = {"rain": {"intensity_mm_h": 50.0}, "friction": friction, "road_users": [user], "speed_m_s": 1.0}
        simulation = Simulation(scenario(step_s=0.05, duration_s=20.0, **fields), ROAD, NOTHING)
        simulation.reset()
        first = simulation.observation().road_users[0].x_m
        while simulation.end is None:
            simulation.advance(Control(0.0, 0.0))
        gone[friction] = simulation.observation().road_users[0].x_m - first
    assert gone["dry"] == pytest.approx(25**2 / 16, rel=0.01) and gone["wet"] > 1.5 * gone["dry"]
