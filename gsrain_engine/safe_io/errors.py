"""Errors in one sentence: of unreadable files, missing inputs, and msgspec's, extended by the allowed values."""

import difflib
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader

from .text_files import check_finite, printable_line

if TYPE_CHECKING:
    import msgspec
else:
    msgspec = lazy_loader.load("msgspec")  # every command imports this module

_LONGEST = 3000  # maximum characters of a message: the settings of a training have some forty fields
_LONGEST_VALUE = 300  # maximum characters of msgspec's own words, which quote the wrong value
_PLACE = re.compile(r" - at `\$(.*)`$")
_STEP = re.compile(r"\.([^.\[]+)|\[[^\]]*\]")
_WRONG_WORD = re.compile(r"Invalid (?:enum )?value ")
_OTHER_TYPE = re.compile(r"Expected `([a-z]+(?: \| [a-z]+)*)`, got `([a-z]+)`$")
_TYPES = {
    "object": "an object of named fields", "array": "a list", "str": "text", "int": "a whole number",
    "float": "a number", "bool": "true or false", "null": "nothing (null)",
}  # fmt: skip
"""Types of JSON by msgspec's names."""

_OUT_OF_BOUNDS = re.compile(r"Expected `(?:int|float)` (<=|>=|<|>) (\S+)$")
_HUGE = 1e15  # numbers that are not written out
_BOUNDS = {"<=": "at most", ">=": "at least", "<": "below", ">": "above"}
_NO_FIELD = re.compile(r"Object contains unknown field `(.*?)`")


class SceneFormatError(ValueError):
    """Error of an unreadable scene file; the message names the file, the field and the expected value."""

    def __init__(self, path: Path | str, problem: str) -> None:
        super().__init__(f"{printable_line(path)}: {printable_line(problem)}")
        self.path = Path(path)
        self.problem = problem


def sentence_of(error: BaseException) -> str:
    """Message of an error; of an OSError without its number, and with the file first."""
    if isinstance(error, OSError) and error.strerror is not None:
        return error.strerror if error.filename is None else f"{printable_line(error.filename)}: {error.strerror}"
    return str(error) or type(error).__name__


class MissingInputsError(ValueError):
    """Error that lists every missing input of a command, so that one attempt names all."""

    def __init__(self, missing: Sequence[str]) -> None:
        """Take a line for each missing input, with how to get it; equal ones count once."""
        self.missing = tuple(dict.fromkeys(missing))
        super().__init__("; ".join(self.missing))


def not_found(find: Callable[..., object], *arguments: object) -> list[str]:
    """Return why a function that looks for a file does not find it, as a list of one line; empty if it does."""
    try:
        find(*arguments)
    except FileNotFoundError as error:
        return [str(error)]
    return []


def readable_validation_error(error: Exception, kind: Any, values: Any = None) -> str:
    """Return the message of a failed `msgspec.convert(..., kind)`, extended by the allowed values.

    `Invalid value 'brak' - at $.behaviour.kind` becomes `Invalid value 'brak', expected brake, cut-in, ... - at ...`;
    a number out of bounds becomes `500 must be at most 149 - at ...`;
    an unknown field gets the most similar field and a list of all; types get plain names. `values` is the input of the
    conversion: if several tagged objects are possible at a position, the message lists the fields of the tagged one
    only.
    """
    message = " ".join(str(error).split())
    place = _PLACE.search(message)
    steps = [match[1] or "" for match in _STEP.finditer(place[1])] if place else []
    said = printable_line(message if place is None else message[: place.start()], _LONGEST_VALUE)
    found = _NO_FIELD.match(said)
    other = _OTHER_TYPE.match(said)
    if other is not None:
        types, actual = ([_TYPES.get(name, name) for name in names.split(" | ")] for names in other.groups())
        said = f"Expected {' or '.join(types)}, got {actual[0]}"
    bound = _OUT_OF_BOUNDS.match(said)
    if bound is not None:
        value = _at(values, place[1]) if place else values
        given = f"{value:g} " if isinstance(value, int | float) and abs(value) < _HUGE else ""
        said = f"{given}must be {_BOUNDS[bound[1]]} {float(bound[2]):g}"
    if _WRONG_WORD.match(said):
        words = list(dict.fromkeys(_words(_types(kind, steps[:-1]), steps[-1] if steps else "")))
        said += f", expected {', '.join(words)}" if words else ""
    elif found is not None:
        fields = list(dict.fromkeys(_fields(_types(kind, steps), _at(values, place[1] if place else ""))))
        like = difflib.get_close_matches(found[1], fields, n=1)
        said += f"; did you mean `{like[0]}`?" if like else ""
        said += f"{'' if like else ';'} valid: {', '.join(fields)}" if fields else ""
    return said + (message[place.start() :] if place else "")


def _fields(types: "list[msgspec.inspect.Type]", value: Any) -> Iterator[str]:
    """Fields that an object can have at a position; for tagged objects, only those of the tag in `value`."""
    objects = [each for each in types if isinstance(each, msgspec.inspect.StructType | msgspec.inspect.DataclassType)]
    tagged = [each for each in objects if isinstance(each, msgspec.inspect.StructType) and each.tag_field is not None]
    if isinstance(value, dict):
        own = [each for each in tagged if value.get(each.tag_field) == each.tag]  # pyright: ignore[reportUnknownMemberType]
        objects = own or objects
    for each in objects:
        if isinstance(each, msgspec.inspect.StructType) and each.tag_field is not None:
            yield each.tag_field
        yield from (field.encode_name for field in each.fields)


def _at(values: Any, place: str) -> Any:
    """Return the value at a position such as `.rain` or `.agents[0]`; None if there is none."""
    for match in _STEP.finditer(place):
        try:
            values = values[match[1]] if match[1] else values[int(match[0][1:-1])]
        except (KeyError, IndexError, TypeError, ValueError):
            return None
    return values


def _types(kind: Any, steps: list[str]) -> "list[msgspec.inspect.Type]":
    """All types possible at a position: a step is a field name, or empty for a member of a sequence."""
    here = list(_choices(msgspec.inspect.type_info(kind)))
    for step in steps:
        here = [choice for each in here for inner in _inside(each, step) for choice in _choices(inner)]
    return here


def _choices(found: "msgspec.inspect.Type") -> "Iterator[msgspec.inspect.Type]":
    if isinstance(found, msgspec.inspect.Metadata):
        yield from _choices(found.type)
    elif isinstance(found, msgspec.inspect.UnionType):
        for each in found.types:
            yield from _choices(each)
    else:
        yield found


def _inside(found: "msgspec.inspect.Type", step: str) -> "Iterator[msgspec.inspect.Type]":
    if isinstance(found, msgspec.inspect.StructType | msgspec.inspect.DataclassType):
        yield from (field.type for field in found.fields if field.encode_name == step)
    elif isinstance(found, msgspec.inspect.ListType | msgspec.inspect.SetType | msgspec.inspect.VarTupleType):
        yield found.item_type
    elif isinstance(found, msgspec.inspect.TupleType):
        yield from found.item_types
    elif isinstance(found, msgspec.inspect.DictType):
        yield found.value_type


def _words(around: "list[msgspec.inspect.Type]", name: str) -> Iterator[str]:
    """Allowed values of a field: tags of the enclosing structs, or members of the field's own type."""
    for each in around:
        if isinstance(each, msgspec.inspect.StructType) and each.tag_field == name:
            yield str(each.tag)
        for inner in _inside(each, name):
            for choice in _choices(inner):
                if isinstance(choice, msgspec.inspect.LiteralType):
                    yield from map(str, choice.values)
                elif isinstance(choice, msgspec.inspect.EnumType):
                    yield from (str(member.value) for member in choice.cls)


def convert_checked(values: Any, kind: Any, **options: Any) -> Any:
    """Convert plain values to a type that msgspec supports.

    Raises msgspec.ValidationError (a ValueError) with the position and the allowed values, ValueError for NaN or
    infinity.
    """
    check_finite(values)
    try:
        return msgspec.convert(values, kind, **options)
    except msgspec.ValidationError as error:
        raise msgspec.ValidationError(
            printable_line(readable_validation_error(error, kind, values), _LONGEST)
        ) from None
