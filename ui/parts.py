"""The editor's parts as arguments: a parameter of a panel, command or tool is named like the part that it gets."""

import inspect
from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeVar

from gsrain_engine.editor.editor import Editor

_Result = TypeVar("_Result")


def bind_parts(function: Callable[..., _Result], editor: Editor, **others: Any) -> Callable[[], _Result]:
    """Return a call of a function with the parts that its parameters name; `editor` names the whole.

    `others` are arguments that are no parts, for functions that have such parameters. Raises `TypeError`, with the
    parameter, for a name that is no part.
    """
    arguments: dict[str, Any] = {}
    for name in _parameters_of(function):
        if name in others:
            arguments[name] = others[name]
        elif name == "editor":
            arguments[name] = editor
        elif name in vars(editor):
            arguments[name] = vars(editor)[name]
        else:
            raise TypeError(f"the parameter {name!r} is not named like a part of the editor")
    return partial(function, **arguments)


@cache
def _parameters_of(function: Callable[..., Any]) -> tuple[str, ...]:
    return tuple(inspect.signature(function).parameters)
