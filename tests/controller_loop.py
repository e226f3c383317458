"""Drives of a controller along a line, without a scene."""

import numpy as np

from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.vehicle import Vehicle, VehicleState, step_bicycle

CAR = Vehicle()
STRAIGHT = Route(np.array([[0.0, 0], [500, 0]]))


def circle(radius_m):
    """Three quarters of a circle to the left that begins at the origin, along x."""
    turn = np.linspace(0, 1.5 * np.pi, 500)
    return Route(radius_m * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=1))


def lane_change(offset_m=3.5, start_m=20.0, length_m=40.0):
    """Straight, over to the left by a quintic, straight."""
    x = np.arange(0, 300, 0.5)
    s = np.clip((x - start_m) / length_m, 0, 1)
    return Route(np.stack([x, offset_m * (10 * s**3 - 15 * s**4 + 6 * s**5)], axis=1))


def driven(controller, route, speed_m_s, state=None, steps=60, vehicle=CAR):
    """Follow a line at a speed; returns the states and the distance from the line after each step."""
    state = state or VehicleState(0.0, 0.0, 0.0, speed_m_s)
    states, left, controls = [], [], []
    for _ in range(steps):
        along = route.nearest(state.x_m, state.y_m).along_m
        plan = state.from_world(np.array([route.at(along + speed_m_s * 0.5 * k)[:2] for k in range(1, 7)]))
        controls.append(controller.control(vehicle, state, plan, 0.5))
        state = step_bicycle(vehicle, state, controls[-1], 0.25)
        states.append(state)
        left.append(route.nearest(state.x_m, state.y_m).left_m)
    return states, np.array(left), np.array(controls)
