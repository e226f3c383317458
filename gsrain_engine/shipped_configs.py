"""YAML files by name: those that the program ships in a folder of sample_configs, or a person's own by path."""

from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from .untrusted.explained_errors import converted
from .untrusted.plain_values import read_whole, yaml_values

_Config = TypeVar("_Config")


def shipped_names(folder: str) -> list[str]:
    """Names of the shipped files of a folder, in the order of the alphabet."""
    files = resources.files("sample_configs").joinpath(folder).iterdir()
    return sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml"))


def load_config(folder: str, name: str | Path, kind: type[_Config], what: str) -> _Config:
    """Read a file as a type that msgspec knows; `what` it is begins the sentence where it is not found.

    Raises ValueError with the file, the field and what is allowed, OSError where it can't be read.
    """
    data = _data(folder, str(name), what)
    try:
        return converted(yaml_values(data), kind)
    except ValueError as error:
        where = f"{what} {name}" if str(name) in shipped_names(folder) else name
        raise ValueError(f"{where}: {error}") from None


def load_values(folder: str, name: str | Path, what: str) -> dict[str, Any]:
    """Read a file's fields unchecked, for what goes on top of them; raises ValueError as `load_config` does."""
    values = load_config(folder, name, object, what)
    if not isinstance(values, dict):
        raise ValueError(f"{name}: expected a YAML mapping of settings such as `steps: 1500`")
    return {str(key): value for key, value in values.items()}


def _data(folder: str, name: str, what: str) -> bytes:
    if name in shipped_names(folder):
        return resources.files("sample_configs").joinpath(folder, f"{name}.yaml").read_bytes()
    path = Path(name)
    if not path.is_file():
        known = ", ".join(shipped_names(folder))
        raise ValueError(f"{what} {name}: no such file, and none of the shipped ones ({known})")
    return read_whole(path)
