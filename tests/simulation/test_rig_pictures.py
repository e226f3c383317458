"""Motion of the rig's cameras: vehicle speed, yaw rate and scene time affect their images."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.simulation import sensors
from gsrain_engine.simulation.agents.base import SensorRequirements
from gsrain_engine.simulation.sensors import RigRenderer
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control
from simulation.small_drive import scenario
from small_scene import small_scene

AHEAD_M, LEFT_M = 1.7, 0.4


def scene():
    """The small scene; its camera is mounted ahead of the rear axle, and to the left."""
    found = small_scene()
    (front,) = found.rigs["one"]
    mount = front.camera_to_ego.copy()
    mount[:2, 3] = AHEAD_M, LEFT_M
    return replace(found, rigs={"one": (replace(front, camera_to_ego=mount),)})


@pytest.fixture
def shots(monkeypatch):
    """Images drawn from now on."""
    found, draw = [], sensors.draw_view

    def watched(renderer, scene, rainfall, sky, shot, **options):
        found.append(shot)
        draw(renderer, scene, rainfall, sky, shot, **options)

    monkeypatch.setattr(sensors, "draw_view", watched)
    return found


def test_a_camera_ahead_of_the_axle_swings_out_in_a_turn(shots):
    simulation = Simulation(scenario(turned_deg=90.0), scene())
    with open_renderer("cpu") as renderer:
        pictures = RigRenderer(renderer, RainSettings(), simulation.rig.cameras, SensorRequirements(cameras=("front",)))
        velocity = np.array([0.0, 4.0, 0.0])
        pictures.views(simulation.scene_now, simulation.rig_to_world, velocity, 0.5, 1.0)
    # Forward is the world's y: what lies ahead of the axle moves to the left, to the world's -x, by 0.5 rad/s.
    np.testing.assert_allclose(shots[0].velocity_m_s, [-0.5 * AHEAD_M, 4.0 - 0.5 * LEFT_M, 0.0], atol=1e-9)


def test_a_drive_hands_on_how_fast_it_goes_where_and_when(shots):
    simulation = Simulation(scenario(turned_deg=30.0, start_s=1.5, speed_m_s=4.0, leave_m=50.0), scene())
    simulation.reset()
    simulation.advance(Control(0.0, 0.3))
    with open_renderer("cpu") as renderer:
        simulation.render_cameras(
            RigRenderer(renderer, RainSettings(), simulation.rig.cameras, SensorRequirements(cameras=("front",)))
        )
    ego = simulation.rollout("nobody").steps[-1].ego
    assert ego.yaw_rate_rad_s > 0.05 and ego.yaw_rad > np.radians(30.0)
    heading = np.array([np.cos(ego.yaw_rad), np.sin(ego.yaw_rad), 0.0])
    arm = shots[0].camera.position - simulation.rig_to_world[:3, 3]
    swing = ego.yaw_rate_rad_s * np.array([-arm[1], arm[0], 0.0])
    np.testing.assert_allclose(shots[0].velocity_m_s, ego.speed_m_s * heading + swing, atol=1e-9)
    assert shots[0].time_s == pytest.approx(1.5 + 0.25)
