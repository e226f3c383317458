"""Old import path of the Python API, kept for one release: programs import `gsrain` instead.

Names load on first access, so that importing this module is cheap; `api.pyi` lists them.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
_PLACES = {each.name: str(node.module) for node in _STUB if isinstance(node, ast.ImportFrom) for each in node.names}
"""Module of each name, relative to `gsrain_engine`."""

RENAMED = {ast.unparse(node.targets[0]): ast.unparse(node.value) for node in _STUB if isinstance(node, ast.Assign)}
"""Names of version 0.1, and those of today."""


def __getattr__(name: str) -> Any:
    present = RENAMED.get(name, name)
    if present not in _PLACES:
        raise AttributeError(f"gsrain_engine.api has no {name!r}")
    found = globals()[name] = getattr(import_module(f"gsrain_engine.{_PLACES[present]}"), present)
    return found


def __dir__() -> list[str]:
    return sorted(_PLACES)
