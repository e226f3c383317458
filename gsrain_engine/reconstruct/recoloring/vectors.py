"""Eight weights at a time inside compiled code: what LLVM does not turn into SIMD by itself, written as vectors."""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

LANES = 8
"""Pixels of a piece, one below the other."""

_FLOATS = ir.VectorType(ir.FloatType(), LANES)
_SHORTS = ir.VectorType(ir.IntType(16), LANES)
_CONTRACT = ("contract",)


@intrinsic
def add_piece(typing: Any, weights: Any, piece: Any, red: Any, green: Any, blue: Any, canvas: Any, place: Any) -> Any:
    """Add weights[piece, :] times (red, green, blue) to canvas[place], whose line has LANES reds, greens and blues."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        weights, piece, red, green, blue, canvas, place = arguments
        weight = _weights(context, builder, signature.args[0], weights, piece)
        line = _data(context, builder, signature.args[5], canvas)
        for channel, color in enumerate((red, green, blue)):
            at = _vector_at(builder, line, place, 3, channel)
            product = builder.fmul(weight, _splat(builder, color), flags=_CONTRACT)
            builder.store(builder.fadd(builder.load(at, align=4), product, flags=_CONTRACT), at, align=4)
        return context.get_dummy_value()

    return types.void(weights, types.intp, *[types.float32] * 3, canvas, types.intp), generate


@intrinsic
def sum_piece(typing: Any, weights: Any, piece: Any, canvas: Any, place: Any, lanes: Any) -> Any:
    """Add weights[piece, :] times canvas[place] to `lanes`, lane by lane and colour by colour."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        weights, piece, canvas, place, lanes = arguments
        weight = _weights(context, builder, signature.args[0], weights, piece)
        line = _data(context, builder, signature.args[2], canvas)
        sums = _data(context, builder, signature.args[4], lanes)
        zero = ir.Constant(place.type, 0)
        for channel in range(3):
            product = builder.fmul(
                weight, builder.load(_vector_at(builder, line, place, 3, channel), align=4), flags=_CONTRACT
            )
            at = _vector_at(builder, sums, zero, 3, channel)
            builder.store(builder.fadd(builder.load(at, align=4), product, flags=_CONTRACT), at, align=4)
        return context.get_dummy_value()

    return types.void(weights, types.intp, canvas, types.intp, lanes), generate


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    return context.make_array(kind)(context, builder, array).data


def _weights(context: Any, builder: Any, kind: Any, weights: Any, piece: Any) -> Any:
    """Load a row of uint16 and make it float32."""
    first = builder.gep(_data(context, builder, kind, weights), [builder.mul(piece, ir.Constant(piece.type, LANES))])
    return builder.uitofp(builder.load(builder.bitcast(first, _SHORTS.as_pointer()), align=2), _FLOATS)


def _vector_at(builder: Any, data: Any, row: Any, vectors: int, vector: int) -> Any:
    offset = builder.add(
        builder.mul(row, ir.Constant(row.type, vectors * LANES)), ir.Constant(row.type, vector * LANES)
    )
    return builder.bitcast(builder.gep(data, [offset]), _FLOATS.as_pointer())


def _splat(builder: Any, value: Any) -> Any:
    one = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_FLOATS, ir.Undefined), zeros)
