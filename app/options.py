"""Options shared by several commands: made from settings, checked, and errors that name the option."""

import math
import os
import re
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, make_dataclass
from pathlib import Path
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import lazy_loader
from cyclopts import Parameter, Token, convert

from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.trusted_code import UntrustedCodeError, trust, trust_permanently

from .console import print

if TYPE_CHECKING:
    import msgspec
else:
    msgspec = lazy_loader.load("msgspec")  # every command imports this module


def option(help: str, *names: str, **settings: Any) -> Parameter:
    """Describe an option: its help, and its names if they are not that of the parameter."""
    return Parameter(name=names or None, help=help, **settings)


def flag(help: str) -> Parameter:
    """Describe an option without a value and without a negative."""
    return Parameter(help=help, negative="")


JsonFile = Annotated[Path | None, option("Write the reported numbers to this file.", "--json")]
JsonFileOrScreen = Annotated[
    Path | None, option("Write the numbers to this file; - prints them.", "--json", allow_leading_hyphen=True)
]
AllowOutside = Annotated[
    bool, flag("Read files that a capture's own files name outside of its folder: absolute, by .., or through links.")
]
Preset = Annotated[str | None, option("Rain preset (clear, 1.2, 8.5, 12.0, paper) or a preset file.")]
Exposure = Annotated[float | None, option("Shutter time in seconds; default: the camera's own.")]
Wet = Annotated[bool, option("Compute wet colors of the scene first, as the wet look of the window does.")]
RAIN = ("--rain", "--intensity")
"""Names of the options for intensities."""
BACKEND = option("Renderer; auto is OpenGL on a GPU, else the CPU.")


# Options made from settings

Settings = TypeVar("Settings")


@dataclass(frozen=True, kw_only=True)
class StructOptions:
    """Options of a command that set fields of a msgspec struct, under the names of these; None changes nothing."""

    kind: ClassVar[type]
    names: ClassVar[Mapping[str, str]] = {}
    """Options of a field, separated by spaces and without dashes, if its name is another; the first is the main one."""

    def changes(self) -> dict[str, Any]:
        """Return the values of the options that were set, by field."""
        own = [each.name for each in fields(self) if each.name in get_type_hints(self.kind)]
        values = {name: value for name in own if (value := getattr(self, name)) is not None}
        return {
            name: split_words(value) if isinstance(value, str) and _is_tuple(self.kind, name) else value
            for name, value in values.items()
        }

    def settings(self, base: Any = None, **values: Any) -> Any:
        """Return the struct: `base`, or its defaults, with the options set, and `values`.

        Raises ValueError, which names the option, for invalid ones.
        """
        plain = {} if base is None else msgspec.to_builtins(base)
        return converted_options(plain | self.changes() | values, self.kind, self.names)


def options_of(
    kind: type,
    only: str,
    names: Mapping[str, str] | None = None,
    help: Mapping[str, str] | None = None,
    default: str = "",
    types: Mapping[str, Any] | None = None,
) -> type[StructOptions]:
    """Make the options of a command from fields of a msgspec struct: types, help texts, bounds and defaults.

    Args:
        kind: The struct; `Meta` of its fields has the help text, the bounds and the unit.
        only: The fields, in the order of the help, separated by spaces.
        names: See `StructOptions.names`.
        help: Help texts that replace those of the struct.
        default: Sentence about the default for the help, such as "Default: {}."
        types: Types with a `Parameter` that replace those of the struct.
    """
    names, types = names or {}, types or {}
    hints, plain = get_type_hints(kind, include_extras=True), get_type_hints(kind)
    defaults = {each.name: each.default for each in msgspec.structs.fields(kind)}
    made: list[tuple[str, Any, Any]] = []
    for name in only.split():
        if name not in types:
            value = defaults[name]
            value = ",".join(value) if isinstance(value, tuple) else _number(value) if type(value) is float else value
            ending = "" if value is None or value is False or value == "" else default.format(value)
            text = (help or {}).get(name) or _help(hints[name]) + " Several with commas." * _is_tuple(kind, name)
            options = [f"--{each}" for each in names.get(name, name).replace("_", "-").split()]
            parameter = option(f"{text} {ending}".rstrip(), *options)
            made.append((name, Annotated[(str if _is_tuple(kind, name) else plain[name]) | None, parameter], None))
        else:
            made.append((name, types[name], None))
    made_class = make_dataclass(
        f"{kind.__name__}Options", made, bases=(StructOptions,), frozen=True, kw_only=True,
        namespace={"kind": kind, "names": names, "__doc__": f"Fields of {kind.__name__}.", "__module__": __name__},
    )  # fmt: skip
    return Parameter(name="*")(made_class)  # fields are options of the command, without a prefix


def _is_tuple(kind: type, name: str) -> bool:
    return get_origin(get_type_hints(kind)[name]) is tuple


def _help(hint: Any) -> str:
    """Return the help text of a field, with its bounds and unit."""
    meta = _meta(hint)
    extra = meta.extra or {}
    low, high = meta.ge if meta.ge is not None else extra.get("ge"), meta.le if meta.le is not None else extra.get("le")
    unit = f" {extra['unit']}" if "unit" in extra else ""
    if low is None or high is None or high > 1e6:
        return f"{meta.description}{unit and f' In{unit}.'}"
    return f"{meta.description} Range {_number(low)}..{_number(high)}{unit}."


def _number(value: float) -> str:
    return f"{value:f}".rstrip("0").rstrip(".")


def _meta(hint: Any) -> "msgspec.Meta":
    """Return the `Meta` with the description, at any depth of a type."""
    if get_origin(hint) in (Union, UnionType):
        return next(meta for each in get_args(hint) if each is not type(None) and (meta := _meta(each)) is not None)
    return next(each for each in reversed(hint.__metadata__) if isinstance(each, msgspec.Meta))


RAIN_OPTIONS = {"intensity_mm_h": "rain intensity", "exposure_s": "exposure", "closure": "drop-density"}
"""Options of `RainSettings`, by field; see `StructOptions.names`."""


def _drop_density(kind: Any, tokens: Sequence[Token]) -> str:
    values = {"flux": "density", "table": "published", "density": "density", "published": "published"}
    return values.get(tokens[0].value) or convert(kind, tokens)


DropDensity = Annotated[
    Literal["flux", "table"] | None,
    option(
        "Number of drops. flux: as many as the intensity needs; table: that of the calibration's table.",
        "--drop-density",
        converter=_drop_density,
    ),
]

# Conversion

_WORD = re.compile(r"\w+")
_PLACE = re.compile(r" - at `\$.*?(\w+)(\[[^\]]*\])*`$")


def converted_options(
    values: Mapping[str, Any], kind: type[Settings], names: Mapping[str, str] | None = None
) -> Settings:
    """Convert option values to a type known to msgspec. Raises ValueError, which names the option.

    `names` are those of `StructOptions.names`.
    """
    try:
        return convert_checked(values, kind)
    except msgspec.ValidationError as error:
        raise ValueError(option_error(str(error), values, names or {})) from None


def option_error(message: str, fields: Collection[str], names: Mapping[str, str]) -> str:
    """Return an error of msgspec that names options instead of fields."""

    def named(name: str) -> str:
        return f"--{names.get(name, name).split()[0].replace('_', '-')}"

    if place := _PLACE.search(message):
        return f"{named(place[1])}: {message[: place.start()]}"
    # Errors of a type's own checks name the fields: "last_s must be above first_s ..."
    return _WORD.sub(lambda word: named(word[0]) if word[0] in fields or word[0] in names else word[0], message)


def reject_non_finite(_kind: Any, value: Any) -> None:
    """Raise ValueError for NaN and infinity: no option accepts them.

    `value` is an option's value or a dataclass of options.
    """
    if is_dataclass(value):
        for each in fields(value):
            try:
                reject_non_finite(each.type, getattr(value, each.name))
            except ValueError as error:
                name = getattr(value, "names", {}).get(each.name, each.name).split()[0]
                raise ValueError(f"--{name.replace('_', '-')}: {error}") from None
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
    if not words or not all(re.fullmatch(r"\d*\.?\d+", word) and float(word) <= 100 for word in words):
        raise ValueError(f"{option} {text}: expected mm/h within 0..100 with commas between, such as 0,1.2,8.5,12")
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
        allowed = bounds.format(_number(low), _number(high)) + (unit and f" {unit}")
        raise ValueError(f"{option} {value:g}: must be {allowed}")


def let_names_lead_outside(allowed: bool) -> None:
    """Apply `AllowOutside` for the duration of the command."""
    if allowed:
        from gsrain_engine.datasets.capture import allow_outside  # only needed for captures

        allow_outside(allowed)


def has_display() -> bool:
    """Return True if a window can open; systems other than Linux always have a display."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


# Permission to run Python code that a file names, remembered by content hash

Trust = Annotated[
    bool,
    flag(
        "Run Python code that the file names (agents, programs of estimators) without asking. It can do all that you "
        "can, so read it first."
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
