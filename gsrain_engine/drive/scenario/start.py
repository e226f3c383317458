"""Where everybody is when a scenario begins. World frame, metres."""

import numpy as np

from gsrain_engine.scene.scene import Scene

from ..road.route import Route
from ..vehicle.state import VehicleState
from .scenario import Scenario, ScenarioUser


def start_along_m(scenario: Scenario, scene: Scene, route: Route) -> float:
    """Return how far along the route the ego vehicle starts.

    Raises ValueError where the scene has no ego vehicle at that time, or its drive is over by then.
    """
    last_s = scene.ego.times[-1] if scene.ego is not None and len(scene.ego.times) else np.inf
    if not scenario.start_s <= last_s:
        raise ValueError(f"scenario {scenario.name}: at {scenario.start_s:g} s the drive of scene {scene.name!r} is "
                         f"over; it ends at {last_s:g} s")  # fmt: skip
    pose = scene.ego_to_world(scenario.start_s)
    if pose is None:
        raise ValueError(f"scene {scene.name!r} has no ego vehicle at {scenario.start_s:g} s")
    return route.nearest(float(pose[0, 3]), float(pose[1, 3])).along_m + scenario.ahead_m


def start_state(scenario: Scenario, scene: Scene, route: Route) -> VehicleState:
    """Return the ego vehicle as it starts; raises ValueError as `start_along_m` does."""
    x, y, heading = route.at(start_along_m(scenario, scene, route), scenario.left_m)
    return VehicleState(x, y, heading + float(np.radians(scenario.turned_deg)), scenario.speed_m_s)


def start_place(user: ScenarioUser, scenario: Scenario, scene: Scene, route: Route) -> tuple[float, float, float]:
    """Return x, y and heading of a road user's middle where the scenario puts it; raises as the others do."""
    ahead = scenario.vehicle.middle_m + user.ahead_m
    if user.placed == "straight":
        ego = start_state(scenario, scene, route)
        x, y = ego.to_world(np.array([[ahead, user.left_m]]))[0]
        heading = ego.yaw_rad
    else:
        x, y, heading = route.at(start_along_m(scenario, scene, route) + ahead, user.left_m)
    return float(x), float(y), heading + float(np.radians(user.turned_deg))
