"""Scenario files of every kind that can be read: ours, HUGSIM's, OpenSCENARIO XML."""

from pathlib import Path

import msgspec

from gsrain_engine.shipped_configs import load_config

from .hugsim_import import is_hugsim_scenario, read_hugsim_scenario
from .openscenario.reading import read_openscenario
from .scenario import Scenario

_MOST_BYTES = 1 << 24


def read_scenario(path: Path) -> Scenario:
    """Read a file: `.xosc` is OpenSCENARIO XML, all else YAML, which shows by its keys whether it is HUGSIM's.

    Raises ValueError with the file, the field and what is allowed.
    """
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError(f"{path}: {path.stat().st_size / 1e6:.0f} MB are too many for a scenario")
    if path.suffix.lower() == ".xosc":
        return read_openscenario(path)
    try:
        values = msgspec.yaml.decode(path.read_bytes())
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: {error}") from None
    if is_hugsim_scenario(values):
        return read_hugsim_scenario(path)
    return load_config("scenarios", path, Scenario, "scenario")
