"""Damage to files, decided by a seeded generator: the same seed always does the same."""

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable
from random import Random
from typing import Any

import yaml

Damage = Callable[[bytes, Random], bytes]
"""Makes another file of a file, as the generator decides."""

# Bytes and text

_INTEGERS = (0, 1, -1, 2, 127, 128, 255, 256, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0xFFFFFF, 0x7FFFFFFF, 0x80000000,
             0xFFFFFFFF, 1 << 32, 1 << 40, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)  # fmt: skip
_FLOATS = (float("nan"), float("inf"), float("-inf"), 0.0, -0.0, -1.0, 1e-45, 1e-310, 1e20, 3.4e38, -3.4e38, 1e300)
_WORDS = ("", "0", "-1", "1", "-0", "nan", "NaN", "inf", "-Infinity", "1e999", "1e-999", "1e308", "1e38", "0x10", "1_0",
          "4294967296", "18446744073709551616", "9" * 30, "9" * 5000, "None", "true", "\u0663", "\u00b2", ".", "..",
          "../x", "/etc/passwd", "\x00", "\x1b[31m", "\ufeff", "\u2028", "a" * 3000, "[" * 3000, "%n%s", "\t",
          ",", ";", ":")  # fmt: skip
_SIGNS = "\0\r\t\x1b\"'<>&[]{}(),:;-.eE+#\u00e9\u2028\U0001f327\udcff"
_LONGEST = 1 << 20
"""Bytes; damage that copies parts of a file stops here."""


def damaged_bytes(data: bytes, chance: Random) -> bytes:
    """Damage a file one to four times as if nothing were known of it."""
    edited = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 4))):
        start, end, new = _byte_damage(edited, chance)
        edited[start:end] = new
        del edited[_LONGEST:]
    return bytes(edited)


def damaged_text(data: bytes, chance: Random) -> bytes:
    """Damage lines and words, and now and then bytes."""
    if chance.random() < 0.15:
        return damaged_bytes(data, chance)
    lines = data.decode("utf-8", errors="surrogateescape").split("\n")
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        start, end, new = _line_damage(lines, chance)
        lines[start:end] = new
    return "\n".join(lines).encode("utf-8", errors="surrogateescape")[:_LONGEST]


def damaged_header(end: bytes) -> Damage:
    """Damage of files whose text ends with a mark, such as PLY's: the text half of the time, else anything."""

    def damage(data: bytes, chance: Random) -> bytes:
        header, mark, rows = data.partition(end)
        if not mark or chance.random() < 0.5:
            return damaged_bytes(data, chance)
        return damaged_text(header, chance) + mark + rows

    return damage


def _byte_damage(edited: bytearray, chance: Random) -> tuple[int, int, bytes]:
    """Start and end of a part of a file, and the bytes that replace it."""

    def somewhere() -> int:
        """A place in a file; the first 64 bytes, where headers are, are as likely as all others."""
        size = max(len(edited), 1)
        return chance.randrange(min(size, 64)) if chance.random() < 0.5 else chance.randrange(size)

    place = somewhere()
    match chance.randrange(13):
        case 0:  # cut off
            return chance.randrange(len(edited) + 1), len(edited), b""
        case 1 | 2:  # a bit
            return place, place + 1, bytes(byte ^ 1 << chance.randrange(8) for byte in edited[place : place + 1])
        case 3 | 4:  # a byte
            return place, place + 1, bytes([chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256)))])
        case 5 | 6:
            size, value = chance.choice((2, 4, 4, 8)), chance.choice(_INTEGERS)
            number = (value % (1 << (8 * size))).to_bytes(size, "big" if chance.random() < 0.33 else "little")
            return place, place + size, number
        case 7 | 8:
            value = chance.choice(_FLOATS)
            number = struct.pack("<d" if chance.random() < 0.5 or abs(value) > 3.4e38 else "<f", value)
            return place, place + len(number), number
        case 9:  # a part of the file at another place
            start, size = somewhere(), chance.choice((1, 4, 16, 64, 300))
            part = edited[start : start + size]
            return place, place + (len(part) if chance.random() < 0.5 else 0), bytes(part)
        case 10:
            return place, place + chance.choice((1, 2, 4, 8, 32)), b""
        case 11:
            return place, place, chance.randbytes(chance.choice((1, 2, 4, 9, 60)))
        case _:
            end = min(place + chance.choice((4, 16, 100, 1000)), len(edited))
            return place, end, bytes([chance.choice((0, 0xFF, 0x20))]) * (end - place)


def _line_damage(lines: list[str], chance: Random) -> tuple[int, int, list[str]]:
    """Start and end of a part of a text, and the lines that replace it."""
    number, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    line = lines[number]
    match chance.randrange(10):
        case 0:
            return number, number + 1, [] if len(lines) > 1 else [line]
        case 1:
            return number, number, [line] * chance.choice((1, 1, 2, 40))
        case 2:
            return number, number + 1, [lines[other]]
        case 3:
            words = line.split(" ")
            del words[chance.randrange(len(words))]
            return number, number + 1, [" ".join(words)]
        case 4 | 5:
            place = chance.randrange(len(line) + 1)
            return number, number + 1, [line[:place] + chance.choice(_SIGNS) + line[place + chance.randrange(2) :]]
        case 6:
            return number + 1, len(lines), []
        case _:  # a word, or what stands between two signs in it
            edges = [
                0,
                *(place for place, sign in enumerate(line) if not (sign.isalnum() or sign in "+-._")),
                len(line),
            ]
            k = chance.randrange(len(edges) - 1)
            return number, number + 1, [line[: edges[k] + (k > 0)] + chance.choice(_WORDS) + line[edges[k + 1] :]]


# JSON: keys that are missing, twice or new, values and lists that are others

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


# YAML: values of another kind, as in JSON, and its own anchors, tags and numbers

_YAML_WORDS = (
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
        number, word = chance.randrange(len(lines)), chance.choice(_YAML_WORDS)
        name, _, value = lines[number].partition(":")
        lines[number] = chance.choice(
            (f"{word}\n{lines[number]}", f"{name}: &anchor {value or '{}'}", f"{name}: {word}")
        )
    if chance.random() < 0.05:
        lines.append(_BOMB)
    return "\n".join(lines).encode()


# Inside of containers, whose checksums would stop it: gzip, zip and TFRecord


def inside_gzip(inner: Damage = damaged_bytes) -> Damage:
    """Damage what is packed, and a quarter of the time the stream itself."""

    def damage(data: bytes, chance: Random) -> bytes:
        if chance.random() < 0.25:
            return damaged_bytes(data, chance)
        return gzip.compress(inner(gzip.decompress(data), chance), 1, mtime=0)

    return damage


def damaged_glb(data: bytes, chance: Random) -> bytes:
    """Damage the description of a binary glTF file as JSON, with lengths that fit; a fifth of the time its bytes."""
    if chance.random() < 0.2:
        return damaged_bytes(data, chance)
    (length,) = struct.unpack_from("<I", data, 12)
    text, rest = damaged_json(data[20 : 20 + length], chance), data[20 + length :]
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def inside_zip(of_member: Callable[[str], Damage]) -> Damage:
    """Damage a member, drop, double or rename one, and a quarter of the time the archive itself."""

    def damage(data: bytes, chance: Random) -> bytes:
        if chance.random() < 0.25:
            return damaged_bytes(data, chance)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(name, archive.read(name)) for name in archive.namelist()]
        k = chance.randrange(len(members))
        name, content = members[k]
        match chance.randrange(8):
            case 0:
                del members[k]
            case 1:
                members[k] = chance.choice((f"../{name}", f"/{name}", name.upper(), "x" * 70_000)), content
            case _:
                members[k] = name, of_member(name)(content, chance)
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
            for name, content in members:
                archive.writestr(zipfile.ZipInfo(name[:60_000]), content)
        return file.getvalue()

    return damage


def inside_records(framed: Callable[[bytes], bytes]) -> Damage:
    """Damage the content of one record of a TFRecord file and give it its checksum again, or damage the file."""

    def damage(data: bytes, chance: Random) -> bytes:
        if chance.random() < 0.2:
            return damaged_bytes(data, chance)
        contents: list[bytes] = []
        place = 0
        while place < len(data):
            size = int.from_bytes(data[place : place + 8], "little")
            contents.append(data[place + 12 : place + 12 + size])
            place += 16 + size
        k = chance.randrange(len(contents))
        contents[k] = damaged_bytes(contents[k], chance)
        return b"".join(map(framed, contents))

    return damage
