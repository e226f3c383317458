"""Old import path of the Python API, kept for one release: programs import `gsrain` instead.

Names load on first access, so that importing this module is cheap; `api.pyi` lists them.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

_PLACES = {
    each.asname or each.name: (f"gsrain_engine.{node.module}", each.name)
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for each in node.names
}
"""Module, and name there, of each name."""


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"gsrain_engine.api has no {name!r}")
    module, present = _PLACES[name]
    found = globals()[name] = getattr(import_module(module), present)
    return found


def __dir__() -> list[str]:
    return sorted(name for name, (_, present) in _PLACES.items() if name == present)
