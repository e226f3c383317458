"""Arguments of public calls: converted to the types of their annotations, or refused by one sentence."""

import dataclasses
import inspect
import math
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, Unpack, get_args, get_origin, get_type_hints
from weakref import WeakSet

import jaxtyping
import msgspec
import numpy as np

from gsrain_engine.rain.settings import RainSettings as RainSettings
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.safe_io.foreign_values import as_array, as_plain, as_plain_values, short_repr
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.named_view import NamedView
from gsrain_engine.scene.scene import Actor, ColorGrading, Layer, PoseTrack, RigCamera, Scene

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")
Settings = TypeVar("Settings")


def checked(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Decorate a public function or method: its annotations are the types that its arguments get.

    Whatever has `__float__`, `__index__` or `__fspath__` is taken for a number or a path, and any sequence or array for
    a tuple. Scenes and cameras are checked as those of files are. Raises `ValueError`, which names the argument, for
    anything else, and `TypeError` for missing and unknown arguments, before the function begins.
    """
    parameters = inspect.signature(function)

    @wraps(function)
    def call(*args: _Parameters.args, **kwargs: _Parameters.kwargs) -> _Result:
        bound, kinds = parameters.bind(*args, **kwargs), _hints(function)
        for name, value in bound.arguments.items():
            if parameters.parameters[name].kind is inspect.Parameter.VAR_KEYWORD:
                fields = _fields_of(kinds[name], value)
                bound.arguments[name] = {each: conform(given, fields[each], each) for each, given in value.items()}
            elif name in kinds:
                bound.arguments[name] = conform(value, kinds[name], name)
        return function(*bound.args, **bound.kwargs)

    return call


@cache
def _hints(of: Any) -> dict[str, Any]:
    return get_type_hints(of)


def _fields_of(kind: Any, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """Types of further keyword arguments; raises `TypeError` for one that a typed dictionary lacks."""
    if get_origin(kind) is not Unpack:
        return dict.fromkeys(given, kind)
    fields = _hints(get_args(kind)[0])
    if unknown := [name for name in given if name not in fields]:
        raise TypeError(f"{unknown[0]}: no such argument; there are {', '.join(fields)}")
    return fields


def conform(value: Any, kind: Any, name: str) -> Any:
    """Return a value as the type of an annotation. Raises `ValueError`, which begins with `name`, where it is none."""
    origin, members = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin in (Union, UnionType):
        return _conform_to_one(value, members, name)
    if kind in _SCALARS:
        return _scalar(value, kind, name)
    if kind is Path:
        if hasattr(type(value), "__fspath__") and isinstance(path := os.fspath(value), str):
            return value if isinstance(value, Path) else Path(path)
    elif origin is Literal:
        choice = _plain_or_none(value)
        if choice in members and type(choice) in map(type, members):
            return choice
    elif origin is tuple or origin in (Sequence, list):
        return _sequence(value, kind, name)
    elif origin in (Mapping, dict):
        if isinstance(value, Mapping):
            return {key: conform(each, members[1], f"{name}: {key}") for key, each in value.items()}
    elif origin is Callable:
        if callable(value):
            return value
    elif _is_array(kind):
        return _array(value, kind, name)
    elif isinstance(value, kind):
        return _conform_object(value, name)
    raise _refusal(value, [kind], name)


def _conform_to_one(value: Any, kinds: Sequence[Any], name: str) -> Any:
    """Return a value as the first type of a union that takes it."""
    if value is None and NoneType in kinds:
        return None
    others = [each for each in kinds if each is not NoneType]
    own = [each for each in others if isinstance(each, type) and not _is_array(each) and isinstance(value, each)]
    if own or len(others) == 1:
        return conform(value, (own or others)[0], name)
    for each in others:
        try:
            return conform(value, each, name)
        except ValueError:
            continue
    raise _refusal(value, others, name)


# Numbers, texts, sequences, arrays

_SCALARS: Mapping[Any, str] = {float: "a number", int: "a whole number", bool: "True or False", str: "a text"}


def _scalar(value: Any, kind: type, name: str) -> Any:
    plain = _plain_or_none(value)
    if type(plain) is kind and (kind is not float or math.isfinite(plain)):
        return plain
    if kind is float and type(plain) is int and abs(plain) <= _LARGEST:
        return float(plain)
    if kind is int and type(plain) is float and plain.is_integer():
        return int(plain)
    raise _refusal(value, [kind], name)


_LARGEST = 2**1023  # whole number, about, that a float can hold


def _plain_or_none(value: Any) -> Any:
    try:
        return as_plain(value)
    except ValueError:
        return None


def _sequence(value: Any, kind: Any, name: str) -> Any:
    """Return a list, a tuple or an array as a sequence with members of the annotated types."""
    members = get_args(kind)
    if hasattr(type(value), "tolist"):
        value = as_plain(value)
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise _refusal(value, [kind], name)
    if get_origin(kind) is tuple and members[-1] is not Ellipsis:
        if len(value) != len(members):
            raise _refusal(value, [kind], name)
    else:
        members = [members[0]] * len(value)
    pairs = enumerate(zip(value, members, strict=True))
    found = [conform(each, member, f"{name}[{index}]") for index, (each, member) in pairs]
    return tuple(found) if get_origin(kind) is tuple else found


def _is_array(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, jaxtyping.AbstractArray)


def _array(value: Any, kind: Any, name: str) -> np.ndarray:
    """Return an array of the annotated type and number of axes, with finite numbers."""
    dtype = next((each for each in ("bool", "float32") if [*kind.dtypes][:1] == [each]), "float64")
    array = as_array(value, dtype, name)
    with jaxtyping.jaxtyped("context"):  # named dimensions are those of this array alone
        if not isinstance(array, kind):
            raise ValueError(f"{name} has shape {array.shape}, expected ({kind.dim_str.strip()})")
    if array.dtype.kind == "f":
        _check_finite(array, name)
    return array


def _check_finite(array: np.ndarray, name: str) -> None:
    with np.errstate(invalid="ignore"):
        is_finite = not array.size or bool(np.isfinite(array.min()) and np.isfinite(array.max()))
    if not is_finite:
        at = np.unravel_index(np.flatnonzero(~np.isfinite(array))[0], array.shape)
        raise ValueError(f"{name}[{', '.join(map(str, at))}] is {array[at]}: expected finite numbers")


# Values of scenes

_sound: "WeakSet[Scene | Gaussians]" = WeakSet()
"""Scenes and Gaussians that have been checked: they don't change."""


def _conform_object(value: Any, name: str) -> Any:
    """Check a value by its type, and return it with numbers of Python in it."""
    match value:
        case RainSettings():
            return checked_settings(value, RainSettings, RAIN_FIELDS)
        case Camera():
            return _camera(value, name)
        case Scene() | Gaussians() if value in _sound:
            return value
        case Gaussians() | Scene():
            found = _with_fields(value, name)
            _check_gaussians(found, name) if isinstance(found, Gaussians) else _check_axes(found, name)
            if found is value:
                _sound.add(value)
            return found
        case Lamp() | ColorGrading() | NamedView():
            try:
                return checked_settings(value, type(value), {})
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        case Layer() | Actor():
            found = _with_fields(value, name)
            _check_member(found, name)
            return found
        case PoseTrack() | RigCamera() | CameraPath():
            return _with_fields(value, name)
        case _:
            return value


def _with_fields(value: Any, name: str, **converted: Any) -> Any:
    """Return a dataclass whose fields have the annotated types; itself where they had. Some are `converted` already."""
    if isinstance(value, Layer | Actor):
        name = f"{name}: {short_repr(value.name)}"
    changes: dict[str, Any] = {}
    for field, kind in _hints(type(value)).items():
        before = getattr(value, field)
        after = converted[field] if field in converted else conform(before, kind, f"{name}: {field}")
        if not _is_same(before, after):
            changes[field] = after
    return dataclasses.replace(value, **changes) if changes else value


def _is_same(before: Any, after: Any) -> bool:
    """Return whether a conversion has changed nothing; it makes new tuples and mappings of the same members."""
    if type(before) is not type(after):
        return False
    if isinstance(before, tuple):
        return len(before) == len(after) and all(map(_is_same, before, after))
    if isinstance(before, msgspec.Struct):
        return all(_is_same(getattr(before, each), getattr(after, each)) for each in before.__struct_fields__)
    if isinstance(before, dict):
        return all(_is_same(each, after[key]) for key, each in before.items())
    return before is after or (isinstance(before, float | int | str) and before == after)


def _camera(camera: Camera, name: str) -> Camera:
    """Return a camera with plain numbers and a matrix of floats, checked as one of a file is."""
    matrix = as_array(camera.world_to_camera, np.float64, f"{name}: world_to_camera")
    found = _with_fields(camera, name, world_to_camera=matrix)
    found.check(name)
    if found.world_to_camera[1, 2] > _UPSIDE_DOWN:
        warnings.warn(
            f"{name}: world_to_camera holds the picture upside down, as a matrix of OpenGL does (y up, z backward): "
            "turn y and z over, np.diag([1, -1, -1, 1]) @ world_to_camera",
            stacklevel=2,
        )
    return found


_UPSIDE_DOWN = 0.7  # sine of the angle by which a picture's lower edge points up


def _check_axes(scene: Scene, name: str) -> None:
    """Raise `ValueError` for a scene without an upward direction or a unit."""
    if not any(scene.up):
        raise ValueError(f"{name}: up {scene.up}: expected a direction, such as (0, 0, 1)")
    if not scene.metres_per_unit > 0:
        raise ValueError(f"{name}: metres_per_unit {scene.metres_per_unit:g}: must be above 0")


def _check_member(member: Layer | Actor, name: str) -> None:
    """Raise `ValueError` for an opacity or a place that no member of a scene has."""
    if not 0 <= member.opacity <= 1:
        raise ValueError(f"{name}: {member.key}: opacity {member.opacity:g}: must be within 0..1")
    if isinstance(member, Layer) and not np.linalg.det(member.to_scene[:3, :3]) > 0:
        raise ValueError(f"{name}: {member.key}: to_scene must hold a rotation with a scale above 0, without mirroring")


def _check_gaussians(gaussians: Gaussians, name: str) -> None:
    """Raise `ValueError` for numbers that no Gaussians have, with what they probably are."""
    if not len(gaussians):
        return
    scales, opacities = gaussians.scales, gaussians.opacities
    if scales.min() < 0:
        raise ValueError(
            f"{name}: scales{_place(scales < 0, scales)}, expected standard deviations of at least 0: "
            "np.exp(scales), if they are the logarithms that a .ply holds"
        )
    outside = np.abs(opacities - np.float32(0.5)) > 0.5 + _ROUNDING
    if outside.any():
        raise ValueError(
            f"{name}: opacities{_place(outside, opacities)}, expected 0 to 1: "
            "1 / (1 + np.exp(-opacities)), if they are the logits that a .ply holds"
        )
    lengths = np.sqrt(np.einsum("ij,ij->i", gaussians.quaternions, gaussians.quaternions))
    wrong = np.abs(lengths - 1) > _NOT_UNIT
    if wrong.any():
        raise ValueError(
            f"{name}: quaternions[{int(np.argmax(wrong))}] has the length {lengths[np.argmax(wrong)]:.3g}, expected 1 "
            "(w, x, y, z): quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True), if none is 0"
        )


_ROUNDING = 1e-3  # of opacities
_NOT_UNIT = 1e-2  # of lengths of quaternions


def _place(wrong: np.ndarray, values: np.ndarray) -> str:
    """Return index and value of the first wrong number of an array."""
    at = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
    return f"[{', '.join(map(str, at))}] is {values[at]:.4g}"


# Settings

RAIN_FIELDS = {
    "intensity": "intensity_mm_h",
    "wind": "wind_m_s",
    "exposure": "exposure_s",
    "gusts": "gust_m_s",
    "turbulence": "turbulence_m_s",
}
"""Short argument names of `gr.Rain`, whose units are in its docstring, and the fields that they set."""


def checked_settings(values: Any, kind: type[Settings], fields: Mapping[str, str]) -> Settings:
    """Return checked settings of a kind, of their values by name or a value; errors name the arguments of `fields`."""
    given = msgspec.structs.asdict(values) if isinstance(values, msgspec.Struct) else values
    try:
        return convert_checked(as_plain_values(given), kind)
    except ValueError as error:
        message = str(error)
    for argument, field in fields.items():
        message = message.replace(field, argument)
    raise ValueError(message.replace("`$.", "`")) from None


# Errors


def _refusal(value: Any, kinds: Iterable[Any], name: str) -> ValueError:
    expected = ", or ".join(dict.fromkeys(map(_described, kinds)))
    return ValueError(f"{name} {short_repr(value)}: expected {expected}")


def _described(kind: Any) -> str:
    """Return a type in words."""
    origin, members = get_origin(kind), get_args(kind)
    if kind in _SCALARS:
        return "a finite number" if kind is float else _SCALARS[kind]
    if kind is Path:
        return "a path"
    if origin is Literal:
        return f"one of {', '.join(map(repr, members))}"
    if origin is tuple and members[-1] is not Ellipsis:
        return f"{len(members)} values, each {_described(members[0])}"
    if origin in (tuple, Sequence, list):
        return f"a sequence, each {_described(members[0])}"
    if origin in (Union, UnionType):
        return ", or ".join(map(_described, members))
    if origin in (Mapping, dict):
        return "a mapping"
    if origin is Callable:
        return "a function"
    return _EXAMPLES.get(kind, f"a {getattr(kind, '__name__', kind)}")


_EXAMPLES: Mapping[Any, str] = {
    Scene: "a scene, such as gr.load('street')",
    RainSettings: "rain settings, such as gr.Rain(8.5)",
    Camera: "a gr.Camera, such as gr.home_camera(scene)",
    CameraPath: "a gr.CameraPath, such as gr.CameraPath.orbit(scene)",
}
