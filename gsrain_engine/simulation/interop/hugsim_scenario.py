"""Import of HUGSIM's scenario files (YAML)."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ...safe_io.errors import convert_checked
from ..geometry import wrap_degrees
from ..scenario import Scenario, ScenarioUser
from ..vehicle import HUGSIM_VEHICLE

_MAX_STEPS, _STEP_S = 400, 0.25  # HUGSIM's maximum number of steps and step size

_IDM = {
    "desired_speed_m_s": 30.0, "least_gap_m": 5.0, "headway_s": 2.0, "acceleration_m_s2": 2.0,
    "comfortable_braking_m_s2": 4.0, "exponent": 4.0,
}  # fmt: skip


class _Row(msgspec.Struct, frozen=True, array_like=True):
    """A background vehicle. World: axes of the first front camera (x right, y down, z forward), meters, radians."""

    right_m: float
    forward_m: float
    height_m: float
    yaw_rad: float
    """Motion is (-sin, cos) of it in (right, forward): left positive, contrary to HUGSIM's comment."""
    speed_m_s: float
    model: str
    planner: str
    parameters: dict[str, Any]


class _HugsimScenario(msgspec.Struct, frozen=True, kw_only=True):
    mode: str
    plan_list: list[_Row]
    scene_name: str
    start_euler: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Degrees about the axes above, the second one to the right."""
    start_ab: tuple[float, float] = (0.0, 0.0)
    """Position right and forward of the first front camera, meters."""
    start_velo: float = 0.0
    start_steer: float = 0.0


def is_hugsim_scenario(values: object) -> bool:
    """Return whether the values of a YAML file are a HUGSIM scenario."""
    return isinstance(values, dict) and {"plan_list", "scene_name"} <= {str(key) for key in values}


def hugsim_scenario(values: object, path: Path) -> Scenario:
    """Convert HUGSIM's plain values to a scenario; `path` is their file.

    The ego vehicle is a box around the front camera (`HUGSIM_VEHICLE`), which preserves distances. `scene_name` becomes
    the scene, to be replaced by the converted scene file. 3DRealCar models can't be read; saloons replace them.
    ConstantPlanner goes straight on; UnicyclePlanner follows the track of the scene's actor of that id at that pace;
    IDM follows the route with HUGSIM's parameters (HUGSIM's own stands still without an HD map).

    Raises ValueError, naming the file and the value, for AttackPlanner, which is random without a seed, and for
    anything else unsupported.
    """
    try:
        return _scenario(convert_checked(values, _HugsimScenario), path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _scenario(found: _HugsimScenario, name: str) -> Scenario:
    pitch, right, roll = found.start_euler
    if abs(pitch) > 1 or abs(roll) > 1:
        raise ValueError(f"start_euler {list(found.start_euler)}: only a turn about the second axis can be taken")
    if found.start_steer != 0:
        raise ValueError(f"start_steer {found.start_steer:g}: drives begin with the wheels straight, at 0")
    users: list[ScenarioUser] = []
    for number, row in enumerate(found.plan_list, start=1):
        try:
            users.append(convert_checked(_user(number, row, found), ScenarioUser))
        except ValueError as error:
            raise ValueError(f"vehicle {number} of plan_list: {error}") from None
    plain = {
        "name": f"{found.scene_name}-{found.mode}",
        "description": f"HUGSIM's scenario {name}.",
        "scene": found.scene_name,
        "ahead_m": found.start_ab[1],
        "left_m": -found.start_ab[0],
        "turned_deg": -right,
        "speed_m_s": found.start_velo,
        "road_users": [msgspec.to_builtins(user) for user in users],
        "vehicle": msgspec.to_builtins(HUGSIM_VEHICLE),
        "step_s": _STEP_S,
        "duration_s": _MAX_STEPS * _STEP_S,
    }
    return convert_checked(plain, Scenario)


def _user(number: int, row: _Row, found: _HugsimScenario) -> dict[str, Any]:
    turned = np.radians(found.start_euler[1])
    right, forward = row.right_m - found.start_ab[0], row.forward_m - found.start_ab[1]
    return {
        "id": f"vehicle-{number}",
        "placed": "straight",
        "ahead_m": float(right * np.sin(turned) + forward * np.cos(turned)),
        "left_m": float(-right * np.cos(turned) + forward * np.sin(turned)),
        "turned_deg": wrap_degrees(float(np.degrees(row.yaw_rad + turned))),
        "speed_m_s": row.speed_m_s,
        "behaviour": _behavior(row),
    }


def _behavior(row: _Row) -> dict[str, Any]:
    if row.planner == "ConstantPlanner":
        return {"kind": "constant-velocity"}
    if row.planner == "UnicyclePlanner":
        return {"kind": "track", "actor": row.parameters.get("uc_id"), "pace": row.parameters.get("speed", 1.0)}
    if row.planner == "IDM":
        return {"kind": "idm", **_IDM}
    if row.planner == "AttackPlanner":
        raise ValueError(
            "AttackPlanner chooses among its best paths at random, without a seed: no two of its runs are alike; write "
            "what it should do as a cut-in or brake behaviour"
        )
    known = "ConstantPlanner, UnicyclePlanner, IDM and AttackPlanner"
    raise ValueError(f"planner {row.planner!r} is not known, only {known}")
