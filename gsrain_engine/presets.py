"""Shipped files (shaders, and YAML configurations by name) and the user's own YAML files by path."""

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

from .safe_io.errors import convert_checked
from .safe_io.text_files import read_whole, yaml_values

_Config = TypeVar("_Config")


def shipped_path(name: str) -> Path:
    """Return the folder `shaders`, `sample_configs` or `docs/guide`, or the file `CHANGELOG.md`.

    An installed program has them inside this package; in a source tree they are its siblings.
    """
    package = Path(__file__).parent
    inside = package / name
    return inside if inside.exists() else package.parent / name


def shipped_config_names(folder: str | Path) -> list[str]:
    """Names of the shipped files of a folder of `sample_configs`, or of an extension's own, in alphabetical order."""
    files = (shipped_path("sample_configs") / folder).iterdir()
    return sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml"))


def load_config(
    folder: str | Path,
    name: str | Path,
    kind: type[_Config],
    what: str,
    files: Collection[str] = (),
    known: Collection[str] = (),
) -> _Config:
    """Read a file, or a shipped one by its name, as a type that msgspec supports; `what` is its noun in error messages.

    Shipped files are those of a folder of `sample_configs`, or of an extension's own folder, an absolute path.
    Its fields `files` name files relative to its own folder (`resolve_from_folder`), except `known` names. Raises
    ValueError with the file, the field and the allowed values, OSError if it can't be read.
    """
    shipped, path = shipped_config_names(folder), Path(name)
    is_shipped = str(name) in shipped
    if is_shipped:
        data = (shipped_path("sample_configs") / folder / f"{name}.yaml").read_bytes()
    elif path.exists():
        data = read_whole(path)
    else:
        raise ValueError(f"{what} {name}: no such file, and none of the shipped ones ({', '.join(shipped)})")
    try:
        values = yaml_values(data)
        return convert_checked(values if is_shipped else _resolve_names(values, path.parent, files, known), kind)
    except ValueError as error:
        raise ValueError(f"{f'{what} {name}' if is_shipped else name}: {error}") from None


def load_values(
    folder: str, name: str | Path, what: str, files: Collection[str] = (), known: Collection[str] = ()
) -> dict[str, Any]:
    """Read a file's fields unchecked, for merging with other values; otherwise like `load_config`."""
    values = load_config(folder, name, object, what, files, known)
    if not isinstance(values, dict):
        raise ValueError(f"{name}: expected a YAML mapping of settings such as `steps: 1500`")
    return {str(key): value for key, value in values.items()}


def resolve_from_folder(folder: Path, name: str) -> str:
    """Resolve a name relative to a folder to a path for the working folder; unchanged if no such file exists.

    A name that continues after `.py:` names an object in a Python file.
    """
    file, python, _ = name.partition(".py:")
    place = folder / (f"{file}.py" if python else name)
    exists = os.path.exists(place)  # noqa: PTH110  that of Path raises where a name is too long
    return os.path.normpath(folder / name) if name and exists else name


def _resolve_names(
    values: Any, folder: Path, files: Collection[str], known: Collection[str], *, is_name: bool = False
) -> Any:
    """Return plain values with the names in the fields `files`, at any depth, resolved from `folder`."""
    if isinstance(values, list):
        return [_resolve_names(each, folder, files, known, is_name=is_name) for each in values]
    if isinstance(values, dict):
        return {key: _resolve_names(each, folder, files, known, is_name=key in files) for key, each in values.items()}
    is_path = is_name and isinstance(values, str) and values not in known
    return resolve_from_folder(folder, values) if is_path else values
