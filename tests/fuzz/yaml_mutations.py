"""Damage to YAML: values of another kind, as JSON is damaged, and what only YAML has: anchors, tags, odd numbers."""

import json
from random import Random

import yaml

from .json_mutations import damaged_json
from .mutations import damaged_text

_WORDS = (
    "!!int ''", "!!float ''", "!!float x", "!!timestamp x", "!!bool maybe", "!!binary '*'", "!!set {a, b}", "!!omap 3",
    "!!pairs 3", "!!null 3", "!!str 3", "!!python/object/apply:os.system ['false']", "!!python/name:os.system ''",
    "!x y", "&a [*a]", "*nobody", "&b 1", ".nan", ".inf", "-.Inf", "1e999", "1.0e+999", "2001-99-99", "2001-02-03",
    "2001-02-03T04:05:06.789+99:99", "1:60", "1:1:1.5", "0b", "0x", "0o8", "08", "1_000", "9" * 5000, "~", "yes", "{}",
    "[]", "[[[[", "- - - -", "? [a]", "? {a: 1}\n  : 2", "<<: 3", "<<: [*nobody]", "|\n", ">", "'", '"\\x1b[31m"',
    "%TAG ! x", "---", "...", "--- a\n--- b", "\t", "# ", "@", "`", "[" * 300, "{a: " * 200, "[" + "x," * 30_000 + "x]",
)  # fmt: skip
_BOMB = "\n".join(
    [f"{name}: &{name} [{', '.join([f'*{before}'] * 9) if before else '1, 1, 1'}]" for before, name in
     zip(["", *"qrstuvw"], "qrstuvwz", strict=True)]
)  # fmt: skip


def damaged_yaml(data: bytes, chance: Random) -> bytes:
    """Damage values of a YAML file, or its text."""
    kind = chance.random()
    if kind < 0.5:
        return damaged_json(json.dumps(yaml.safe_load(data)).encode(), chance)
    if kind < 0.7:
        return damaged_text(data, chance)
    lines = data.decode().split("\n")
    for _ in range(chance.choice((1, 1, 2))):
        number, word = chance.randrange(len(lines)), chance.choice(_WORDS)
        name, _, value = lines[number].partition(":")
        lines[number] = chance.choice(
            (f"{word}\n{lines[number]}", f"{name}: &anchor {value or '{}'}", f"{name}: {word}")
        )
    if chance.random() < 0.05:
        lines.append(_BOMB)
    return "\n".join(lines).encode()
