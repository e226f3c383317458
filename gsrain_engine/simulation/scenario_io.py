"""Scenario files: loading (YAML, HUGSIM, and formats of installed packages), saving, and relative file names.

A format is an entry point of the group `gsrain.scenario_formats`, those of this program included: its name is the
suffix, its object reads a path.
"""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import yaml

from ..choices import LAMP_WORDS
from ..plugins import SCENARIO_FORMATS, Extension, find_extensions
from ..presets import load_config, resolve_from_folder, shipped_config_names
from ..rain.calibration import calibration_names
from ..safe_io.errors import convert_checked
from ..safe_io.files import whole_file
from ..safe_io.text_files import printable_line, read_whole, yaml_values
from ..scene.built_in import DEFAULT_SCENE
from ..scene.models import model_names
from ..scene.sensor import sensor_names
from .interop.hugsim_scenario import hugsim_scenario, is_hugsim_scenario
from .scenario import Scenario, ScenarioUser
from .traffic.appearance import ACTOR
from .traffic.settings import Replay

_FOLDER = "scenarios"
_YAML = ".yaml", ".yml"


def scenario_names() -> list[str]:
    return shipped_config_names(_FOLDER)


def load_scenario(name: str | Path) -> Scenario:
    """Load a shipped scenario by name, or a scenario file by path: GSRAIN's, HUGSIM's, or one of `scenario_suffixes`.

    A file's own file names are resolved against its folder first, then the working folder. Raises ValueError with the
    file, the field and what is allowed.
    """
    path = Path(name)
    if str(name) not in scenario_names() and path.is_file():
        return _renamed(_read(path), partial(resolve_from_folder, path.parent))
    return load_config(_FOLDER, name, Scenario, "scenario")


def scenario_suffixes() -> tuple[str, ...]:
    """Suffixes of scenario files, those of installed packages last; other files are read as YAML, too."""
    return (*_YAML, *(suffix for suffix in _added_formats() if suffix not in _YAML))


def _added_formats() -> dict[str, Extension]:
    return {f".{each.name.lower()}": each for each in find_extensions(SCENARIO_FORMATS)}


def _read(path: Path) -> Scenario:
    """Read a file: by its suffix in the format of a package, else as YAML, whose keys identify HUGSIM scenarios."""
    suffix = path.suffix.lower()
    if suffix not in _YAML and (extension := _added_formats().get(suffix)) is not None:
        return _read_by(extension, path)
    data = read_whole(path)
    try:
        values = yaml_values(data)
        if not is_hugsim_scenario(values):
            return convert_checked(values, Scenario)
    except ValueError as error:
        as_yaml = f"; read as YAML, as no installed package reads {suffix} scenarios"
        raise ValueError(f"{path}: {error}{as_yaml if suffix and suffix not in _YAML else ''}") from None
    return hugsim_scenario(values, path)


def _read_by(extension: Extension, path: Path) -> Scenario:
    """Read a file by third-party code, whose errors become one sentence that names the file."""
    try:
        return extension.expect(extension.load_callable()(path), Scenario, "reads")
    except ValueError as error:
        reason = printable_line(error)
        raise ValueError(reason if reason.startswith(str(path)) else f"{path}: {reason}") from error.__cause__
    except (OSError, MemoryError):
        raise
    except Exception as error:  # third-party code may raise anything
        raise ValueError(f"{path}: {extension.unfit(error)}") from error


def save_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario atomically; `load_scenario` restores the same value.

    Only values that differ from the defaults are written. File names become relative to the written file's folder.
    Raises OSError.
    """

    def relative(name: str) -> str:
        return os.path.relpath(name, path.parent) if not Path(name).is_absolute() and Path(name).exists() else name

    values = _plain(_renamed(scenario, relative))
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    with whole_file(path) as partial_file:
        partial_file.write_text(text, encoding="utf-8")


def _plain(value: object) -> Any:
    """Return plain values; of structs the fields that differ from their defaults, after the tag of a tagged one."""
    if isinstance(value, tuple):
        items: tuple[object, ...] = value
        return [_plain(each) for each in items]
    if not isinstance(value, msgspec.Struct):
        return msgspec.to_builtins(value)
    tag = value.__struct_config__.tag_field
    plain: dict[str, Any] = {} if tag is None else {tag: value.__struct_config__.tag}
    for field in msgspec.structs.fields(value):
        own = getattr(value, field.name)
        if field.default is msgspec.NODEFAULT or own != field.default:
            plain[field.encode_name] = _plain(own)
    return plain


def _renamed(scenario: Scenario, rename: Callable[[str], str]) -> Scenario:
    """Return a scenario with its file names replaced; names of shipped things stay."""
    rain, scene, users = scenario.rain, scenario.scene, list[ScenarioUser]()
    if rain.calibration not in calibration_names():
        rain = msgspec.structs.replace(rain, calibration=rename(rain.calibration))
    if rain.sensor is not None and rain.sensor not in sensor_names():
        rain = msgspec.structs.replace(rain, sensor=rename(rain.sensor))
    if rain.lamps is not None and rain.lamps not in LAMP_WORDS:
        rain = msgspec.structs.replace(rain, lamps=rename(rain.lamps))
    for user in scenario.road_users:
        model, behaviour = user.model, user.behaviour
        if model.split("/")[0] not in model_names() and not model.startswith(ACTOR):
            model = rename(model)
        if isinstance(behaviour, Replay):
            behaviour = msgspec.structs.replace(behaviour, rollout=rename(behaviour.rollout))
        users.append(msgspec.structs.replace(user, model=model, behaviour=behaviour))
    scene = scene if scene == DEFAULT_SCENE else rename(scene)
    return msgspec.structs.replace(scenario, scene=scene, rain=rain, road_users=tuple(users))
