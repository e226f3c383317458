"""Where entities of an OpenSCENARIO file begin, as seen from the ego vehicle."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...angles import wrapped_deg
from ...vehicle.state import VehicleState
from .names import LANE_M
from .xml_file import number


@dataclass(frozen=True, slots=True)
class Beginning:
    """How an entity begins."""

    position: Element
    """The position that it is teleported to."""
    speed_m_s: float


def beginnings(path: Path, root: Element) -> dict[str, Beginning]:
    """Find the entities' first positions and speeds, by name.

    Raises ValueError, with the file and the entity, for a speed that is not absolute.
    """
    found: dict[str, Beginning] = {}
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        name = private.get("entityRef", "")
        position = private.find("PrivateAction/TeleportAction/Position/*")
        if position is None:
            continue
        action = private.find("PrivateAction/LongitudinalAction/SpeedAction")
        speed = None if action is None else action.find("SpeedActionTarget/AbsoluteTargetSpeed")
        if action is not None and speed is None:
            raise ValueError(f"{path}: {name} begins at a speed that is no AbsoluteTargetSpeed")
        found[name] = Beginning(position, 0.0 if speed is None else number(path, speed, "value"))
    return found


def world_state(path: Path, position: Element) -> VehicleState | None:
    """Return the pose of a WorldPosition; None for positions of other kinds, which need a map."""
    if position.tag != "WorldPosition":
        return None
    heading = number(path, position, "h") if "h" in position.attrib else 0.0
    return VehicleState(number(path, position, "x"), number(path, position, "y"), heading)


def placed(path: Path, name: str, beginning: Beginning, ego_name: str, ego: Beginning) -> dict[str, Any]:
    """Return the fields of a `ScenarioUser` for where its point of reference is, from the ego vehicle's.

    Raises ValueError, with the file and the entity, for positions that need a map.
    """
    position = beginning.position
    if position.tag == "WorldPosition":
        from_, there = world_state(path, ego.position), world_state(path, position)
        if from_ is None or there is None:
            raise ValueError(
                f"{path}: {name} has a WorldPosition, {ego_name} a {ego.position.tag}: both must be in the world"
            )
        ahead, left = from_.from_world(np.array([[there.x_m, there.y_m]]))[0]
        return _fields("straight", float(ahead), float(left), there.yaw_rad - from_.yaw_rad)
    if position.get("entityRef") != ego_name or position.tag not in ("RelativeLanePosition", "RelativeObjectPosition"):
        raise ValueError(
            f"{path}: {name} begins at a {position.tag}: without a map only WorldPosition, and RelativeLanePosition "
            f"and RelativeObjectPosition to {ego_name}, have a place"
        )
    turned = position.find("Orientation")
    heading = 0.0
    if turned is not None and turned.get("type", "absolute") == "relative" and "h" in turned.attrib:
        heading = number(path, turned, "h")
    if position.tag == "RelativeObjectPosition":
        return _fields("straight", number(path, position, "dx"), number(path, position, "dy"), heading)
    offset = number(path, position, "offset") if "offset" in position.attrib else 0.0
    left = LANE_M * number(path, position, "dLane") + offset
    return _fields("along-route", number(path, position, "ds"), left, heading)


def _fields(kind: str, ahead_m: float, left_m: float, turned_rad: float) -> dict[str, Any]:
    degrees = wrapped_deg(float(np.degrees(turned_rad)))
    return {"placed": kind, "ahead_m": ahead_m, "left_m": left_m, "turned_deg": round(degrees, 6)}
