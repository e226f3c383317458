"""OpenDRIVE export: lanes along the recorded route, for tools that need a map."""

import datetime
from xml.etree import ElementTree

import numpy as np
import shapely
from jaxtyping import Float64, Int64
from scenariogeneration import xodr

from ...scene.scene import Scene
from ..route import recorded_route
from ..scenario import Scenario
from .openscenario_read import LANE_M

_DATE = datetime.datetime(2000, 1, 1)
_BEFORE_M, _BEHIND_M = 60.0, 200.0  # straight extension of the road before and after the recorded drive
_STEP_M = 5.0
_TOLERANCE_M = 0.01


def road_xml(scenario: Scenario, scene: Scene) -> str:
    """Return a road of four lanes as text: the recorded route is the center of lane -2, with right-hand traffic.

    The route becomes parametric cubics (Hermite) within centimeters of it, with continuous tangents; long ones where it
    is straight. Height is omitted.
    """
    route = recorded_route(scene)
    alongs = np.arange(-_BEFORE_M, route.length_m + _BEHIND_M + _STEP_M / 2, _STEP_M)
    points = np.array([route.at(float(each))[:2] for each in alongs])
    lanes = xodr.Lanes()
    middle = xodr.Lane(lane_type=xodr.LaneType.none)
    section = xodr.LaneSection(0, middle)
    for _ in range(3):
        section.add_right_lane(xodr.Lane(a=LANE_M))
    section.add_left_lane(xodr.Lane(a=LANE_M))
    lanes.add_lanesection(section)
    lanes.add_laneoffset(xodr.LaneOffset(0, 1.5 * LANE_M))
    road = xodr.Road(0, _plan(points), lanes, name=scenario.name)
    drive = xodr.OpenDrive(scenario.name)
    drive.add_road(road)
    root = drive.get_element()
    header = root.find("header")
    assert header is not None
    header.set("date", str(_DATE))
    ElementTree.indent(root, "    ")
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n"


def _plan(points: Float64[np.ndarray, "n 2"]) -> xodr.PlanView:
    """Return the reference line: a cubic between each pair of points."""
    kept = _simplified_points(points)
    slopes, plan = np.gradient(points, _STEP_M, axis=0)[kept], xodr.PlanView()
    for start, end, leave, arrive in zip(points[kept], points[kept[1:]], slopes, slopes[1:], strict=False):
        chord = float(np.linalg.norm(end - start))
        heading = float(np.arctan2(leave[1], leave[0]))
        turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        reach, first, last = turn @ (end - start), chord * turn @ leave, chord * turn @ arrive
        second, third = 3 * reach - 2 * first - last, first + last - 2 * reach
        u, v = ((0.0, float(first[k]), float(second[k]), float(third[k])) for k in range(2))
        plan.add_fixed_geometry(xodr.ParamPoly3(*u, *v), float(start[0]), float(start[1]), heading)
    return plan


def _simplified_points(points: Float64[np.ndarray, "n 2"]) -> Int64[np.ndarray, " m"]:
    """Return the indices of points that define the shape: all in bends, few where it is straight."""
    line = np.asarray(shapely.LineString(points).simplify(_TOLERANCE_M).coords)
    return np.array([int(np.argmin(np.linalg.norm(points - each, axis=1))) for each in line])
