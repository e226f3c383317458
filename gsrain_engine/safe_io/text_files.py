"""Untrusted YAML and JSON as plain values, and safe display of text from files.

Limits on size, depth and number of values apply before allocation.
"""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from .limits import InputError, read_input

MAX_BYTES = 1 << 24
"""Limit of a settings file, ten times the size of a scenario with an hour of tracks."""

_MAX_DEPTH = 100
_MAX_VALUES = 300_000  # an alias counts as much as its anchor
_MAX_DIGITS = 400  # digits of an integer; a float has at most 309 before its decimal point
_MAX_SIGNS = 100_000  # characters of one string
_MERGED = "<<"
_SOURCE = ' in "<byte string>",'  # PyYAML's name of its input
_Parser: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_whole(path: Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Read settings from a file or a pipe such as `<(command)`, of at most `max_bytes`.

    Raises ValueError with its name if it is larger or neither of them, OSError if it can't be read.
    """
    try:
        return read_input(path, max_bytes)
    except InputError as error:
        raise ValueError(str(error)) from None


def yaml_values(data: bytes) -> Any:
    """Parse a YAML document; raises ValueError, with the reason and the line, if it can't be settings.

    Besides bad syntax that is a duplicate field, more than 300,000 values (an alias counts each time) or 100 levels,
    and any tag for other than plain values.
    """
    try:
        _check_events(data)
        return yaml.load(data, _SafeYamlLoader)
    except yaml.YAMLError as error:
        raise ValueError(f"not readable as YAML: {printable_line(error).replace(_SOURCE, ',')}") from None
    except ValueError as error:
        raise ValueError(f"not readable as YAML: {printable_line(error)}") from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, RecursionError):
        # PyYAML's exceptions for tags on unsuitable values, such as `!!int ""`.
        raise ValueError("not readable as YAML: a tag (!!...) stands before what it can't be") from None


def json_values(data: bytes) -> Any:
    """Parse a JSON document; raises ValueError for bad syntax, excessive nesting, NaN and infinity."""
    try:
        values = json.loads(data)
    except RecursionError:
        raise ValueError("not readable as JSON: it is nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"not readable as JSON: {printable_line(error)}") from None
    check_finite(values)
    return values


def check_finite(values: Any) -> None:
    """Raise ValueError, with the position, if plain values hold NaN or infinity or exceed 100 levels."""
    waiting: list[tuple[str, int, Any]] = [("$", 0, values)]
    while waiting:
        place, depth, value = waiting.pop()
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"Expected a finite number, got {value} - at `{printable_line(place)}`")
        if isinstance(value, dict | list | tuple) and depth > _MAX_DEPTH:
            raise ValueError(f"nested more than {_MAX_DEPTH} levels deep")
        if isinstance(value, dict):
            items: dict[Any, Any] = value
            waiting += [(f"{place}.{name}", depth + 1, each) for name, each in items.items()]
        elif isinstance(value, list | tuple):
            rows: list[Any] | tuple[Any, ...] = value
            waiting += [(f"{place}[{number}]", depth + 1, each) for number, each in enumerate(rows)]


def _check_events(data: bytes) -> None:
    """Scan a document without building values: rejects exponential aliases and excessive depth."""
    total, opened = 0, list[tuple[str | None, int]]()
    sizes: dict[str | None, int] = {}
    for event in yaml.parse(data, _Parser):
        if isinstance(event, yaml.AliasEvent):
            if event.anchor in {name for name, _ in opened}:
                raise ValueError(f"*{event.anchor} stands inside of what it stands for")
            total += sizes.get(event.anchor, 1)
        elif isinstance(event, yaml.ScalarEvent):
            total += 1
            sizes[event.anchor] = 1
            if len(event.value) > _MAX_SIGNS:
                raise ValueError(f"line {event.start_mark.line + 1}: a text of {len(event.value)} signs")
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, total))
            total += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            sizes[anchor] = total - before
        if len(opened) > _MAX_DEPTH:
            raise ValueError(f"nested more than {_MAX_DEPTH} levels deep")
        if total > _MAX_VALUES:
            raise ValueError(f"it holds more than {_MAX_VALUES} values")


class _SafeYamlLoader(_Parser):
    """Loader of plain values only; a duplicate field is an error, as the YAML standard requires."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen = set[str]()
        for key in (each for each, _ in node.value if isinstance(each, yaml.ScalarNode)):
            if key.value in seen and key.value != _MERGED:
                raise yaml.constructor.ConstructorError(None, None, f"{key.value!r} is there twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: Any) -> int:
        _check_digits(node)
        return super().construct_yaml_int(node)

    def construct_yaml_float(self, node: Any) -> float:
        _check_digits(node)
        return super().construct_yaml_float(node)


_SafeYamlLoader.add_constructor("tag:yaml.org,2002:int", _SafeYamlLoader.construct_yaml_int)
_SafeYamlLoader.add_constructor("tag:yaml.org,2002:float", _SafeYamlLoader.construct_yaml_float)


def _check_digits(node: Any) -> None:
    if len(node.value) > _MAX_DIGITS:
        raise yaml.constructor.ConstructorError(None, None, f"a number of {len(node.value)} digits", node.start_mark)


# Text for messages

_LONGEST = 600


def printable_line(words: object, longest: int = _LONGEST) -> str:
    """Return text as one line, with unprintable characters escaped and the middle of long text left out."""
    line = escape_invisible(" ".join(str(words).split()))
    return line if len(line) <= longest else f"{line[: longest // 2]} ... {line[-longest // 2 :]}"


def escape_invisible(text: str) -> str:
    r"""Return text with all invisible characters but spaces escaped.

    ESC becomes `\x1b`, a line break `\n`, U+202E and the other direction controls `\u202e`, an undecodable byte
    `\udcff`. So a name can't control the terminal, add a line, or reverse the text direction.
    """
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() or sign in _SPACES else repr(sign)[1:-1] for sign in text)


_SPACES = "\u00a0\u2002\u2003\u2009\u202f\u3000"  # typographic spaces, which Python does not count as printable

# Text for figures

_MISSING = "□"  # replacement for characters missing in the font


def figure_words(words: object, longest: int = 48) -> str:
    """Return text in a form that Matplotlib draws literally.

    The middle of long text is left out, `$` is escaped, a leading underscore gets a space before it (Matplotlib would
    hide the curve from the legend), and a character missing in the font becomes a box.
    """
    line = printable_line(words, longest)
    if not line.isascii():
        line = "".join(sign if _has_glyph(sign) else _MISSING for sign in line)
    line = line.replace("$", r"\$")
    return f" {line}" if line.startswith("_") else line


@cache
def _has_glyph(sign: str) -> bool:
    from matplotlib.font_manager import findfont, get_font  # slow to import, and most names are ASCII

    return get_font(findfont("DejaVu Sans")).get_char_index(ord(sign)) != 0
