"""What msgspec says of a wrong value, with what would be right: the kinds, words and fields that a type has there."""

import difflib
import re
from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import inspect

from .plain_values import check_finite
from .printable import printable

_PLACE = re.compile(r" - at `\$(.*)`$")
_STEP = re.compile(r"\.([^.\[]+)|\[[^\]]*\]")
_WRONG_WORD = re.compile(r"Invalid (?:enum )?value ")
_NO_FIELD = re.compile(r"Object contains unknown field `(.*?)`")


def explained(error: Exception, kind: Any) -> str:
    """Return an error of `msgspec.convert(..., kind)` with the words that would be right where one is wrong.

    `Invalid value 'brak' - at `$.behaviour.kind`` becomes `Invalid value 'brak', expected brake, cut-in, ... - at ...`;
    an unknown field gets the field that is most like it.
    """
    message = " ".join(str(error).split())
    place = _PLACE.search(message)
    steps = [match[1] or "" for match in _STEP.finditer(place[1])] if place else []
    said = message if place is None else message[: place.start()]
    found = _NO_FIELD.match(said)
    if _WRONG_WORD.match(said):
        words = list(dict.fromkeys(_words(_types(kind, steps[:-1]), steps[-1] if steps else "")))
        said += f", expected {', '.join(words)}" if words else ""
    elif found is not None:
        fields = [field.encode_name for each in _types(kind, steps) for field in getattr(each, "fields", ())]
        like = difflib.get_close_matches(found[1], fields, n=1)
        said += f"; did you mean `{like[0]}`?" if like else ""
    return said + (message[place.start() :] if place else "")


def _types(kind: Any, steps: list[str]) -> list[inspect.Type]:
    """All types that can stand at a place: a step is the name of a field, or nothing for a member of a sequence."""
    here = list(_choices(inspect.type_info(kind)))
    for step in steps:
        here = [choice for each in here for inner in _inside(each, step) for choice in _choices(inner)]
    return here


def _choices(found: inspect.Type) -> Iterator[inspect.Type]:
    if isinstance(found, inspect.Metadata):
        yield from _choices(found.type)
    elif isinstance(found, inspect.UnionType):
        for each in found.types:
            yield from _choices(each)
    else:
        yield found


def _inside(found: inspect.Type, step: str) -> Iterator[inspect.Type]:
    if isinstance(found, inspect.StructType | inspect.DataclassType):
        yield from (field.type for field in found.fields if field.encode_name == step)
    elif isinstance(found, inspect.ListType | inspect.SetType | inspect.VarTupleType):
        yield found.item_type
    elif isinstance(found, inspect.TupleType):
        yield from found.item_types
    elif isinstance(found, inspect.DictType):
        yield found.value_type


def _words(around: list[inspect.Type], name: str) -> Iterator[str]:
    """Words that can stand in a field: tags of the structs around it, or what the field's own type lists."""
    for each in around:
        if isinstance(each, inspect.StructType) and each.tag_field == name:
            yield str(each.tag)
        for inner in _inside(each, name):
            for choice in _choices(inner):
                if isinstance(choice, inspect.LiteralType):
                    yield from map(str, choice.values)
                elif isinstance(choice, inspect.EnumType):
                    yield from (str(member.value) for member in choice.cls)


def converted(values: Any, kind: Any, **options: Any) -> Any:
    """Return plain values as a type that msgspec knows.

    Raises msgspec.ValidationError (a ValueError) with the place and what is allowed, ValueError for NaN or infinity.
    """
    check_finite(values)
    try:
        return msgspec.convert(values, kind, **options)
    except msgspec.ValidationError as error:
        raise msgspec.ValidationError(printable(explained(error, kind))) from None
