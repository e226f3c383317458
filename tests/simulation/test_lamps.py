"""Lamps of vehicles in drives: they follow the ego vehicle, road users, and both in playback, and light its cameras."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.backends import open_renderer
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.simulation.agents.base import SensorRequirements
from gsrain_engine.simulation.playback import RolloutPlayback
from gsrain_engine.simulation.sensors import RigRenderer, camera_of_width
from gsrain_engine.simulation.simulation import Simulation
from gsrain_engine.simulation.vehicle import Control
from simulation.small_drive import driven, in_other_units, lead, scenario, scene_with_box

AWAY = lead(ahead_m=20.0, left_m=2.0, speed_m_s=6.0, behaviour={"kind": "constant-velocity"})
"""A copy of the scene's actor that drives away from the ego vehicle, faster than that."""

OWN = (
    Lamp(name="ego", position=(3.0, 0.5, -0.8), direction=(1.0, 0.0, 0.0), mount="ego"),
    Lamp(name="rear", position=(-2.0, 0.7, 0.8), direction=(-1.0, 0.0, 0.0), mount="box"),
)


def lit_places(scene, choice=None) -> dict[str, np.ndarray]:
    lamps = RainSimulation.start(RainSettings(lamps=choice)).lamps.of(scene)
    placed = {lamp.name: scene.lamps_at(7.0, [lamp]).positions_m for lamp in lamps}
    return {name: position[0] for name, position in placed.items() if len(position)}


@pytest.mark.parametrize("other_units", [False, True])
def test_headlights_follow_the_ego_vehicle_and_road_users(other_units) -> None:
    scene = in_other_units(scene_with_box()) if other_units else scene_with_box()
    simulation = Simulation(scenario(road_users=[AWAY], turned_deg=10.0, leave_m=50.0), scene)
    simulation.reset()
    for _ in range(3):
        before = simulation.observation()
        places = lit_places(simulation.scene_now, "headlights")
        state, (user,) = before.state, before.road_users
        ahead = np.array([np.cos(state.yaw_rad), np.sin(state.yaw_rad)])
        ego = (places["ego left headlight"] + places["ego right headlight"]) / 2
        np.testing.assert_allclose(ego[:2], [state.x_m, state.y_m] + 3.6 * ahead, atol=1e-6)
        assert ego[2] == pytest.approx(0.675, abs=0.05)
        rear = (places["lead left tail light"] + places["lead right tail light"]) / 2
        ahead = np.array([np.cos(user.yaw_rad), np.sin(user.yaw_rad)])
        np.testing.assert_allclose(rear[:2], [user.x_m, user.y_m] - 2.0 * ahead, atol=1e-6)
        simulation.advance(Control(0.0, 0.1))
    after = simulation.observation()
    assert after.state.x_m - state.x_m > 0.5 and after.road_users[0].x_m - user.x_m > 1


def test_a_copy_of_an_actor_has_its_lamps_also_in_playback() -> None:
    scene = replace(scene_with_box(), lamps=OWN)
    rollout = driven({"road_users": [AWAY], "duration_s": 1.0}, scene)
    played = RolloutPlayback(rollout, scene)
    seen = [lit_places(played.scene(step.time_s)) for step in rollout.steps]
    for step, places in zip(rollout.steps, seen, strict=True):
        (user,) = step.road_users
        np.testing.assert_allclose(places["rear"], [user.x_m - 2.0, user.y_m + 0.7, user.z_m + 0.8], atol=1e-6)
        np.testing.assert_allclose(places["ego"][:2], [step.ego.x_m + 3.0, step.ego.y_m + 0.5], atol=1e-6)
    assert seen[-1]["rear"][0] - seen[0]["rear"][0] > 3


def test_cameras_of_a_drive_show_light_of_headlights() -> None:
    simulation = Simulation(scenario(road_users=[AWAY], leave_m=50.0), scene_with_box())
    simulation.reset()
    cameras = tuple(camera_of_width(each, 64) for each in simulation.rig.cameras)[:1]
    images = []
    with open_renderer("cpu") as renderer:
        for choice in ("none", "headlights"):
            rain = msgspec.structs.replace(RainSettings(visibility_m=60.0, drop_color=(0.05, 0.05, 0.05)), lamps=choice)
            pictures = RigRenderer(renderer, rain, cameras, SensorRequirements(("front",)))
            (view,) = simulation.render_cameras(pictures).values()
            images.append(view.image.astype(int))
    brighter = images[1] - images[0]
    assert brighter.min() >= -1 and brighter.mean() > 4
