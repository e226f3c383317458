"""The field table: declarations of settings, for forms, command-line options, documentation and JSON schemas.

A setting is one field of a `msgspec.Struct`, and `Meta` has its title, description and bounds; those of a number that
may be None, or of the numbers in a tuple, are in a `Meta` of their own around `float` or `int`. `extra` has the rest:

* `unit`
* `none`: label of None; `usual`: first value when None is switched off
* `group`: heading of the form under which it is drawn; `scale` "log" or `slider_to`: course and end of its slider
* `commands`: commands, separated by commas, of which it is an option; with a * only --help-all lists it
* `option`: names of the option separated by spaces, if it is not named like the field without its unit; `topic`: its
  heading in the help, if it is not that of the struct's options
* `spelling`: words of the option for the values of a choice; `titles`: words of the form for them
* `on`: value that an option without a value sets; `path`: the text is a path; `negative`: value that the option sets
  with --no- before its name
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import lazy_loader

if TYPE_CHECKING:
    import msgspec
else:
    msgspec = lazy_loader.load("msgspec")  # every command imports this module

_UNIT = re.compile(r"_(mm_h|m_s|px|mm|mb|m|s)$")
_UNBOUNDED = 1e6  # bounds above are technical, and not worth a word


@dataclass(frozen=True, kw_only=True)
class Field:
    """One setting."""

    name: str
    kind: Any
    """Type without None and without metadata."""
    is_optional: bool
    default: Any
    """`msgspec.NODEFAULT` for a required setting."""
    title: str
    help: str
    unit: str
    bounds: tuple[float | None, float | None]
    is_open: tuple[bool, bool]
    """True for a bound that is not allowed itself."""
    multiple_of: int
    extra: Mapping[str, Any]

    @property
    def label(self) -> str:
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def low(self) -> float:
        """Lower end of a slider."""
        return 0.0 if self.bounds[0] is None else self.bounds[0]

    @property
    def high(self) -> float:
        """Upper end of a slider."""
        return 1.0 if self.bounds[1] is None else self.bounds[1]

    @property
    def choices(self) -> tuple[str, ...]:
        """Values of a choice between words."""
        return tuple(each for each in get_args(self.kind) if isinstance(each, str))

    def choice_title(self, value: str) -> str:
        """Return the words of a form for a value of a choice."""
        return self.extra.get("titles", {}).get(value, value)

    @property
    def none(self) -> str | None:
        """Label of None for an optional number; None for other settings."""
        return str(self.extra.get("none", "none")) if self.is_optional and self.kind in (int, float) else None

    @property
    def initial(self) -> float:
        """Value of an optional number when it is switched on."""
        return self.extra.get("usual", self.default if isinstance(self.default, int | float) else self.low)

    @property
    def group(self) -> str:
        """Heading of the form under which it is drawn; "" for none."""
        return self.extra.get("group", "")

    @property
    def slider_high(self) -> float:
        """Upper end of a slider that leaves rare values to the keyboard."""
        return self.extra.get("slider_to", self.high)

    @property
    def is_logarithmic(self) -> bool:
        """True for a slider with a logarithmic scale."""
        return self.extra.get("scale") == "log"

    @property
    def item(self) -> Any:
        """Type of the values in a tuple of any length; None for other settings."""
        args = get_args(self.kind)
        return _unwrapped(args[0])[0] if get_origin(self.kind) is tuple and args[1:] == (...,) else None

    @property
    def is_size(self) -> bool:
        """True for a width and a height."""
        return get_origin(self.kind) is tuple and self.unit == "px"

    @property
    def is_path(self) -> bool:
        """True for the name of a file or folder."""
        return self.kind is Path or "path" in self.extra

    @property
    def range(self) -> str:
        """Bounds with their unit, such as `0..100 mm/h`; "" if one is missing."""
        low, high = self.bounds
        if low is None or high is None or high > _UNBOUNDED:
            return ""
        above, below = ("above " * self.is_open[0], "below " * self.is_open[1])
        return f"{above}{number_text(low)}..{below}{number_text(high)} {self.unit}".rstrip()

    @property
    def allowed(self) -> str:
        """Bounds as words of an error, such as `within 0..100 mm/h` or `above 0`."""
        low, high = (None if each is None else number_text(each) for each in self.bounds)
        above, below = ("above " * self.is_open[0], "below " * self.is_open[1])
        if low is None or high is None:
            words = f"{above or 'at least '}{low}" if high is None else f"{below or 'at most '}{high}"
        else:
            words = f"{'' if above else 'within '}{above}{low}..{below}{high}"
        return f"{words} {self.unit}".rstrip()

    @property
    def described(self) -> str:
        """Help text with bounds and unit, or with the value that an option without one sets."""
        if "on" in self.extra:
            return f"{self.help} Sets {self.extra['on']}."
        if "negative" in self.extra:
            return f"{self.help} --no-{self.options[0][2:]} sets {self.extra['negative']}."
        if self.range:
            return f"{self.help} Range {self.range}.".lstrip()
        return f"{self.help} In {self.unit}.".lstrip() if self.unit else self.help

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the command-line option, the main one first."""
        words = self.extra.get("option", _UNIT.sub("", self.name).replace("_", "-")).split()
        return tuple(f"--{word}" if len(word) > 1 else f"-{word}" for word in words)

    @property
    def commands(self) -> tuple[str, ...]:
        """Commands of the program that have the option."""
        return tuple(each.rstrip("*") for each in self._commands)

    def is_rare(self, command: str) -> bool:
        """True for an option of a command that only --help-all lists."""
        return f"{command}*" in self._commands

    @property
    def _commands(self) -> list[str]:
        return [each.strip() for each in self.extra.get("commands", "").split(",") if each]

    def value_text(self, value: Any) -> str:
        """Return a value without its unit, as a person writes it: at most four digits, on and off, words for None."""
        if value is None:
            return str(self.none or self.extra.get("none", "none"))
        if isinstance(value, bool):
            return "on" if value else "off"
        return number_text(float(f"{value:.4g}")) if isinstance(value, float) else str(value)

    @property
    def default_text(self) -> str:
        """Default as text; "" for none, off and a required setting."""
        value = self.default
        if value is None or value is False or value == () or value is msgspec.NODEFAULT:
            return ""
        if isinstance(value, msgspec.Struct):
            return "its own defaults"
        words = value if isinstance(value, tuple) else (value,)
        return ",".join(number_text(each) if isinstance(each, float) else str(each) for each in words)


@cache
def fields_of(kind: type["msgspec.Struct"]) -> tuple[Field, ...]:
    """Return the settings of a struct in their order."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(_read(each, hints[each.name]) for each in msgspec.structs.fields(kind))


@cache
def field_of(kind: type["msgspec.Struct"], name: str) -> Field:
    """Return one setting of a struct."""
    return next(each for each in fields_of(kind) if each.name == name)


def option_names(kind: Any) -> dict[str, str]:
    """Return the main option of each setting that has one, also of structs inside, by the name of the field."""
    names: dict[str, str] = {}
    for struct in structs_of(kind):
        for each in fields_of(struct):
            if "option" in each.extra or each.commands:
                names.setdefault(each.name, each.options[0])
    return names


def option_words(settings: "msgspec.Struct", command: str) -> list[str]:
    """Return the options of a command that make these settings of the default ones; required settings are left out."""
    words: list[str] = []
    for each in fields_of(type(settings)):
        value: Any = getattr(settings, each.name)
        if command not in each.commands or each.default is msgspec.NODEFAULT or value == each.default:
            continue
        option = each.options[-1]
        if isinstance(value, bool):
            words.append(option if value else f"--no-{option[2:]}")
        else:
            values = value if isinstance(value, tuple) else (value,)
            words += [option, ("x" if each.is_size else ",").join(map(str, values))]
    return words


def structs_of(kind: Any) -> Iterator[type["msgspec.Struct"]]:
    """Yield a type, if it is a struct, and all structs inside of it, each once, the outer one first."""
    found: dict[type[msgspec.Struct], None] = {}
    _collect(kind, found)
    yield from found


def _collect(kind: Any, found: dict[type["msgspec.Struct"], None]) -> None:
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        if kind not in found:
            found[kind] = None
            for each in fields_of(kind):
                _collect(each.kind, found)
    elif get_origin(kind) is not Literal:
        for each in get_args(kind):
            _collect(each, found)


def schema_of(kind: Any) -> dict[str, Any]:
    """Return the JSON schema of a settings file, with titles, descriptions, bounds, defaults and units (`x-unit`)."""
    schema = msgspec.json.schema(kind, schema_hook=lambda _: {"type": "string"})
    for struct in structs_of(kind):
        properties = schema["$defs"][struct.__name__]["properties"]
        for each in fields_of(struct):
            if each.unit:
                properties[each.name]["x-unit"] = each.unit
    return schema


def number_text(number: float) -> str:
    """Return a number as a person writes it: 30 and 0.00001, not 30.0 and 1e-05."""
    return f"{number:.10f}".rstrip("0").rstrip(".")


def short_number(number: float, digits: int = 3) -> str:
    """Return a finite number in a few digits, with all of those before the point: 65,960, 0.918 and 0.00005."""
    if abs(number) >= 10 ** (digits - 1):
        return f"{number:,.0f}"
    return number_text(float(f"{number:.{digits}g}")) or "0"


def _read(field: Any, hint: Any) -> Field:
    kind, metas = _unwrapped(hint)
    extra = {key: value for meta in reversed(metas) for key, value in (meta.extra or {}).items()}
    bounding = metas
    if get_origin(kind) is tuple:
        members = [_unwrapped(each) for each in get_args(kind)]
        kind, bounding = tuple[tuple(each for each, _ in members)], members[0][1]
    return Field(
        name=field.name, kind=kind, is_optional=_takes_none(hint), default=field.default,
        title=_first(metas, "title") or field.name, help=_first(metas, "description") or "",
        unit=extra.get("unit", ""), extra=extra, multiple_of=int(_first(metas, "multiple_of") or 1),
        bounds=(_bound(bounding, "ge", "gt"), _bound(bounding, "le", "lt")),
        is_open=(_first(bounding, "gt") is not None, _first(bounding, "lt") is not None),
    )  # fmt: skip


def _unwrapped(hint: Any) -> tuple[Any, list["msgspec.Meta"]]:
    """Return a type without None and metadata, and its metadata, the outermost first."""
    metas: list[msgspec.Meta] = []
    while True:
        if get_origin(hint) is Annotated:
            metas += [each for each in reversed(hint.__metadata__) if isinstance(each, msgspec.Meta)]
            hint = hint.__origin__
        elif get_origin(hint) in (Union, UnionType) and NoneType in get_args(hint):
            hint = Union[tuple(each for each in get_args(hint) if each is not NoneType)]  # noqa: UP007
        else:
            return hint, metas


def _takes_none(hint: Any) -> bool:
    if get_origin(hint) is Annotated:
        return _takes_none(hint.__origin__)
    return get_origin(hint) in (Union, UnionType) and NoneType in get_args(hint)


def _first(metas: list["msgspec.Meta"], name: str) -> Any:
    return next((value for each in metas if (value := getattr(each, name)) is not None), None)


def _bound(metas: list["msgspec.Meta"], closed: str, open: str) -> float | None:
    bound = _first(metas, closed)
    return _first(metas, open) if bound is None else bound
