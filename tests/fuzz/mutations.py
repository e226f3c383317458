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


def damaged_header(end: bytes) -> Callable[[bytes, Random], bytes]:
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
