"""Damage to files, decided by a seeded generator: the same seed always does the same."""

import struct
from collections.abc import Callable
from random import Random

_INTEGERS = (0, 1, -1, 2, 127, 128, 255, 256, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0xFFFFFF, 0x7FFFFFFF, 0x80000000,
             0xFFFFFFFF, 1 << 32, 1 << 40, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)  # fmt: skip
_FLOATS = (float("nan"), float("inf"), float("-inf"), 0.0, -0.0, -1.0, 1e-45, 1e-310, 1e20, 3.4e38, -3.4e38, 1e300)
_WORDS = ("", "0", "-1", "1", "-0", "nan", "NaN", "inf", "-Infinity", "1e999", "1e-999", "1e308", "1e38", "0x10", "1_0",
          "4294967296", "18446744073709551616", "9" * 30, "9" * 5000, "None", "true", "\u0663", "\u00b2", ".", "..",
          "../x", "/etc/passwd", "\x00", "\x1b[31m", "\ufeff", "\u2028", "a" * 3000, "[" * 3000, "%n%s", "\t",
          ",", ";", ":")  # fmt: skip
_LONGEST = 1 << 20
"""Bytes; damage that copies parts of a file stops here."""


def damaged_bytes(data: bytes, chance: Random) -> bytes:
    """Damage a file one to four times as if nothing were known of it."""
    edited = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 4))):
        _BYTE_DAMAGE[chance.randrange(len(_BYTE_DAMAGE))](edited, chance)
        del edited[_LONGEST:]
    return bytes(edited)


def damaged_text(data: bytes, chance: Random) -> bytes:
    """Damage lines and words, and now and then bytes."""
    if chance.random() < 0.15:
        return damaged_bytes(data, chance)
    lines = data.decode("utf-8", errors="surrogateescape").split("\n")
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        _LINE_DAMAGE[chance.randrange(len(_LINE_DAMAGE))](lines, chance)
    return "\n".join(lines).encode("utf-8", errors="surrogateescape")[:_LONGEST]


def damaged_header(end: bytes) -> Callable[[bytes, Random], bytes]:
    """Damage of files whose text ends with a mark, such as PLY's: the text half of the time, else anything."""

    def damage(data: bytes, chance: Random) -> bytes:
        header, mark, rows = data.partition(end)
        if not mark or chance.random() < 0.5:
            return damaged_bytes(data, chance)
        return damaged_text(header, chance) + mark + rows

    return damage


def _place(edited: bytearray, chance: Random) -> int:
    """A place in a file; the first 64 bytes, where headers are, are as likely as all others."""
    size = max(len(edited), 1)
    return chance.randrange(min(size, 64)) if chance.random() < 0.5 else chance.randrange(size)


def _cut(edited: bytearray, chance: Random) -> None:
    del edited[chance.randrange(len(edited) + 1) :]


def _flip(edited: bytearray, chance: Random) -> None:
    if edited:
        edited[_place(edited, chance)] ^= 1 << chance.randrange(8)


def _set_byte(edited: bytearray, chance: Random) -> None:
    if edited:
        edited[_place(edited, chance)] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256)))


def _set_integer(edited: bytearray, chance: Random) -> None:
    size, order = chance.choice((2, 4, 4, 8)), chance.choice(("little", "little", "big"))
    place = _place(edited, chance)
    value = chance.choice(_INTEGERS) % (1 << (8 * size))
    edited[place : place + size] = value.to_bytes(size, order)  # type: ignore[arg-type]


def _set_float(edited: bytearray, chance: Random) -> None:
    value, place = chance.choice(_FLOATS), _place(edited, chance)
    if chance.random() < 0.5 or abs(value) > 3.4e38:
        edited[place : place + 8] = struct.pack("<d", value)
    else:
        edited[place : place + 4] = struct.pack("<f", value)


def _splice(edited: bytearray, chance: Random) -> None:
    start, size = _place(edited, chance), chance.choice((1, 4, 16, 64, 300))
    part, place = edited[start : start + size], _place(edited, chance)
    edited[place : place + (len(part) if chance.random() < 0.5 else 0)] = part


def _remove(edited: bytearray, chance: Random) -> None:
    place = _place(edited, chance)
    del edited[place : place + chance.choice((1, 2, 4, 8, 32))]


def _insert(edited: bytearray, chance: Random) -> None:
    place = _place(edited, chance)
    edited[place:place] = chance.randbytes(chance.choice((1, 2, 4, 9, 60)))


def _fill(edited: bytearray, chance: Random) -> None:
    place, size = _place(edited, chance), chance.choice((4, 16, 100, 1000))
    end = min(place + size, len(edited))
    edited[place:end] = bytes([chance.choice((0, 0xFF, 0x20))]) * (end - place)


_BYTE_DAMAGE = (_cut, _flip, _flip, _set_byte, _set_byte, _set_integer, _set_integer, _set_float, _set_float,
                _splice, _remove, _insert, _fill)  # fmt: skip


def _set_word(lines: list[str], chance: Random) -> None:
    """Replace a word, or what stands between two signs in it."""
    number = chance.randrange(len(lines))
    line = lines[number]
    edges = [0, *(place for place, sign in enumerate(line) if not (sign.isalnum() or sign in "+-._")), len(line)]
    k = chance.randrange(len(edges) - 1)
    lines[number] = line[: edges[k] + (1 if k else 0)] + chance.choice(_WORDS) + line[edges[k + 1] :]


def _drop_line(lines: list[str], chance: Random) -> None:
    if len(lines) > 1:
        del lines[chance.randrange(len(lines))]


def _repeat_line(lines: list[str], chance: Random) -> None:
    number = chance.randrange(len(lines))
    lines[number:number] = lines[number : number + 1] * chance.choice((1, 1, 2, 40))


def _swap_lines(lines: list[str], chance: Random) -> None:
    first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
    lines[first], lines[second] = lines[second], lines[first]


def _drop_word(lines: list[str], chance: Random) -> None:
    number = chance.randrange(len(lines))
    words = lines[number].split(" ")
    del words[chance.randrange(len(words))]
    lines[number] = " ".join(words)


def _set_sign(lines: list[str], chance: Random) -> None:
    number = chance.randrange(len(lines))
    place = chance.randrange(len(lines[number]) + 1)
    sign = chance.choice("\0\r\t\x1b\"'<>&[]{}(),:;-.eE+#\u00e9\u2028\U0001f327\ud800".replace("\ud800", "\udcff"))
    lines[number] = lines[number][:place] + sign + lines[number][place + chance.randrange(2) :]


def _cut_lines(lines: list[str], chance: Random) -> None:
    del lines[chance.randrange(len(lines)) + 1 :]


_LINE_DAMAGE = (_set_word, _set_word, _set_word, _set_word, _drop_line, _repeat_line, _swap_lines, _drop_word,
                _set_sign, _set_sign, _cut_lines)  # fmt: skip
