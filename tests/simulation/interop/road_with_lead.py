"""A short drive for clients: a road, a wall, a car that stands ahead, and a front and a back camera of nuScenes'."""

from dataclasses import replace

import msgspec
import numpy as np

from gsrain_engine.scene.scene import PoseTrack
from gsrain_engine.scene.street.build import street_rigs
from gsrain_engine.simulation.controller_base import ControllerSettings
from gsrain_engine.simulation.scenario import Scenario, ScenarioUser
from gsrain_engine.simulation.traffic.models import ConstantVelocity
from small_scene import small_scene


def scene():
    """The small scene, with a recorded drive of 30 m."""
    times = np.arange(6.0)
    places = np.stack([6 * times, np.zeros(6), np.full(6, 1.5)], axis=1)
    ego = PoseTrack(times, places, np.tile([1.0, 0, 0, 0], (6, 1)), np.ones(6, bool))
    two = tuple(each for each in street_rigs()["nuscenes"] if each.name in ("CAM_FRONT", "CAM_BACK"))
    return replace(small_scene(), ego=ego, rigs={"nuscenes": two})


def scenario(**fields):
    """8 m/s towards a car that stands 18 m ahead."""
    lead = ScenarioUser(id="lead", ahead_m=18.0, behaviour=ConstantVelocity())
    plain = Scenario(
        name="lead",
        speed_m_s=8.0,
        road_users=(lead,),
        duration_s=2.5,
        controller=ControllerSettings(kind="pure-pursuit"),
    )
    return msgspec.structs.replace(plain, **fields)
