"""Scenarios into YAML files: what differs from the defaults, so that a file says what its test is about."""

from pathlib import Path
from typing import Any

import msgspec
import yaml

from gsrain_engine.scene.atomic_files import whole_file

from .named_files import named_from_folder
from .scenario import Scenario


def save_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario, whole or not at all; `load_scenario` gives back the same value.

    Files that it names count from the written file's folder. Raises OSError.
    """
    told = _told(named_from_folder(scenario, path.parent))
    text = yaml.safe_dump(told, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    with whole_file(path) as beside:
        beside.write_text(text, encoding="utf-8")


def _told(settings: msgspec.Struct) -> dict[str, Any]:
    """Fields that are not at their defaults; what a kind of settings is called stands first."""
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
        return _told(value)
    if isinstance(value, tuple):
        items: tuple[object, ...] = value
        return [_plain(each) for each in items]
    return msgspec.to_builtins(value)
