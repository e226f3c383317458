"""Options shared by several commands: made from settings, checked, and errors that name the option."""

import inspect
import math
import os
import re
import sys
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, is_dataclass, make_dataclass, replace
from difflib import get_close_matches
from functools import wraps
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    ParamSpec,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import lazy_loader
from cyclopts import Group, Parameter, Token, convert

from gsrain_engine.choices import UNIT_M, Axis
from gsrain_engine.fields import Field, field_of, fields_of, number_text, option_names
from gsrain_engine.presets import shipped_config_names
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.safe_io.text_files import yaml_values
from gsrain_engine.trusted_code import UntrustedCodeError, trust, trust_permanently

from .console import print

if TYPE_CHECKING:
    import msgspec

    from gsrain_engine.scene.scene import Scene
else:
    msgspec = lazy_loader.load("msgspec")  # every command imports this module


TOPICS = (
    "Options", "Driver", "Scenario", "Method", "Detectors", "Output", "Camera and time", "Views", "Sensor", "Recording",
    "Service", "Training", "Rain", "Weather and road", "Sensor and glass", "More",
)  # fmt: skip
"""Headings of options in the help, in their order."""

_GROUPS = {topic: Group(topic, sort_key=place) for place, topic in enumerate(TOPICS)}
OPTIONS = _GROUPS["Options"]
"""Heading of options without a topic."""

_lists_all = ContextVar("lists_all", default=False)


class _OnlyInAll:
    """Visibility of an option that only `--help-all` lists."""

    def __bool__(self) -> bool:
        return _lists_all.get()

    def __xor__(self, other: bool) -> bool:  # cyclopts compares so
        return bool(self) ^ other


@contextmanager
def all_listed() -> Generator[None]:
    """List rare options in the help, too."""
    before = _lists_all.set(True)
    try:
        yield
    finally:
        _lists_all.reset(before)


def option(help: str, *names: str, topic: str = "", rare: bool = False, **settings: Any) -> Parameter:
    """Describe an option: its help, its names if they are not that of the parameter, and its heading in the help.

    A `rare` option is listed by --help-all only.
    """
    if topic:
        settings["group"] = _GROUPS[topic]
    if rare:
        settings["show"] = _OnlyInAll()
    return Parameter(name=names or None, help=help, **settings)


def flag(help: str, topic: str = "", *, rare: bool = False) -> Parameter:
    """Describe an option without a value and without a negative."""
    return option(help, topic=topic, rare=rare, negative="")


JsonFile = Annotated[Path | None, option("Write the reported numbers to this file.", "--json", topic="Output")]
JsonFileOrScreen = Annotated[
    Path | None,
    option("Write the numbers to this file; - prints them.", "--json", topic="Output", allow_leading_hyphen=True),
]
AllowOutside = Annotated[
    bool,
    flag(
        "Read files that a capture's own files name outside of its folder: absolute, by .., or through links.",
        "More",
    ),
]
Preset = Annotated[
    str | None,
    option(f"Rain preset, one of {', '.join(shipped_config_names('rain'))}, or a preset file.", topic="Rain"),
]
Wet = Annotated[
    bool | None,
    option(
        "A cloudy sky and a wet road in rain above 0.3 mm/h; computed once if the scene has no wet colors. "
        "--no-wet: dry and as lit. Default: wet where the scene has wet colors.",
        topic="Weather and road",
    ),
]
BACKEND = option("Renderer; auto is the fastest here: OpenGL on a GPU, else the CPU.", topic="More", rare=True)


# Options made from the field table

Settings = TypeVar("Settings")
Passed = ParamSpec("Passed")
Returned = TypeVar("Returned")


@dataclass(frozen=True, kw_only=True)
class StructOptions:
    """Options of a command that set fields of a settings struct, under the names of these; None changes nothing."""

    kind: ClassVar[type]
    fixed: ClassVar[Mapping[str, str]]
    """Fields that another option of the command sets, and that option."""

    assigned: Annotated[Mapping[str, Any], Parameter(parse=False)] = field(default_factory=dict)
    """Values of --set by field."""

    def changes(self) -> dict[str, Any]:
        """Return the values of the options that were set, and those of --set, by field."""
        found: dict[str, Any] = {}
        for each in fields_of(self.kind):
            if (value := getattr(self, each.name, None)) is not None:
                found |= _values(self.kind, each, value)
        return found | dict(self.assigned)

    def assigning(self, name: str, text: str) -> "StructOptions":
        """Return the options with a field set by --set.

        Raises ValueError, which names the field, for an invalid value and for a field that has another one already.
        """
        setting = field_of(self.kind, name)
        if name in self.changes():
            other = "--set" if name in self.assigned else setting.options[0]
            raise ValueError(f"--set {name}: {other} sets it, too")
        if name in self.fixed:
            raise ValueError(f"--set {name}: {self.fixed[name]} sets it here")
        kind = get_type_hints(self.kind, include_extras=True)[name]
        try:
            value = convert_checked(_assigned_value(setting, text), kind)
        except ValueError as error:
            raise ValueError(f"--set {name}: {error}{_unit_after(str(error), setting)}") from None
        return replace(self, assigned={**self.assigned, name: msgspec.to_builtins(value)})

    def settings(self, base: Any = None, **values: Any) -> Any:
        """Return the struct: `base`, or its defaults, with the options set, and `values`.

        Raises ValueError, which names the option, for invalid ones.
        """
        plain = {} if base is None else msgspec.to_builtins(base)
        return converted_options(plain | self.changes() | values, self.kind)


def options_of(
    kind: type,
    command: str = "",
    default: str = "Default: {}.",
    defaults: Mapping[str, str] | None = None,
    *,
    topic: str,
    names: Collection[str] = (),
    fixed: Mapping[str, str] | None = None,
) -> type[StructOptions]:
    """Make the options of a command from fields of a settings struct: those that list it in `commands`, or `names`.

    Args:
        kind: The struct; `gsrain_engine.fields` describes its metadata.
        command: Name of the command, such as `render` or `evaluate lidar`.
        default: Sentence about the default for the help; {} is the struct's.
        defaults: Defaults of this command by field, as text.
        topic: Heading in the help of fields without one of their own.
        names: Names of the fields, in place of those that list the command.
        fixed: Fields that another option of the command sets, and that option: --set refuses them.
    """
    made: dict[tuple[str, ...], tuple[Any, ...]] = {}
    for each in fields_of(kind):
        if each.name in names or command in each.commands:
            text = (defaults or {}).get(each.name, _spelled(each, each.default_text))
            has_ending = (text or "{}" not in default) and "on" not in each.extra
            ending = default.format(text) if has_ending else ""
            described = setting(kind, each.name, ending, topic, rare=each.is_rare(command))
            annotated = Annotated[_option_type(kind, each) | None, described]
            is_required = each.default is msgspec.NODEFAULT and "{}" in default  # else a file has it
            made.setdefault(each.options, (each.name, annotated) if is_required else (each.name, annotated, None))
    made_class = make_dataclass(
        f"{kind.__name__}Options", made.values(), bases=(StructOptions,), frozen=True, kw_only=True,
        namespace={"kind": kind, "fixed": fixed or {}, "__doc__": f"{kind.__name__}.", "__module__": __name__},
    )  # fmt: skip
    return Parameter(name="*")(made_class)  # fields are options of the command, without a prefix


def setting(
    kind: type, name: str, ending: str = "", topic: str = "", *, rare: bool = False, text: str = ""
) -> Parameter:
    """Describe an option that sets a field of a struct: its names and its help, followed by `ending`.

    `text` takes the place of the help. Its heading is the field's own, else `topic`.
    """
    field = field_of(kind, name)
    sharing, is_text = _sharing(kind, field), _option_type(kind, field) is str
    form = "Several with commas." if is_text and any(each.item is not None for each in sharing) else ""
    form = "As WIDTHxHEIGHT." if field.is_size else form
    text = text or " ".join(filter(None, (*(each.described for each in sharing), form, ending)))
    more: dict[str, Any] = {"negative": ""} if _is_struct(field.item) else {}
    return option(text, *field.options, topic=field.extra.get("topic", topic), rare=rare, **more)


def takes_set(command: Callable[Passed, Returned]) -> Callable[Passed, Returned]:
    """Add the option --set to a command, for all fields of the structs whose options it has."""
    hints = get_type_hints(command).items()
    kinds = {place: kind for place, hint in hints for kind in (hint, *get_args(hint)) if _is_struct_options(kind)}

    @wraps(command)
    def run(*args: Any, set: list[str] | None = None, **options: Any) -> Any:
        for word in set or ():
            name, is_there, text = word.partition("=")
            if not is_there:
                raise ValueError(f"--set {word}: expected NAME=VALUE, such as --set roughness_m=0.03")
            place, name = _place_of(name.strip(), kinds)
            options[place] = (options.get(place) or kinds[place]()).assigning(name, text.strip())
        return command(*args, **options)

    fields_of_all = [each for kind in kinds.values() for each in fields_of(kind.kind)]
    others = [each.name for each in fields_of_all if not each.commands and each.kind in (int, float)]
    example = f", also one without an option, such as {others[0]}" if others else ""
    help_text = f"NAME=VALUE sets any field of the settings{example}. May be given several times."
    annotation = Annotated[list[str] | None, option(help_text, "--set", topic="More", negative="")]
    signature = inspect.signature(command)
    added = inspect.Parameter("set", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
    run.__signature__ = signature.replace(parameters=[*signature.parameters.values(), added])  # pyright: ignore
    run.__annotations__ = {**command.__annotations__, "set": annotation}
    return cast("Callable[Passed, Returned]", run)


def _place_of(name: str, kinds: Mapping[str, type[StructOptions]]) -> tuple[str, str]:
    """Return parameter and field of a name, `field` or `parameter.field`. Raises ValueError if that is not one."""
    found: dict[type, tuple[str, str]] = {}  # of two parameters of one struct that with an option, or the first
    like: dict[str, str] = {}
    for place, options in kinds.items():
        for each in fields_of(options.kind):
            is_first = options.kind not in found or hasattr(options, each.name)
            if is_first and name in (each.name, f"{place}.{each.name}"):
                found[options.kind] = place, each.name
            like |= {each.name: each.name} | {option.lstrip("-"): each.name for option in each.options}
    if len(found) > 1:
        raise ValueError(f"--set {name}: it is {' or '.join(map('.'.join, found.values()))}")
    if not found:
        near = get_close_matches(name, like, 1)
        hint = f"did you mean {like[near[0]]}?" if near else "gsrain schema lists the fields of each kind"
        raise ValueError(f"--set {name}: no such setting; {hint}")
    return next(iter(found.values()))


def _is_struct_options(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, StructOptions)


def _assigned_value(field: Field, text: str) -> Any:
    """Return the value of --set: words as they are, lists with brackets or without, and else YAML."""
    if field.is_optional and text == "none" and "none" not in field.choices:
        return None
    if field.kind in (str, Path) or field.choices:
        return text
    if get_origin(field.kind) is tuple and not text.startswith("["):
        text = f"[{text}]"
    value = yaml_values(text.encode())
    return as_number(value) if isinstance(value, str) else value  # YAML 1.1 reads 1e-3 as a word


def _sharing(kind: type, field: Field) -> list[Field]:
    """Return the fields that an option sets: one; or two, of which the first takes a number and the other words."""
    return [each for each in fields_of(kind) if each is field or (each.commands and each.options == field.options)]


def _option_type(kind: type, field: Field) -> Any:
    """Return the type that the command line converts an option to."""
    if "spelling" in field.extra:
        return Literal[tuple(field.extra["spelling"])]
    if "on" in field.extra:
        return bool
    if _is_struct(field.item):
        return list[Path]
    if field.item is not None or field.is_size or len(_sharing(kind, field)) > 1:
        return str
    return Path if field.is_path else field.kind


def _values(kind: type, field: Field, value: Any) -> dict[str, Any]:
    """Return the values of the fields that an option sets."""
    for words in _sharing(kind, field)[1:]:
        number = {field.name: int(value), words.name: ()} if value.isdecimal() else None
        return number or {words.name: split_words(value)}
    if "on" in field.extra:
        return {field.name: field.extra["on"]} if value else {}
    if _is_struct(field.item):
        value = [{"path": str(each)} for each in value]
    elif field.item is not None:
        value = [as_number(each) if field.item is float else each for each in split_words(value)]
    elif field.is_size:
        value = parse_size(value, field.options[0])
    elif "spelling" in field.extra:
        value = field.extra["spelling"][value]
    elif field.kind is str:
        value = str(value)  # of a path
    return {field.name: value}


def _spelled(field: Field, value: str) -> str:
    """Return the word of the command line for a value, if it has another one."""
    spelling = field.extra.get("spelling", {})
    return next((word for word, meant in spelling.items() if meant == value), value)


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def as_number(word: str) -> float | str:
    """Return a number, or the word itself, which the conversion refuses with the name of the option."""
    try:
        return float(word)
    except ValueError:
        return word


# Conversion

_WORD = re.compile(r"\w+")
_PLACE = re.compile(r" - at `\$.*?(\w+)(\[[^\]]*\])*`$")


def converted_options(values: Mapping[str, Any], kind: type[Settings]) -> Settings:
    """Convert option values to a type known to msgspec. Raises ValueError, which names the option."""
    try:
        return convert_checked(values, kind)
    except msgspec.ValidationError as error:
        raise ValueError(option_error(str(error), kind)) from None


def option_error(message: str, kind: type) -> str:
    """Return an error of msgspec that names options instead of fields."""
    names = option_names(kind)
    if place := _PLACE.search(message):
        option, said = names.get(place[1]) or f"--set {place[1]}", message[: place.start()]
        units = (_unit_after(said, each) for each in fields_of(kind) if each.name == place[1])
        return f"{option}: {said}{next(units, '')}"
    # Errors of a type's own checks name the fields: "last_s must be above first_s ..."
    return _WORD.sub(lambda word: names.get(word[0], word[0]), message)


def _unit_after(said: str, field: Field) -> str:
    """Unit of a bound that an error about a field ends with."""
    return f" {field.unit}" if field.unit and " must be at " in said else ""


@contextmanager
def named_options(kind: type, *arguments: str) -> Generator[None]:
    """Let errors that begin with a setting of `kind`, or with one of some arguments, begin with its option."""
    try:
        yield
    except ValueError as error:
        word = re.match(r"\w+", str(error))
        names = {name: f"--{name}" for name in arguments} | option_names(kind)
        if word is None or word[0] not in names:
            raise
        raise ValueError(names[word[0]] + str(error)[word.end() :]) from None


def reject_non_finite(_kind: Any, value: Any) -> None:
    """Raise ValueError for NaN and infinity: no option accepts them.

    `value` is an option's value or a dataclass of options.
    """
    if is_dataclass(value):
        for each in fields(value):
            try:
                reject_non_finite(each.type, getattr(value, each.name))
            except ValueError as error:
                names = option_names(value.kind) if isinstance(value, StructOptions) else {}
                option = names.get(each.name) or f"--{each.name.replace('_', '-')}"
                raise ValueError(f"{option}: {error}") from None
    elif isinstance(value, list | tuple):
        for each in value:
            reject_non_finite(_kind, each)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError("Expected a finite number.")


def parse_whole_numbers(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert words as cyclopts does, but raise ValueError for 1.5 as an integer instead of rounding."""
    for token in tokens if int in (kind, *get_args(kind)) else ():
        if "." in token.value:
            raise ValueError(f"{token.keyword} {token.value}: expected a whole number")
    return convert(kind, tokens)


def parse_size(text: str, option: str = "--size") -> tuple[int, int]:
    """Turn "960x640" into (960, 640)."""
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(1 <= side <= 16384 for side in size):
        raise ValueError(f"{option} {text}: expected WIDTHxHEIGHT with both within 1..16384, such as 960x640")
    return size


def parse_intensities(text: str, option: str = "--rain") -> list[float]:
    """Turn "8.5,0" into [0.0, 8.5], in mm/h."""
    words = split_words(text)
    if not words or not all(re.fullmatch(r"\d*\.?\d+", word) and float(word) <= 149 for word in words):
        raise ValueError(f"{option} {text}: expected mm/h within 0..149 with commas between, such as 0,1.2,8.5,12")
    return sorted({float(word) for word in words})


def split_words(text: str) -> list[str]:
    """Split at commas, without empty words."""
    return [word.strip() for word in text.split(",") if word.strip()]


def split_list(option: str, text: str) -> list[str]:
    """Split at commas and drop duplicates. Raises ValueError for an empty word."""
    words = list(dict.fromkeys(word.strip() for word in text.split(",")))
    if not all(words):
        raise ValueError(f"{option} {text!r}: expected values with single commas between")
    return words


def check_within(
    option: str, value: float | None, low: float, high: float, unit: str = "", *, is_open: bool = False
) -> None:
    """Raise ValueError, which names the option, for a value out of bounds; None is ignored.

    With `is_open`, `low` itself is not allowed.
    """
    if value is not None and (not low <= value <= high or (is_open and value == low)):
        bounds = "above {} and at most {}" if is_open else "within {}..{}"
        allowed = bounds.format(number_text(low), number_text(high)) + (unit and f" {unit}")
        raise ValueError(f"{option} {value:g}: must be {allowed}")


def let_names_lead_outside(allowed: bool) -> None:
    """Apply `AllowOutside` for the duration of the command."""
    if allowed:
        from gsrain_engine.datasets.capture import allow_outside  # only needed for captures

        allow_outside(allowed)


@Parameter(name="*")  # fields are options of the command, without a prefix
@dataclass(frozen=True, kw_only=True)
class Orientation:
    """Options about axes and units, which Gaussian files don't store."""

    up: Annotated[
        Axis | None,
        option(
            "Axis of the scene that points up; default for Gaussian files: -y. convert turns a single file by it.",
            topic="More",
            allow_leading_hyphen=True,
        ),
    ] = None
    meters_per_unit: Annotated[float | None, option("Length of one scene unit in meters.", topic="More")] = None

    def __post_init__(self) -> None:
        check_within("--meters-per-unit", self.meters_per_unit, *UNIT_M)

    def of(self, scene: "Scene") -> "Scene":
        """Return the scene in the chosen orientation; rotating it drops its ground height."""
        from gsrain_engine.editor.edits.level import oriented

        return oriented(scene, self.up, self.meters_per_unit)


def window_problem() -> str:
    """Reason why no window can open here, in a few words; empty if one can."""
    has_screen = sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return "" if has_screen else "no display"


# Permission to run Python code that a file names, remembered by content hash

Trust = Annotated[
    bool,
    flag(
        "Run Python code that the file names (agents, programs of estimators) without asking. It can do all that you "
        "can, so read it first.",
        "More",
    ),
]


def with_trust(load: Callable[[], Settings], is_trusted: bool) -> Settings:
    """Return the result of `load`, asking for permission if it meets Python code that is not trusted yet.

    With `is_trusted` the code may run this time. Otherwise the program asks in the terminal, and remembers a yes for
    exactly this content. Raises `UntrustedCodeError` without a terminal, or if the answer is no.
    """
    try:
        return load()
    except UntrustedCodeError as error:
        if is_trusted:
            trust(each.digest for each in error.codes)
        elif _is_allowed(error):
            trust_permanently(error.codes)
        else:
            raise
    return load()


def _is_allowed(error: UntrustedCodeError) -> bool:
    if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)):  # pyright: ignore
        return False
    print(f"{error.named_by} names Python code, which would run with all your rights:", file=sys.stderr)
    for code in error.codes:
        others = ", ".join(code.others[:4]) + (f" and {len(code.others) - 4} more" if len(code.others) > 4 else "")
        print(f"  {code.path} (SHA-256 {code.digest}){others and f', with {others}'}", file=sys.stderr)
    print("Run it? The answer is remembered for exactly this content. [y/N]", file=sys.stderr)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
