"""Edit steps as text: each edit of a scene by name with its arguments, for the history, the command line and Python.

A step such as `rename key=layers/road name="wet road"` names a function of `EDITS`. Its arguments are
JSON values, converted to and from the types of the function's parameters.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from inspect import Parameter, signature
from typing import Any, NamedTuple, get_type_hints

import msgspec
import numpy as np

from ..safe_io.errors import convert_checked
from ..scene.camera_path import CameraPath
from ..scene.flags import BitMask
from ..scene.formats.scene_json import PathRecord, mask_from_text, mask_to_text, path_of, path_record
from ..scene.scene import Scene

_EDITS = {
    "edits.actors": "turn_actor retime_actor drive_along_own_path set_ego_start set_origin",
    "edits.gaussians": "delete_selected hide_selected isolate_selected show_all crop compact",
    "edits.layers": "duplicate separate remove rename move_up move_down merge",
    "edits.level": "level_from_ground level_from_points set_ground_height set_length",
    "edits.rain": "change_rain set_rain_keyframes",
    "edits.transform": "move_selected move_member set_layer_pose",
}
EDITS: Mapping[str, str] = {
    name.replace("_", "-"): f"gsrain_engine.editor.{module}:{name}"
    for module, names in _EDITS.items()
    for name in names.split()
}
"""Names of all edits, and the functions that make them: of a scene and of arguments; they return the edited scene."""


_PARAMETER = re.compile(r"([\w-]+)=")
_WORD = re.compile(r"(?!(true|false|null|NaN|Infinity)$)[A-Za-z][\w/.:-]*")


class EditError(ValueError):
    """An edit that does not exist, or with arguments that it does not take; the message names them."""


class _MaskRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A `BitMask`; see `mask_to_text`."""

    count: int
    bits: str


@dataclass(frozen=True, slots=True)
class EditStep:
    """One edit with plain arguments."""

    name: str
    """A name of `EDITS`."""
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """JSON values by parameter; parameters with their default may be absent."""

    @classmethod
    def of(cls, change: Callable[..., Scene], arguments: Iterable[Any]) -> "EditStep":
        """Describe a call of a function of `EDITS`; `arguments` are positional, without the scene.

        Raises `EditError` for another function.
        """
        name = _names().get(change)
        if name is None:
            raise EditError(f"{change.__qualname__} is no edit that has a name")
        parameters = list(_parameters(change).values())
        values = zip(parameters, arguments, strict=False)
        return cls(name, {each.name: _plain(value) for each, value in values if not _is_default(each, value)})

    @classmethod
    def of_values(cls, name: str, values: Mapping[str, Any]) -> "EditStep":
        """Describe an edit by its name, with values of the types of its parameters, or JSON values."""
        return cls(name.replace("_", "-"), {each: _plain(value) for each, value in values.items()})

    @classmethod
    def parse(cls, text: str) -> "EditStep":
        """Read the text of a step: a name, then `parameter=value` with JSON values or single words.

        Raises `EditError` for anything else.
        """
        name, _, rest = text.strip().partition(" ")
        arguments: dict[str, Any] = {}
        while rest := rest.strip():
            match = _PARAMETER.match(rest)
            if match is None:
                raise EditError(f"{name}: expected parameter=value, got {rest!r}")
            arguments[match[1].replace("-", "_")], rest = _first_value(rest[match.end() :])
        return cls(name.replace("_", "-"), arguments)

    @property
    def text(self) -> str:
        """The step as `parse` reads it."""
        return " ".join([self.name, *(f"{name}={_text(value)}" for name, value in self.arguments.items())])

    @property
    def python(self) -> str:
        """The step as a call of the Python API, of `scene`."""
        arguments = "".join(f", {name}={value!r}" for name, value in self.arguments.items())
        return f"scene = gr.edit(scene, {self.name!r}{arguments})"

    def apply(self, scene: Scene) -> Scene:
        """Make the edit; returns the edited scene.

        Raises:
            EditError: For an unknown name or parameter, a missing one, or a value of another type.
            ValueError: When the edit refuses, such as for a locked layer.
        """
        if self.name not in EDITS:
            raise EditError(f"{self.name}: no such edit; there are {', '.join(EDITS)}")
        change = _function(self.name)
        parameters, hints = _parameters(change), get_type_hints(change)
        for name, parameter in parameters.items():
            if parameter.default is Parameter.empty and name not in self.arguments and not _takes_any(parameter):
                raise EditError(f"{self.name}: needs {name}=...")
        values: dict[str, Any] = {}
        for name, value in self.arguments.items():
            if name in hints:
                try:
                    values[name] = convert_checked(value, hints[name], dec_hook=_decoded)
                except ValueError as error:
                    raise EditError(f"{self.name}: {name}: {error}") from None
            elif any(map(_takes_any, parameters.values())):
                values[name] = value
            else:
                known = ", ".join(parameters) or "none"
                raise EditError(f"{self.name}: has no parameter {name!r}; it takes {known}")
        return change(scene, **values)


class EditHelp(NamedTuple):
    """Description of an edit for users."""

    name: str
    parameters: str
    """Such as "key=... time_s=0.0"."""
    summary: str


def edit_help() -> Iterator[EditHelp]:
    """Describe all edits, in the order of `EDITS`."""
    for name in EDITS:
        change = _function(name)
        summary = (change.__doc__ or "").strip().partition("\n")[0]
        yield EditHelp(name, " ".join(map(_parameter_help, _parameters(change).values())), summary)


def _parameter_help(parameter: Parameter) -> str:
    if _takes_any(parameter):
        return f"[{parameter.name.upper()}=...]"
    if parameter.default is Parameter.empty:
        return f"{parameter.name}=..."
    return f"[{parameter.name}={_text(_plain(parameter.default))}]"


def apply_steps(scene: Scene, steps: Iterable[EditStep]) -> Scene:
    """Apply steps one after another; the errors of `EditStep.apply` name the step's number and its edit."""
    for number, step in enumerate(steps, 1):
        try:
            scene = step.apply(scene)
        except EditError as error:
            raise EditError(f"step {number}: {error}") from None
        except ValueError as error:
            raise ValueError(f"step {number}, {step.name}: {error}") from None
    return scene


# Functions and their arguments


@cache
def _function(name: str) -> Callable[..., Scene]:
    module, _, function = EDITS[name].partition(":")
    return getattr(import_module(module), function)


@cache
def _names() -> dict[Callable[..., Scene], str]:
    return {_function(name): name for name in EDITS}


def _parameters(change: Callable[..., Scene]) -> dict[str, Parameter]:
    """Parameters of an edit by name, without the scene."""
    _, *rest = signature(change).parameters.values()
    return {each.name: each for each in rest}


def _takes_any(parameter: Parameter) -> bool:
    return parameter.kind is Parameter.VAR_KEYWORD


def _is_default(parameter: Parameter, value: object) -> bool:
    return parameter.default is not Parameter.empty and _plain(value) == _plain(parameter.default)


def _plain(value: Any) -> Any:
    """Convert an argument to JSON values."""
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=_encoded))


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, BitMask):
        return msgspec.to_builtins(_MaskRecord(value.count, mask_to_text(value)))
    if isinstance(value, CameraPath):
        return msgspec.to_builtins(path_record(value))
    raise NotImplementedError(f"{type(value).__name__} has no JSON form")


def _decoded(kind: type, value: Any) -> Any:
    """Convert JSON values to a type of a parameter that msgspec does not know."""
    if kind is BitMask:
        record = msgspec.convert(value, _MaskRecord)
        return mask_from_text(record.bits, record.count, "mask")
    if kind is CameraPath:
        return path_of(msgspec.convert(value, PathRecord), "path")
    array = np.asarray(value, np.float64)  # the remaining ones are arrays of jaxtyping
    if not isinstance(array, kind):
        raise ValueError(f"expected numbers of shape {getattr(kind, 'dim_str', '')}, got shape {array.shape}")
    return array


def _first_value(text: str) -> tuple[Any, str]:
    """Split text into its first value, JSON or a word, and the rest."""
    with suppress(ValueError):
        value, end = json.JSONDecoder().raw_decode(text)
        if end == len(text) or text[end].isspace():
            return value, text[end:]
    word, *rest = text.split(maxsplit=1) if text and not text[0].isspace() else ("", text)
    return word, "".join(rest)


def _text(value: Any) -> str:
    """Format a JSON value so that `_first_value` reads it; words stay as they are."""
    if isinstance(value, str) and _WORD.fullmatch(value):
        return value
    return json.dumps(value, ensure_ascii=False)
