"""YAML and JSON of strangers as plain values: limits on size, depth and number come before memory is taken."""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from .limits import InputError, read_input

MAX_BYTES = 1 << 24
"""Of a file of settings: a scenario with an hour of tracks has a tenth of it."""

_MAX_DEPTH = 100

_MAX_VALUES = 300_000
"""Aliases count as what they stand for."""

_MAX_DIGITS = 400
"""Of a whole number; a float has no more than 309 before its point."""

_MAX_SIGNS = 100_000
"""Of one word or text."""

_MERGED = "<<"

_SOURCE = ' in "<byte string>",'
"""How PyYAML calls what it reads."""

_Parser: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_whole(path: Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Read settings: a file, or a pipe such as `<(command)`, of at most so many bytes.

    Raises ValueError with its name where it is larger or neither of them, OSError where it can't be read.
    """
    try:
        return read_input(path, max_bytes)
    except InputError as error:
        raise ValueError(str(error)) from None


def yaml_values(data: bytes) -> Any:
    """Return what a YAML document says; raises ValueError, with what is wrong and where, for what can't be settings.

    Those are, beside bad syntax: a field given twice, more than 300 000 values (with aliases as often as they are used)
    or 100 levels, and everything that YAML could make beyond plain values.
    """
    try:
        _check_events(data)
        return yaml.load(data, _SafeYamlLoader)
    except yaml.YAMLError as error:
        raise ValueError(f"not readable as YAML: {printable_line(error).replace(_SOURCE, ',')}") from None
    except ValueError as error:
        raise ValueError(f"not readable as YAML: {printable_line(error)}") from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, RecursionError):
        # What PyYAML makes of tags before what they can't be, such as `!!int ""`.
        raise ValueError("not readable as YAML: a tag (!!...) stands before what it can't be") from None


def json_values(data: bytes) -> Any:
    """Return what a JSON document says; raises ValueError for bad syntax, nesting beyond bounds, NaN and infinity."""
    try:
        values = json.loads(data)
    except RecursionError:
        raise ValueError("not readable as JSON: it is nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"not readable as JSON: {printable_line(error)}") from None
    check_finite(values)
    return values


def check_finite(values: Any) -> None:
    """Raise ValueError, with the place, where plain values hold NaN or infinity, or are nested beyond 100 levels."""
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
    """Walk through a document without making anything of it: aliases that multiply and depth end here."""
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
    """Plain values only; a field that stands twice is an error, as YAML has it."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen = set[str]()
        for key in (each for each, _ in node.value if isinstance(each, yaml.ScalarNode)):
            if key.value in seen and key.value != _MERGED:
                raise yaml.constructor.ConstructorError(None, None, f"{key.value!r} is there twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: Any) -> int:
        if len(node.value) > _MAX_DIGITS:
            raise yaml.constructor.ConstructorError(
                None, None, f"a number of {len(node.value)} digits", node.start_mark
            )
        return super().construct_yaml_int(node)

    def construct_yaml_float(self, node: Any) -> float:
        if len(node.value) > _MAX_DIGITS:
            raise yaml.constructor.ConstructorError(
                None, None, f"a number of {len(node.value)} digits", node.start_mark
            )
        return super().construct_yaml_float(node)


_SafeYamlLoader.add_constructor("tag:yaml.org,2002:int", _SafeYamlLoader.construct_yaml_int)

_SafeYamlLoader.add_constructor("tag:yaml.org,2002:float", _SafeYamlLoader.construct_yaml_float)

# § Words out of files in sentences for people: no sign in them steers a terminal, and none goes on for pages.

_LONGEST = 600


def printable_line(words: object, longest: int = _LONGEST) -> str:
    """Return words as one line: signs that can't be printed as their escapes, and the middle of long ones left out."""
    line = escape_invisible(" ".join(str(words).split()))
    return line if len(line) <= longest else f"{line[: longest // 2]} ... {line[-longest // 2 :]}"


def escape_invisible(text: str) -> str:
    r"""Return a name or a line with everything in it that is no visible character or space as its escape.

    ESC becomes `\x1b`, a line break `\n`, U+202E and the other controls of direction `\u202e`, an undecodable byte
    `\udcff`. So no name steers a terminal, adds a line of its own, or is read backwards.
    """
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() or sign in _SPACES else repr(sign)[1:-1] for sign in text)


_SPACES = "\u00a0\u2002\u2003\u2009\u202f\u3000"
"""Spaces that names are written with, which Python does not count as printable."""

# § Words out of files in figures: short enough to leave room for the curves, and nothing in them is a formula.

_MISSING = "□"
"""In the place of a sign that the font lacks."""


def figure_words(words: object, longest: int = 48) -> str:
    """Return words as Matplotlib writes them as they are.

    The middle of long ones is left out, `$` begins no formula, an underscore in front hides no curve from the legend,
    and a sign that the font lacks becomes a box.
    """
    line = printable_line(words, longest)
    if not line.isascii():
        line = "".join(sign if _has_glyph(sign) else _MISSING for sign in line)
    line = line.replace("$", r"\$")
    return f" {line}" if line.startswith("_") else line


@cache
def _has_glyph(sign: str) -> bool:
    from matplotlib.font_manager import findfont, get_font  # loads slowly, and most names are ASCII

    return get_font(findfont("DejaVu Sans")).get_char_index(ord(sign)) != 0
