"""Options as a value of the engine: what is wrong with one is told by the option's name, not by the field's."""

import re
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from gsrain_engine.untrusted.explained_errors import converted

RAIN_OPTIONS = {"intensity_mm_h": "rain", "exposure_s": "exposure"}
"""Options of the rain by field, where they are called otherwise."""

_Kind = TypeVar("_Kind")

_WORD = re.compile(r"\w+")
_PLACE = re.compile(r" - at `\$.*?(\w+)(\[[^\]]*\])*`$")


def converted_options(values: Mapping[str, Any], kind: type[_Kind], options: Mapping[str, str] | None = None) -> _Kind:
    """Return what options give as a type that msgspec knows; raises ValueError, which names the option.

    `options` are those that are not called as their field, by field, without dashes.
    """
    try:
        return converted(values, kind)
    except msgspec.ValidationError as error:
        said = str(error)

    def named(field: str) -> str:
        return f"--{(options or {}).get(field, field).replace('_', '-')}"

    if place := _PLACE.search(said):
        raise ValueError(f"{named(place[1])}: {said[: place.start()]}")
    # What a type checks by itself names the fields: "last_s must be above first_s ..."
    raise ValueError(_WORD.sub(lambda word: named(word[0]) if word[0] in values else word[0], said))
