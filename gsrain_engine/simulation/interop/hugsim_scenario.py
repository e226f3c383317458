"""Import of HUGSIM's scenario files (YAML)."""

import logging
import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ...safe_io.errors import convert_checked
from ...safe_io.text_files import printable_line, read_whole, yaml_values
from ...scene.formats.hugsim import is_vehicle_folder
from ..geometry import wrap_degrees
from ..scenario import Scenario, ScenarioUser
from ..vehicle import HUGSIM_VEHICLE

log = logging.getLogger(__name__)

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
    the scene, to be replaced by its folder or the converted scene. Vehicles are 3DRealCar's where their folders are
    found (see `vehicle_places`); saloons replace the others, which one line of the log says.
    ConstantPlanner goes straight on; UnicyclePlanner follows the track of the scene's actor of that id at that pace;
    IDM follows the route with HUGSIM's parameters (HUGSIM's own stands still without an HD map).

    Raises ValueError, naming the file and the value, for AttackPlanner, which is random without a seed, and for
    anything else unsupported.
    """
    try:
        return _scenario(convert_checked(values, _HugsimScenario), path)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _scenario(found: _HugsimScenario, path: Path) -> Scenario:
    pitch, right, roll = found.start_euler
    if abs(pitch) > 1 or abs(roll) > 1:
        raise ValueError(f"start_euler {list(found.start_euler)}: only a turn about the second axis can be taken")
    if found.start_steer != 0:
        raise ValueError(f"start_steer {found.start_steer:g}: drives begin with the wheels straight, at 0")
    users, models = list[ScenarioUser](), _models([row.model for row in found.plan_list], path)
    for number, (row, model) in enumerate(zip(found.plan_list, models, strict=True), start=1):
        try:
            users.append(convert_checked(_user(number, row, found) | {"model": model}, ScenarioUser))
        except ValueError as error:
            raise ValueError(f"vehicle {number} of plan_list: {error}") from None
    plain = {
        "name": f"{found.scene_name}-{found.mode}",
        "description": f"HUGSIM's scenario {path.stem}.",
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


# 3DRealCar vehicles

VEHICLES_VARIABLE = "GSRAIN_3DREALCAR"
"""Environment variable with the folder of 3DRealCar's vehicles."""
_REPLACEMENT = "saloon"
_SEARCHED_FOLDERS = 4  # the scenario's own and those above it: HUGSIM has configs/benchmark/DATASET/SCENARIO.yaml


class _BaseConfig(msgspec.Struct, frozen=True):
    """HUGSIM's configs/sim/DATASET_base.yaml."""

    realcar_path: str = ""


def vehicle_places(path: Path) -> list[Path]:
    """Folders to search for the vehicles of a scenario file.

    GSRAIN_3DREALCAR if set; else `realcar_path` of HUGSIM's sim/*_base.yaml, and 3DRealCar, each next to the file or up
    to three folders above it.
    """
    if own := os.environ.get(VEHICLES_VARIABLE):
        return [Path(own).absolute()]
    places: list[Path] = []
    for folder in path.absolute().parents[:_SEARCHED_FOLDERS]:
        for config in sorted((folder / "sim").glob("*_base.yaml")):
            try:
                base = convert_checked(yaml_values(read_whole(config)), _BaseConfig)
            except (OSError, ValueError):
                continue  # of another program
            if base.realcar_path:
                places.append(folder.parent / base.realcar_path)  # HUGSIM runs in the folder above configs
        places.append(folder / "3DRealCar")
    return list(dict.fromkeys(places))


def _models(names: Sequence[str], path: Path) -> list[str]:
    """Model of each vehicle: its folder, or a saloon; says once how many are saloons, and why."""
    places = vehicle_places(path)
    found = [next((each for each in places if is_vehicle_folder(each / name)), None) for name in names]
    searched = ", ".join(str(each) for each in places if each.is_dir()) or "a 3DRealCar folder near it"
    reason = f"are not in {searched}; set {VEHICLES_VARIABLE} to the folder of 3DRealCar"
    if any(found) and find_spec("torch") is None:
        found, reason = [None] * len(names), "can't be read without torch"
    missing = [printable_line(name) for name, place in zip(names, found, strict=True) if place is None]
    if missing:
        count, folders = f"{len(missing)} of {len(names)} vehicles", ", ".join(dict.fromkeys(missing))
        log.warning("%s: saloons replace %s, whose folders (%s) %s", path, count, folders, reason)
    return [_REPLACEMENT if place is None else str(place / name) for name, place in zip(names, found, strict=True)]


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
