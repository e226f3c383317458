"""Steps of the history as text: each edit by name with its arguments, for the command line and Python.

A step such as `rename key=layers/road name="wet road"` names an edit of `EDITS` or of an installed package.
Its arguments are JSON values, converted from and to the types of the parameters of the edit's function.
"""

import base64
import binascii
import json
import re
import shlex
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from types import UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
from jaxtyping import jaxtyped

from ..rain.keyframes import NO_KEYFRAMES, keyframes_of, rain_of
from ..rain.settings import load_preset
from ..safe_io.errors import convert_checked
from ..safe_io.foreign_values import as_plain
from ..scene.scene import Scene
from .document import DocumentState, History, Step
from .edits.members import with_path
from .scene_edits import InstalledEdit, installed_edits
from .selection.commands import select_found

Kind = Literal["scene", "path", "selection", "document", "keyframes"]


class Edit(NamedTuple):
    """A function that edits, by its place, and what it takes and returns."""

    function: str | Callable[..., Scene]
    """Such as "edits.layers:rename" in this package; with a leading dot, in the engine. Of other packages, itself."""
    kind: Kind = "scene"
    """Scene, its camera path (see `with_path`), document, or rain keyframes; or a search for the Gaussians of a scene
    that are combined with the selection (see `select_found`)."""
    fields: str = ""
    """Type whose fields the function takes as further arguments by name."""


_PATHS = ".scene.camera_path_edit:"
_KEYFRAMES, _KEYFRAME = ".rain.keyframes:RainKeyframes", ".rain.keyframes:RainKeyframe"
EDITS: Mapping[str, Edit] = {
    "delete-selected": Edit("edits.gaussians:delete_selected"),
    "hide-selected": Edit("edits.gaussians:hide_selected"),
    "isolate-selected": Edit("edits.gaussians:isolate_selected"),
    "show-all": Edit("edits.gaussians:show_all"),
    "crop": Edit("edits.gaussians:crop"),
    "purge-deleted": Edit("edits.gaussians:compact"),
    "find-floaters": Edit("background_edits:find_floaters"),
    "select-all": Edit("selection.candidates:all_selected"),
    "select-none": Edit("selection.candidates:none_selected"),
    "invert-selection": Edit("selection.candidates:inverted"),
    "select-in-view": Edit("selection.screen:select_in_screen_shape", "selection"),
    "select-in-volume": Edit("selection.volume:in_volume", "selection"),
    "select-near": Edit("selection.volume:near_selection", "selection"),
    "select-flood": Edit("selection.volume:flood_select", "selection"),
    "select-color": Edit("selection.candidates:select_similar_colors", "selection"),
    "select-range": Edit("selection.attributes:select_attribute_range", "selection"),
    "select-set": Edit("selection.commands:members_of_set", "selection"),
    "save-set": Edit("selection.commands:save_set"),
    "rename-set": Edit("selection.commands:rename_set"),
    "remove-set": Edit("selection.commands:remove_set"),
    "duplicate": Edit("edits.layers:duplicate"),
    "separate": Edit("edits.layers:separate"),
    "merge": Edit("edits.layers:merge"),
    "rename": Edit("edits.layers:rename"),
    "remove": Edit("edits.layers:remove"),
    "move-up": Edit("edits.layers:move_up"),
    "move-down": Edit("edits.layers:move_down"),
    "import": Edit("background_edits:import_file"),
    "set-visible": Edit("edits.members:set_visible"),
    "set-locked": Edit("edits.members:set_locked"),
    "set-opacity": Edit("edits.members:set_opacity"),
    "set-grading": Edit("edits.members:set_grading", "scene", ".scene.scene:ColorGrading"),
    "move-selected": Edit("edits.transform:move_selected"),
    "move": Edit("edits.transform:move_member"),
    "place": Edit("edits.transform:set_layer_pose"),
    "orient": Edit("edits.level:oriented"),
    "guess-orientation": Edit("edits.level:guess_orientation"),
    "level-by-ground": Edit("edits.level:level_from_ground"),
    "level-by-points": Edit("edits.level:level_from_points"),
    "set-ground-height": Edit("edits.level:set_ground_height"),
    "set-length": Edit("edits.level:set_length"),
    "add-lamp": Edit("edits.lamps:add_lamp"),
    "change-lamp": Edit("edits.lamps:change_lamp", "scene", "edits.lamps:LampFields"),
    "remove-lamp": Edit("edits.lamps:remove_lamp"),
    "find-lamps": Edit("edits.lamps:add_found_lamps"),
    "save-view": Edit("edits.views:save_view"),
    "rename-view": Edit("edits.views:rename_view"),
    "remove-view": Edit("edits.views:remove_view"),
    "move-view": Edit("edits.views:move_view"),
    "set-origin": Edit("edits.actors:set_origin"),
    "set-ego-start": Edit("edits.actors:set_ego_start"),
    "drive-along-path": Edit("edits.actors:drive_along_own_path"),
    "turn-actor": Edit("edits.actors:turn_actor"),
    "retime-actor": Edit("edits.actors:retime_actor"),
    "set-path": Edit("edits.members:set_path"),
    "change-path": Edit("edits.members:change_path", "path", "edits.members:PathOptions"),
    "set-keyframe": Edit(_PATHS + "with_keyframe", "path"),
    "place-keyframe": Edit(_PATHS + "place_keyframe_at", "path"),
    "move-keyframe": Edit(_PATHS + "move_keyframe", "path"),
    "copy-keyframe": Edit(_PATHS + "copy_keyframe_to", "path"),
    "snap-keyframe": Edit(_PATHS + "snap_key_to", "path"),
    "delete-keyframe": Edit(_PATHS + "without_keyframe", "path"),
    "set-keyframe-easing": Edit(_PATHS + "set_key_easing", "path"),
    "reverse-path": Edit(_PATHS + "reverse_path_time", "path"),
    "stretch-path": Edit(_PATHS + "stretch_path_time", "path"),
    "change-rain": Edit("document:with_rain", "document", ".rain.settings:RainSettings"),
    "set-rain-keyframe": Edit(_KEYFRAMES + ".with_key", "keyframes", _KEYFRAME),
    "move-rain-keyframe": Edit("edits.rain_keyframes:move_keyframe", "keyframes", _KEYFRAME),
    "copy-rain-keyframe": Edit("edits.rain_keyframes:copy_keyframe", "keyframes"),
    "set-rain-keyframe-easing": Edit("edits.rain_keyframes:set_keyframe_easing", "keyframes"),
    "remove-rain-keyframe": Edit(_KEYFRAMES + ".without_key", "keyframes"),
    "set-rain-keyframes": Edit("edits.rain_keyframes:replace_keyframes", "keyframes"),
    "set-rain-interpolation": Edit("edits.rain_keyframes:set_interpolation", "keyframes"),
    "add-shower": Edit("edits.rain_keyframes:add_shower", "keyframes"),
    "wet-look": Edit("background_edits:apply_wet_look"),
    "recolor": Edit("background_edits:recolor_to_images"),
    "reconstruct": Edit("background_edits:reconstruct"),
}
"""The program's own edits by name. Those of the history are rows of this table, or edits of other packages."""


def added_edits() -> list[InstalledEdit]:
    """Edits of installed packages, but for those whose names are of our own."""
    return [each for each in installed_edits() if each.name not in EDITS]


def all_edits() -> dict[str, Edit]:
    """All edits by name, those of installed packages last."""
    return {**EDITS, **{each.name: Edit(each.function) for each in added_edits()}}


class EditError(ValueError):
    """An edit that does not exist, or with arguments that it does not take; the message names them."""


@dataclass(frozen=True, slots=True)
class EditStep:
    """One edit with plain arguments."""

    name: str
    """A name of `all_edits`."""
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """JSON values by parameter; parameters with their default may be absent."""

    @classmethod
    def of(cls, step: Step) -> "EditStep":
        """Describe a step of the history. Raises `EditError` for one that no edit makes, such as opening a scene."""
        if step.change is None:
            raise EditError(f"{step.label}: no edit has this result")
        change, arguments, options = step.change, list(step.arguments), dict(step.options)
        if step.recipe is not None:
            change, arguments, options = step.recipe.change, [], dict(step.recipe.arguments)
        elif change is with_path:
            change = arguments.pop(0)
        elif change is select_found:
            change = arguments.pop(1)
        added = (each.name for each in added_edits() if each.function is change)
        name = _names().get(change) or next(added, None)
        if name is None:
            raise EditError(f"{step.label}: no edit has this result")
        parameters = _parameters(all_edits()[name])
        values = dict(zip(parameters, arguments, strict=False)) | options
        usual = {each.name: _plain(each.default) for each in parameters.values() if each.default is not Parameter.empty}
        return cls.with_values(
            name, {each: value for each, value in values.items() if each not in usual or _plain(value) != usual[each]}
        )

    @classmethod
    def with_values(cls, name: str, values: Mapping[str, Any]) -> "EditStep":
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

    def apply(self, state: DocumentState) -> DocumentState:
        """Make the edit; returns the edited document.

        Raises:
            EditError: As `step` does.
            ValueError: As `step` does, and when the edit refuses, such as for a locked layer.
        """
        return self.step(state).applied_to(state)

    @property
    def title(self) -> str:
        """Name for people, such as "Delete selected"."""
        return self.name.replace("-", " ").capitalize()

    def step(self, state: DocumentState) -> Step:
        """Return the edit of a document as a step of its history, which is not made yet.

        Raises `EditError` for an unknown name or parameter, a missing one, or a value of another type; `ValueError` for
        an edit of a camera path that the scene lacks.
        """
        edit = all_edits().get(self.name)
        if edit is None:
            raise EditError(f"{self.name}: no such edit; there are {', '.join(all_edits())}")
        change, parameters = _named(edit.function), _parameters(edit)
        for name, parameter in parameters.items():
            if parameter.default is Parameter.empty and name not in self.arguments:
                raise EditError(f"{self.name}: needs {name}=...")
        hints = _hints(edit)
        if unknown := [name for name in self.arguments if name not in hints]:
            raise EditError(f"{self.name}: has no parameter {unknown[0]!r}; it takes {', '.join(hints) or 'none'}")
        values: dict[str, Any] = {}
        for name, value in self.arguments.items():
            try:
                values[name] = _converted(value, hints[name])
            except ValueError as error:
                raise EditError(f"{self.name}: {name}: {error}") from None
        if edit.kind == "path":
            if state.scene.path is None and self.name != "set-keyframe":
                raise ValueError("The scene has no camera path.")
            return Step(self.title, state, "scene", with_path, (change,), values)
        if edit.kind == "selection":
            mode = values.pop("mode", "set")
            return Step(self.title, state, "scene", select_found, (mode, change), values)
        return Step(self.title, state, edit.kind, change, (), values)


_PARAMETER = re.compile(r"([\w-]+)=")
_WORD = re.compile(r"(?!(true|false|null|NaN|Infinity)$)[A-Za-z][\w/.:-]*")


def document_of(scene: Scene) -> DocumentState:
    """Document of a scene with the rain that it was saved with; no rain if there is none."""
    return DocumentState(scene, rain_of(scene) or load_preset("clear"), keyframes_of(scene) or NO_KEYFRAMES)


def apply_steps(scene: Scene, steps: Iterable[EditStep]) -> Scene:
    """Apply steps one after another to a scene and its saved rain.

    Errors are those of `EditStep.apply`, and name the number of the step.
    """
    before = state = document_of(scene)
    for number, step in enumerate(steps, 1):
        try:
            state = step.apply(state)
        except EditError as error:
            raise EditError(f"step {number}: {error}") from None
        except ValueError as error:
            raise ValueError(f"step {number}, {step.name}: {error}") from None
    if state.rain == before.rain and state.keyframes == before.keyframes:
        return state.scene
    return with_rain_saved(state)


def with_rain_saved(state: DocumentState) -> Scene:
    """Scene of a document with its rain, as it is saved."""
    weather = msgspec.to_builtins(state.keyframes) if state.keyframes.keys else None
    return replace(state.scene, rain=msgspec.to_builtins(state.rain), weather=weather)


# Steps of the history as a program


def steps_since(history: History, saved: DocumentState) -> list[EditStep]:
    """Describe the steps from a document on disk to the present one.

    Raises `EditError` if that document is not an earlier one of the history, or a step can't be described.
    """
    steps = history.steps[: history.cursor + 1]
    first = next((number for number, step in enumerate(steps) if step.document is saved), None)
    if first is None:
        raise EditError("The present scene did not come from its file by these steps: save it first.")
    made = [EditStep.of(step) for step in steps[first + 1 :]]
    rain, on_disk = saved.rain, document_of(saved.scene).rain  # a preset of the window may be in place of the scene's
    fields = [name for name in rain.__struct_fields__ if getattr(rain, name) != getattr(on_disk, name)]
    chosen = EditStep.with_values("change-rain", {name: getattr(rain, name) for name in fields})
    return [chosen, *made] if fields else made


def shell_command(source: str, steps: Sequence[EditStep], output: str = "edited", then: str = "") -> str:
    """Format steps as a line for a shell, or with a here-document where they are too long for one.

    `then` is a command that follows if the edits have succeeded.
    """
    then = then and f" && {then}"
    line = shlex.join(["gsrain", "edit", source, *(step.text for step in steps), "-o", output])
    if len(line) < _LONGEST_LINE:
        return line + then
    texts = "\n".join(step.text for step in steps)
    line = shlex.join(["gsrain", "edit", source, "--steps", "-", "-o", output])
    return f"{line} <<'STEPS'{then}\n{texts}\nSTEPS"


def python_program(source: str, steps: Sequence[EditStep], last: str = "gr.save(scene, 'edited')") -> str:
    """Format steps as a program that uses the Python API; `last` is what it does with the edited scene."""
    lines = ["import gsrain as gr", "", f"scene = gr.load({source!r})", *(step.python for step in steps), last]
    return "\n".join(lines) + "\n"


_LONGEST_LINE = 100_000  # systems limit one argument to 128 KiB


class EditHelp(NamedTuple):
    """Description of an edit for users."""

    name: str
    parameters: str
    """Such as "key=... time_s=0.0"."""
    summary: str


def edit_help() -> Iterator[EditHelp]:
    """Describe all edits, in the order of `all_edits`."""
    for name, edit in all_edits().items():
        parameters, hints = _parameters(edit), _hints(edit)
        words = [_parameter_help(each) for each in parameters.values()]
        words += [f"[{each}=...]" for each in hints if each not in parameters]
        summary = (_named(edit.function).__doc__ or "").strip().partition("\n\n")[0]
        yield EditHelp(name, " ".join(words), " ".join(summary.split()))


def _parameter_help(parameter: Parameter) -> str:
    if parameter.default is Parameter.empty:
        return f"{parameter.name}=..."
    return f"[{parameter.name}={_text(_plain(parameter.default))}]"


# Functions and their parameters


@cache
def edit_function(name: str) -> Callable[..., Any]:
    """Function of an edit of `EDITS`, by its name."""
    return _named(EDITS[name].function)


def _named(place: str | Callable[..., Scene]) -> Any:
    if not isinstance(place, str):
        return place
    module, _, names = place.partition(":")
    found = import_module(f"gsrain_engine{module}" if module.startswith(".") else f"{__package__}.{module}")
    for each in names.split("."):
        found = getattr(found, each)
    return found


@cache
def _names() -> dict[Callable[..., Any], str]:
    return {edit_function(name): name for name in EDITS}


@cache
def _parameters(edit: Edit) -> dict[str, Parameter]:
    """Parameters of an edit by name, without the first, which it edits, and without further fields."""
    _, *rest = signature(_named(edit.function)).parameters.values()
    own = {each.name: each for each in rest if each.kind not in (Parameter.VAR_KEYWORD, Parameter.VAR_POSITIONAL)}
    if edit.kind != "selection":
        return own
    return {"mode": Parameter("mode", Parameter.KEYWORD_ONLY, default="set")} | own


@cache
def _hints(edit: Edit) -> dict[str, Any]:
    """Types of all parameters of an edit by name, further fields included."""
    hints = get_type_hints(_named(edit.function), include_extras=True) if _parameters(edit) else {}
    of_mode = {"mode": Literal["set", "add", "remove", "intersect"]}
    own = {name: (of_mode | hints)[name] for name in _parameters(edit)}
    return own if not edit.fields else own | get_type_hints(_named(edit.fields), include_extras=True)


# Values


def _plain(value: Any) -> Any:
    """Convert an argument to JSON values."""
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=_encoded))


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype == np.bool_:
        bits = base64.b64encode(zlib.compress(np.packbits(value).tobytes(), 9)).decode()
        return {"shape": value.shape, "bits": bits}
    return as_plain(value)


def _converted(value: Any, kind: Any) -> Any:
    """Convert JSON values to a type; of several structs or dataclasses, the first that fits."""
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    several = sum(is_dataclass(each) for each in kinds) > 1  # msgspec can't tell them apart
    for each in kinds[:-1] if several else ():
        with suppress(ValueError):
            return _converted(value, each)
    with jaxtyped("context"):  # named dimensions are those of this value alone
        return convert_checked(value, kinds[-1] if several else kind, dec_hook=_decoded)


def _decoded(kind: type, value: Any) -> Any:
    """Convert JSON values to a type that msgspec does not know: a path, or an array with its shape."""
    if kind is Path:
        return Path(value)
    if isinstance(value, dict):
        array = _mask(value)
    else:
        dtypes = getattr(kind, "dtypes", ())
        array = np.asarray(value, np.dtype(dtypes[0]) if dtypes else np.float64)
    if not isinstance(array, kind):
        raise ValueError(f"expected numbers of shape {getattr(kind, 'dim_str', '')}, got shape {array.shape}")
    return array


class _MaskRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An array of flags: packed bits, deflated, in base64."""

    shape: tuple[int, ...]
    bits: str


def _mask(value: dict[str, Any]) -> np.ndarray:
    record = msgspec.convert(value, _MaskRecord)
    count = int(np.prod(record.shape))
    if not 0 <= count <= _MAX_PIXELS:
        raise ValueError(f"expected at most {_MAX_PIXELS} flags, got shape {record.shape}")
    try:
        packed = zlib.decompressobj().decompress(base64.b64decode(record.bits, validate=True), count // 8 + 1)
    except (zlib.error, binascii.Error) as error:
        raise ValueError(f"bits are damaged: {error}") from None
    if len(packed) != -(-count // 8):
        raise ValueError(f"expected {count} flags, got {8 * len(packed)}")
    return np.unpackbits(np.frombuffer(packed, np.uint8), count=count).view(np.bool_).reshape(record.shape)


_MAX_PIXELS = 1 << 28


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
