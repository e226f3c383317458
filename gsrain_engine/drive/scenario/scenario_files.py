"""Scenario files of every kind that can be read: ours, HUGSIM's, OpenSCENARIO XML."""

from pathlib import Path

from gsrain_engine.shipped_configs import load_config, shipped_names
from gsrain_engine.untrusted.explained_errors import converted
from gsrain_engine.untrusted.plain_values import read_whole, yaml_values

from .hugsim_import import hugsim_scenario, is_hugsim_scenario
from .named_files import named_from_here
from .openscenario.reading import read_openscenario
from .scenario import Scenario

_FOLDER = "scenarios"


def scenario_names() -> list[str]:
    return shipped_names(_FOLDER)


def load_scenario(name: str | Path) -> Scenario:
    """Load a shipped scenario by name, or a scenario file by path: ours, HUGSIM's, or OpenSCENARIO XML.

    Raises ValueError with the file, the field and what is allowed.
    """
    if str(name) not in scenario_names() and Path(name).is_file():
        return read_scenario(Path(name))
    return load_config(_FOLDER, name, Scenario, "scenario")


def read_scenario(path: Path) -> Scenario:
    """Read a file: `.xosc` is OpenSCENARIO XML, all else YAML, which shows by its keys whether it is HUGSIM's.

    Files that it names are looked for in its own folder first, then in the working folder. Raises ValueError with the
    file, the field and what is allowed.
    """
    return named_from_here(_read(path), path.parent)


def _read(path: Path) -> Scenario:
    if path.suffix.lower() == ".xosc":
        return read_openscenario(path)
    data = read_whole(path)
    try:
        values = yaml_values(data)
        if not is_hugsim_scenario(values):
            return converted(values, Scenario)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return hugsim_scenario(values, path)
