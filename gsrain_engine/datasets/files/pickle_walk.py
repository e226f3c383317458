"""Walks through the instructions of a pickle without doing them: Python makes room for whatever they say."""

import pickle
import pickletools
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Int64
from numba import njit

_LINE, _TWO_LINES, _LENGTH_1, _LENGTH_4, _LENGTH_8, _UNKNOWN = -1, -2, -3, -4, -5, -6
"""How long an instruction is, where it is no number of bytes: to the end of a line, or as long as it says itself."""
_LINES = {b"c", b"i"}
"""Instructions with two lines."""
_STOP, _PUT, _BINPUT, _LONG_BINPUT = (code[0] for code in (pickle.STOP, pickle.PUT, pickle.BINPUT, pickle.LONG_BINPUT))


def lying_instruction(content: bytes) -> int | None:
    """Byte of the first instruction that is none, or asks for more than there is; None where there is no such one.

    Lengths are compared with what is left of the file, and places in the memo, which Python makes room for up to, with
    how many instructions there were.
    """
    place = int(_walk(np.frombuffer(content, np.uint8), _LENGTHS))
    return None if place < 0 else place


def _lengths() -> Int64[np.ndarray, "256"]:
    lengths = np.full(256, _UNKNOWN, np.int64)
    named = {pickletools.UP_TO_NEWLINE: _LINE, pickletools.TAKEN_FROM_ARGUMENT1: _LENGTH_1}
    named |= {pickletools.TAKEN_FROM_ARGUMENT4: _LENGTH_4, pickletools.TAKEN_FROM_ARGUMENT4U: _LENGTH_4}
    named |= {pickletools.TAKEN_FROM_ARGUMENT8U: _LENGTH_8}
    for each in pickletools.opcodes:
        code = each.code.encode("latin-1")
        argument: Any = each.arg
        size = 0 if argument is None else int(argument.n)
        lengths[code[0]] = _TWO_LINES if code in _LINES else named.get(size, size)
    return lengths


_LENGTHS = _lengths()


@njit(cache=True)
@no_type_check
def _walk(content, lengths):
    """Place of the first instruction that can't be; -1 where all are fine up to the one that stops."""
    at, count, size = 0, 0, content.size
    while at < size:
        start, code = at, content[at]
        at, count = at + 1, count + 1
        if code == _STOP:
            return -1
        length = lengths[code]
        if length == _UNKNOWN:
            return start
        if length >= 0:
            if code in (_BINPUT, _LONG_BINPUT) and at + length <= size and _number(content, at, length) > count:
                return start
            at += length
        elif length in (_LINE, _TWO_LINES):
            number = 0
            for _ in range(-length):
                while at < size and content[at] != 10:
                    if 48 <= content[at] <= 57 and number < 1 << 50:
                        number = 10 * number + (content[at] - 48)
                    at += 1
                at += 1
            if code == _PUT and number > count:
                return start
        else:
            width = 1 if length == _LENGTH_1 else 4 if length == _LENGTH_4 else 8
            if at + width > size:
                return start
            wanted = _number(content, at, width)
            at += width
            if wanted < 0 or wanted > size - at:
                return start
            at += wanted
        if at > size:
            return start
    return size


@njit(cache=True)
@no_type_check
def _number(content, at, width):
    """Little-endian number; below 0 where it has 64 bits and is none that a file can be long."""
    number = 0
    for k in range(width):
        if k == 7 and content[at + k] > 127:
            return -1
        number |= np.int64(content[at + k]) << (8 * k)
    return number
