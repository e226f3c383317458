"""Damage to JSON that keeps it JSON: keys that are missing, twice or new, values and lists that are others."""

import json
from random import Random
from typing import Any

from .mutations import damaged_text

_RAW = {
    "@deep list@": "[" * 3000 + "]" * 3000,
    "@deep object@": '{"a":' * 3000 + "1" + "}" * 3000,
    "@long integer@": "9" * 5000,
    "@large integer@": str(1 << 70),
    "@large@": "1e308",
    "@infinite@": "1e999",
    "@nan@": "NaN",
    "@infinity@": "-Infinity",
    "@surrogate@": '"\\ud800"',
}
"""Values that Python's writer would not write; they are put in the place of their marks."""
_ODD: tuple[Any, ...] = (
    *_RAW, None, True, False, 0, -1, 1, 2, 255, 65536, 4294967295, 0.5, -0.0, 1e-320, 1e30, -1e30, "", "x", "0", "1.5",
    "x" * 5000, "../../etc/passwd", "/etc/passwd", "..", ".", "a\0b", "\x1b[31mred", "\u2028", "C:\\x", [], {}, [[]],
    [0],
    [1, 2, 3], [None], {"": 0}, {"a": {"b": []}},
)  # fmt: skip


def damaged_json(data: bytes, chance: Random) -> bytes:
    """Damage values of a JSON file one to four times; a fifth of the time its text."""
    if chance.random() < 0.2:
        return damaged_text(data, chance)
    values = [json.loads(data)]
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        holder, key = _somewhere(values, chance)
        _damage(holder, key, chance)
        if not values:
            return b""
    text = json.dumps(values[0])
    for mark, raw in _RAW.items():
        text = text.replace(f'"{mark}"', raw)
    return _doubled_key(text, chance).encode()


def _somewhere(values: list[Any], chance: Random) -> tuple[Any, Any]:
    """A value's holder and its key or index there; deeper ones are reached as often as shallow ones."""
    holder, key = values, 0
    while isinstance(holder[key], dict | list) and holder[key] and chance.random() < 0.85:
        holder = holder[key]
        key = chance.choice(sorted(holder)) if isinstance(holder, dict) else chance.randrange(len(holder))
    return holder, key


def _damage(holder: Any, key: Any, chance: Random) -> None:
    is_object = isinstance(holder, dict)
    match chance.randrange(10):
        case 0 | 1:
            holder[key] = _another(holder[key], chance)
        case 2 | 3:
            del holder[key]
        case 4 if is_object:
            holder[chance.choice((key + "_", key.upper(), "", "unknown"))] = holder.pop(key)
        case 4:
            holder.insert(key, holder[key])
        case 5 if is_object:
            holder[chance.choice(("version", "name", "unknown"))] = _odd(chance)
        case 6:
            other = chance.choice(sorted(holder)) if is_object else chance.randrange(len(holder))
            holder[key], holder[other] = holder[other], holder[key]
        case _:
            holder[key] = _odd(chance)


def _odd(chance: Random) -> Any:
    return json.loads(json.dumps(chance.choice(_ODD)))


def _another(value: Any, chance: Random) -> Any:
    """Another value of the same kind."""
    match value:
        case bool(flag):
            return not flag
        case int(number) | float(number):
            return chance.choice((-number, number * 1e9, number + 1, number / 3, int(number)))
        case str(text):
            return chance.choice((text[:-1], text + "x", text.upper(), text + "/../" + text, f" {text}"))
        case list(values) if values:
            return chance.choice((values[:-1], values + values[:1], values[::-1], [values], values[:1] * 50))
        case dict(values) if values:
            return chance.choice((list(values), list(values.values()), {"": values}))
        case _:
            return _odd(chance)


def _doubled_key(text: str, chance: Random) -> str:
    """Now and then, a key that comes twice: JSON allows it, and readers differ in which one counts."""
    place = text.find('": ', chance.randrange(len(text) + 1))
    if chance.random() > 0.1 or place < 0:
        return text
    start = text.rfind('"', 0, place)
    return f"{text[:start]}{text[start : place + 1]}: null, {text[start:]}"
