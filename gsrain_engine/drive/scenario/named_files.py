"""Files that a scenario names: in its own file, names count from that file's folder."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

from gsrain_engine.rain.calibration import calibration_names
from gsrain_engine.scene.open_scene import STREET
from gsrain_engine.shipped_configs import standing_beside

from ..traffic.built_in_vehicles import vehicle_names
from ..traffic.models import ACTOR
from ..traffic.replay import Replay
from .scenario import Scenario, ScenarioUser

_Rename = Callable[[str], str]


def named_from_here(scenario: Scenario, folder: Path) -> Scenario:
    """Return a scenario whose file is in a folder with its names as they count from the working folder.

    A name counts from the scenario's folder; where nothing stands there it stays what it is.
    """
    return _renamed(scenario, partial(standing_beside, folder))


def named_from_folder(scenario: Scenario, folder: Path) -> Scenario:
    """Return a scenario as it stands in a file of a folder: names that count from the working folder count from it."""

    def there(name: str) -> str:
        return os.path.relpath(name, folder) if not Path(name).is_absolute() and Path(name).exists() else name

    return _renamed(scenario, there)


def _renamed(scenario: Scenario, rename: _Rename) -> Scenario:
    rain, scene = scenario.rain, scenario.scene
    if rain.calibration not in calibration_names():
        rain = msgspec.structs.replace(rain, calibration=rename(rain.calibration))
    return msgspec.structs.replace(
        scenario,
        scene=scene if scene == STREET else rename(scene),
        rain=rain,
        road_users=tuple(_renamed_user(user, rename) for user in scenario.road_users),
    )


def _renamed_user(user: ScenarioUser, rename: _Rename) -> ScenarioUser:
    model, behaviour = user.model, user.behaviour
    if model.split("/")[0] not in vehicle_names() and not model.startswith(ACTOR):
        model = rename(model)
    if isinstance(behaviour, Replay):
        behaviour = msgspec.structs.replace(behaviour, rollout=rename(behaviour.rollout))
    return msgspec.structs.replace(user, model=model, behaviour=behaviour)
