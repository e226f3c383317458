"""Scenario files: loading (YAML, HUGSIM, OpenSCENARIO XML), saving, and relative file names."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import yaml

from ..presets import load_config, resolve_from_folder, shipped_config_names
from ..rain.calibration import calibration_names
from ..safe_io.errors import convert_checked
from ..safe_io.text_files import read_whole, yaml_values
from ..scene.files import whole_file
from ..scene.open import STREET
from .interop.hugsim_scenario import hugsim_scenario, is_hugsim_scenario
from .interop.openscenario_read import read_openscenario
from .scenario import Scenario, ScenarioUser
from .traffic.appearance import ACTOR, vehicle_names
from .traffic.tracks import Replay

_FOLDER = "scenarios"


def scenario_names() -> list[str]:
    return shipped_config_names(_FOLDER)


def load_scenario(name: str | Path) -> Scenario:
    """Load a shipped scenario by name, or a scenario file by path: GSRAIN's, HUGSIM's, or OpenSCENARIO XML.

    Raises ValueError with the file, the field and what is allowed.
    """
    if str(name) not in scenario_names() and Path(name).is_file():
        return read_scenario(Path(name))
    return load_config(_FOLDER, name, Scenario, "scenario")


def read_scenario(path: Path) -> Scenario:
    """Read a file: `.xosc` is OpenSCENARIO XML, anything else YAML, whose keys identify HUGSIM scenarios.

    File names are resolved against the scenario's folder first, then the working folder. Raises ValueError with the
    file, the field and what is allowed.
    """
    return resolve_file_names(_read(path), path.parent)


def _read(path: Path) -> Scenario:
    if path.suffix.lower() == ".xosc":
        return read_openscenario(path)
    data = read_whole(path)
    try:
        values = yaml_values(data)
        if not is_hugsim_scenario(values):
            return convert_checked(values, Scenario)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return hugsim_scenario(values, path)


# Saving
# Only values that differ from the defaults are written.


def save_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario atomically; `load_scenario` restores the same value.

    File names become relative to the written file's folder. Raises OSError.
    """
    told = _plain_settings(relative_file_names(scenario, path.parent))
    text = yaml.safe_dump(told, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    with whole_file(path) as beside:
        beside.write_text(text, encoding="utf-8")


def _plain_settings(settings: msgspec.Struct) -> dict[str, Any]:
    """Return the fields that differ from their defaults, after the tag of a tagged struct."""
    tag = settings.__struct_config__.tag_field
    told: dict[str, Any] = {} if tag is None else {tag: settings.__struct_config__.tag}
    for field in msgspec.structs.fields(settings):
        value = getattr(settings, field.name)
        if field.default is not msgspec.NODEFAULT and value == field.default:
            continue
        told[field.encode_name] = _plain(value)
    return told


def _plain(value: object) -> Any:
    if isinstance(value, msgspec.Struct):
        return _plain_settings(value)
    if isinstance(value, tuple):
        items: tuple[object, ...] = value
        return [_plain(each) for each in items]
    return msgspec.to_builtins(value)


# Relative file names

_Rename = Callable[[str], str]


def resolve_file_names(scenario: Scenario, folder: Path) -> Scenario:
    """Return a scenario with file names resolved against the folder of its file.

    Names without a file in that folder stay unchanged.
    """
    return _renamed(scenario, partial(resolve_from_folder, folder))


def relative_file_names(scenario: Scenario, folder: Path) -> Scenario:
    """Return a scenario with existing relative file names made relative to `folder`."""

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
