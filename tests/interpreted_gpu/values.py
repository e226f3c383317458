"""Values of GLSL, its functions, and how both lie in memory. Vectors and matrices never change: assignments copy."""

import math
import struct
from dataclasses import dataclass

import numpy as np

ALL = 0xFFFFFFFF
UNDEFINED = 0xCDCDCDCD


class UnsupportedError(Exception):
    """GLSL that is not known here."""


class Vec:
    __slots__ = ("kind", "parts")

    def __init__(self, kind, parts):
        self.kind, self.parts = kind, tuple(parts)

    def combined(self, other, operation):
        kind = self.kind
        if isinstance(other, Vec):
            kind = "f" if other.kind == "f" else kind
            return Vec(kind, [_wrapped(kind, operation(a, b)) for a, b in zip(self.parts, other.parts, strict=True)])
        kind = "f" if isinstance(other, float) else kind
        return Vec(kind, [_wrapped(kind, operation(a, other)) for a in self.parts])

    def __add__(self, other):
        return self.combined(other, lambda a, b: a + b)

    def __sub__(self, other):
        return self.combined(other, lambda a, b: a - b)

    def __mul__(self, other):
        if isinstance(other, Mat):
            return Vec("f", [dot(self, column) for column in other.parts])
        return self.combined(other, lambda a, b: a * b)

    def __truediv__(self, other):
        return self.combined(other, quotient if "f" in (self.kind, getattr(other, "kind", "f")) else whole_quotient)

    def __rshift__(self, other):
        return self.combined(other, lambda a, b: a >> b)

    def __and__(self, other):
        return self.combined(other, lambda a, b: a & b)

    def __xor__(self, other):
        return self.combined(other, lambda a, b: a ^ b)

    def __neg__(self):
        return Vec(self.kind, [_wrapped(self.kind, -each) for each in self.parts])

    __radd__, __rmul__ = __add__, __mul__


class Mat:
    __slots__ = ("parts",)

    def __init__(self, columns):
        self.parts = tuple(columns)

    def __mul__(self, other):
        if isinstance(other, Vec):
            total = self.parts[0] * other.parts[0]
            for column, share in zip(self.parts[1:], other.parts[1:], strict=True):
                total = total + column * share
            return total
        return Mat(self * column for column in other.parts)


def _wrapped(kind, value):
    if kind == "u":
        return value & ALL
    return signed(value) if kind == "i" else value


def signed(value):
    return ((value + 0x80000000) & ALL) - 0x80000000


def quotient(a, b):
    if b:
        return a / b
    return math.nan if a == 0 or a != a else math.copysign(math.inf, a) * math.copysign(1.0, b)


def whole_quotient(a, b):
    return int(abs(a) // abs(b)) * (1 if (a < 0) == (b < 0) else -1) if b else ALL


def remainder(a, b):
    return a - b * whole_quotient(a, b)


def _or_nan(function):
    def safe(*values):
        try:
            return function(*values)
        except (ValueError, OverflowError):
            return math.nan

    return safe


def _by_parts(function, kind=None):
    def mapped(*values):
        size = next((len(each.parts) for each in values if isinstance(each, Vec)), 0)
        if not size:
            return function(*values)
        rows = [each.parts if isinstance(each, Vec) else (each,) * size for each in values]
        return Vec(kind or values[0].kind, [function(*row) for row in zip(*rows, strict=True)])

    return mapped


def dot(a, b):
    return math.fsum(x * y for x, y in zip(a.parts, b.parts, strict=True))


def _length(a):
    return math.sqrt(dot(a, a)) if isinstance(a, Vec) else abs(a)


def _cross(a, b):
    (x, y, z), (u, v, w) = a.parts, b.parts
    return Vec("f", (y * w - v * z, z * u - w * x, x * v - u * y))


def _word(number):
    try:
        return struct.unpack("<I", struct.pack("<f", number))[0]
    except OverflowError:
        return 0x7F800000 if number > 0 else 0xFF800000


def _number(word):
    return struct.unpack("<f", struct.pack("<I", word))[0]


def _half_words(pair):
    with np.errstate(over="ignore"):
        low, high = np.array(pair.parts, np.float16).view(np.uint16).tolist()
    return low | high << 16


def _halves(word):
    return Vec("f", np.array([word & 0xFFFF, word >> 16], np.uint16).view(np.float16).astype(float).tolist())


def _bits(value, offset, count):
    bits = value >> offset & ((1 << count) - 1)
    return bits - (1 << count) if bits >> (count - 1) else bits  # of ints, the only ones that are cut here


SAME = {  # the result has the type of the first argument, or of those that are combined
    "abs": _by_parts(abs), "floor": _by_parts(_or_nan(math.floor)),
    "ceil": _by_parts(_or_nan(math.ceil)), "sqrt": _by_parts(_or_nan(math.sqrt)),
    "exp": _by_parts(_or_nan(math.exp)), "exp2": _by_parts(_or_nan(lambda a: 2.0**a)),
    "log": _by_parts(_or_nan(lambda a: math.log(a) if a else -math.inf)),
    "log2": _by_parts(_or_nan(lambda a: math.log2(a) if a else -math.inf)),
    "inversesqrt": _by_parts(_or_nan(lambda a: 1 / math.sqrt(a) if a else math.inf)), "roundEven": _by_parts(round),
    "pow": _by_parts(_or_nan(math.pow)), "min": _by_parts(lambda a, b: b if b < a else a),
    "max": _by_parts(lambda a, b: b if a < b else a), "clamp": _by_parts(lambda a, low, high: min(max(a, low), high)),
    "mix": _by_parts(
        lambda a, b, share: (b if share else a) if isinstance(share, bool) else a * (1 - share) + b * share
    ),
    "normalize": lambda a: a / _length(a), "cross": _cross, "bitfieldExtract": _bits,
}  # fmt: skip
OF_TYPE = {
    "dot": ("float", dot), "length": ("float", _length), "bitCount": ("int", int.bit_count),
    "findLSB": ("int", lambda a: (a & -a).bit_length() - 1), "any": ("bool", lambda a: any(a.parts)),
    "all": ("bool", lambda a: all(a.parts)), "packHalf2x16": ("uint", _half_words), "unpackHalf2x16": ("vec2", _halves),
    "floatBitsToUint": ("uint", _word), "uintBitsToFloat": ("float", _number),
}  # fmt: skip
COMPARED = {
    "lessThan": _by_parts(lambda a, b: a < b, "b"), "greaterThan": _by_parts(lambda a, b: a > b, "b"),
    "lessThanEqual": _by_parts(lambda a, b: a <= b, "b"), "greaterThanEqual": _by_parts(lambda a, b: a >= b, "b"),
    "isnan": _by_parts(math.isnan, "b"), "isinf": _by_parts(math.isinf, "b"),
}  # fmt: skip

SCALARS = {"bool": "b", "int": "i", "uint": "u", "float": "f"}
VECTORS = {f"{p}vec{n}": (kind, n) for p, kind in (("", "f"), ("i", "i"), ("u", "u"), ("b", "b")) for n in (2, 3, 4)}
MATRICES = {f"mat{n}": (n, n) for n in (2, 3, 4)} | {
    f"mat{c}x{r}": (c, r) for c in (2, 3, 4) for r in (2, 3, 4)
}  # columns, rows
LETTERS = dict(zip("xyzwrgbastpq", (0, 1, 2, 3) * 3, strict=True))
SCALAR_OF = {kind: name for name, kind in SCALARS.items()}


def vector_type(kind, size):
    return {"f": "", "i": "i", "u": "u", "b": "b"}[kind] + f"vec{size}"


def _cast(kind, value):
    if kind == "f":
        return float(value)
    if kind == "b":
        return bool(value)
    whole = int(value) if math.isfinite(value) else 0
    return _wrapped(kind, whole)


def constructed(name, *values):
    if name in SCALARS:
        first = values[0].parts[0] if isinstance(values[0], Vec) else values[0]
        return _cast(SCALARS[name], first)
    if name in VECTORS:
        kind, size = VECTORS[name]
        flat = [part for each in values for part in (each.parts if isinstance(each, Vec) else (each,))]
        flat = flat * size if len(flat) == 1 else flat[:size]
        return Vec(kind, [_cast(kind, each) for each in flat])
    columns, rows = MATRICES[name]
    if isinstance(values[0], Mat):
        return Mat(Vec("f", column.parts[:rows]) for column in values[0].parts[:columns])
    flat = [float(part) for each in values for part in (each.parts if isinstance(each, Vec) else (each,))]
    return Mat(Vec("f", flat[c * rows : (c + 1) * rows]) for c in range(columns))


def put(value, path, new):
    """Replace a part of a local value: a field, or an index."""
    head, rest = path[0], path[1:]
    if isinstance(value, dict):
        return {**value, head: put(value[head], rest, new) if rest else new}
    parts = list(value.parts)
    parts[head] = put(parts[head], rest, new) if rest else new
    return Mat(parts) if isinstance(value, Mat) else Vec(value.kind, parts)


@dataclass(frozen=True)
class Codec:
    """A type in memory, by the rules of std430: words of 32 bits."""

    type: object
    size: int
    alignment: int
    members: tuple = ()
    """Of a struct: name, offset, codec. Of an array: one codec; `size` is then the stride times the count."""

    def decode(self, words, at):
        if self.type in SCALARS:
            word = words[at]
            return word if self.type == "uint" else _number(word) if self.type == "float" else signed(word)
        if self.type not in VECTORS:
            return {name: codec.decode(words, at + offset) for name, offset, codec in self.members}
        kind, size = VECTORS[self.type]
        return Vec(kind, [CODECS[SCALAR_OF[kind]].decode(words, at + k) for k in range(size)])

    def encode(self, value):
        if self.type in SCALARS:
            return [_word(value) if self.type == "float" else int(value) & ALL]
        if self.type in VECTORS:
            each = CODECS[SCALAR_OF[VECTORS[self.type][0]]]
            return [word for part in value.parts for word in each.encode(part)]
        words = [UNDEFINED] * self.size
        for name, offset, codec in self.members:
            words[offset : offset + codec.size] = codec.encode(value[name])
        return words


CODECS = {name: Codec(name, 1, 1) for name in SCALARS}
CODECS |= {name: Codec(name, size, 2 if size == 2 else 4) for name, (_, size) in VECTORS.items()}


def array_codec(codec, count):
    stride = -(-codec.size // codec.alignment) * codec.alignment
    return Codec(("array", stride, count), stride * (count or 0), codec.alignment, (codec,))


def struct_codec(name, fields):
    at, alignment, members = 0, 1, []
    for codec, field in fields:
        at = -(-at // codec.alignment) * codec.alignment
        members.append((field, at, codec))
        at, alignment = at + codec.size, max(alignment, codec.alignment)
    return Codec(name, -(-at // alignment) * alignment, alignment, tuple(members))


RUNTIME = {
    "put": put, "signed": signed, "quotient": quotient, "whole_quotient": whole_quotient,
    "remainder": remainder, "constructed": constructed,
    "swizzled": lambda value, places: Vec(value.kind, [value.parts[k] for k in places]),
    "atomic_add": lambda a, b: a + b & ALL, "atomic_or": lambda a, b: a | b,
    **{f"g_{name}": function for name, function in {**SAME, **COMPARED}.items()},
    **{f"g_{name}": function for name, (_, function) in OF_TYPE.items()},
}  # fmt: skip
