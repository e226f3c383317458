"""Blending weights of one view for fixed geometry: stored as a sparse matrix, or recomputed on each use."""

from dataclasses import dataclass
from typing import Any, no_type_check

import numba
import numpy as np
from jaxtyping import Float32, Int64, UInt8, UInt16
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from ..fast_math import FAST
from ..kernels import kernel, range_of
from ..render.cpu.compositing import ColorOperator
from ..render.cpu.tiles import TILE, absorb, alpha_at, columns_of, nothing, walk_column, walk_tiles

SplatColors = Float32[np.ndarray, "m 3"]
Picture = Float32[np.ndarray, "h w 3"]
Plane = Float32[np.ndarray, "h w"]
STEP = np.float32(1 / 65535)  # weights are stored as multiples of this
MIN_PIECE = 8  # smaller weights (0.03 % of all light on the built-in street, a fifth of their number) are dropped
LANES = 8  # pixels per piece, in vertical order
_PIECES = TILE * TILE // LANES


@dataclass(frozen=True, slots=True, eq=False)
class StoredWeights:
    """W of one view as a matrix in memory, tile by tile, nearest splat first.

    A pair is a splat that contributes to a tile. Only splats, pairs and pieces with a weight of at least `MIN_PIECE`
    are stored: occluded splats cost nothing.
    """

    width: int
    height: int
    rows: Int64[np.ndarray, " m"]
    """Row in the view's splats of each of the m stored splats, ascending."""
    pair_starts: Int64[np.ndarray, " tiles_and_one"]
    """Index of each tile's first pair."""
    splats: Int64[np.ndarray, " pairs"]
    """Splat of each pair, as an index into `rows`."""
    piece_starts: Int64[np.ndarray, " pairs_and_one"]
    """Index of each pair's first piece."""
    places: UInt8[np.ndarray, " pieces"]
    """Position of each piece in its tile, column by column."""
    weights: UInt16[np.ndarray, "pieces 8"]
    """In units of `STEP`."""

    @property
    def nbytes(self) -> int:
        arrays = (self.rows, self.pair_starts, self.splats, self.piece_starts, self.places, self.weights)
        return sum(each.nbytes for each in arrays)

    def blend(self, colors: SplatColors) -> Picture:
        image = np.empty((self.height, self.width, 3), np.float32)
        _blend(self.pair_starts, self.splats, self.piece_starts, self.places, self.weights, colors, image)
        return image

    def accumulate(self, image: Picture) -> SplatColors:
        """W transposed times an image: the weighted sum of its pixels for each splat."""
        by_pair = np.empty((len(self.splats), 3), np.float32)
        _gather(self.pair_starts, self.piece_starts, self.places, self.weights, image, by_pair)
        return self._by_splat(by_pair)

    def normal(self, colors: SplatColors, trust: Plane) -> SplatColors:
        """W transposed times trust times W times colors, tile by tile: weights are read from memory once."""
        by_pair = np.empty((len(self.splats), 3), np.float32)
        _normal(self.pair_starts, self.splats, self.piece_starts, self.places, self.weights, colors, trust, by_pair)
        return self._by_splat(by_pair)

    def squared_sums(self, trust: Plane) -> Float32[np.ndarray, " m"]:
        by_pair = np.zeros((len(self.splats), 3), np.float32)
        _squares(self.pair_starts, self.piece_starts, self.places, self.weights, trust, by_pair)
        return self._by_splat(by_pair)[:, 0]

    def _by_splat(self, by_pair: Float32[np.ndarray, "pairs 3"]) -> SplatColors:
        sums = np.zeros((len(self.rows), 3), np.float32)
        _add_pairs(self.splats, by_pair, sums)
        return sums


@dataclass(frozen=True, slots=True, eq=False)
class LazyWeights:
    """The same operator without storing W, for views beyond the memory limit; each use recomputes the tiles."""

    view: ColorOperator

    @property
    def rows(self) -> Int64[np.ndarray, " m"]:
        """All of the view's splats."""
        return np.arange(len(self.view.splats))

    @property
    def nbytes(self) -> int:
        """Bytes of splats and tile lists."""
        splats, tiles = self.view.splats, self.view.tiles
        return splats.shapes.nbytes + splats.colors.nbytes + splats.indices.nbytes + tiles.members.nbytes

    def blend(self, colors: SplatColors) -> Picture:
        return self.view.blend(colors)

    def accumulate(self, image: Picture) -> SplatColors:
        return self.view.accumulate(image)

    def normal(self, colors: SplatColors, trust: Plane) -> SplatColors:
        return self.view.accumulate(self.view.blend(colors) * trust[..., None])

    def squared_sums(self, trust: Plane) -> Float32[np.ndarray, " m"]:
        """Diagonal of W transposed times trust times W, with trust averaged over each splat."""
        trusted = self.view.accumulate(np.dstack([trust, np.ones_like(trust), trust]))
        return self.view.squared_sums() * trusted[:, 0] / np.maximum(trusted[:, 1], np.float32(1e-12))


def weights_of(view: ColorOperator, max_bytes: float = np.inf) -> StoredWeights | LazyWeights:
    """Store a view's weights if they fit into `max_bytes`; else recompute them on each use."""
    tiles, shapes = view.tiles, view.splats.shapes
    counts = np.zeros(len(tiles.members) + 1, np.int64)
    no_starts, no_places, no_weights = np.zeros(0, np.int64), np.zeros(0, np.uint8), np.zeros((0, LANES), np.uint16)
    _walk(tiles, shapes, (counts[1:], no_starts, no_places, no_weights))
    starts = np.cumsum(counts)
    pieces = int(starts[-1])
    if pieces * (1 + 2 * LANES) > max_bytes:
        return LazyWeights(view)
    places, weights = np.empty(pieces, np.uint8), np.empty((pieces, LANES), np.uint16)
    _walk(tiles, shapes, (counts[1:], starts, places, weights))
    contributes = counts[1:] > 0
    before = np.concatenate([[0], np.cumsum(contributes)])
    members = tiles.members[contributes]
    visible = np.zeros(len(view.splats), np.bool_)
    visible[members] = True
    numbers = np.cumsum(visible) - 1
    return StoredWeights(
        tiles.width, tiles.height, np.flatnonzero(visible), before[tiles.starts], numbers[members],
        starts[np.append(contributes, True)], places, weights,
    )  # fmt: skip


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _walk(portion, tiles, shapes, data):
    """Composite without colors: count each pair's pieces, and write them at `starts` unless those are empty."""
    walk_tiles(portion, tiles, shapes, shapes[:0, :0], 1, 1, nothing, _weigh_splat, nothing, data)


@numba.njit(inline="always", error_model="numpy", fastmath=FAST)
@no_type_check
def _weigh_splat(shapes, channels, j, x, y, state, steps, k, data):
    """Find the pieces of a splat; `data` has their numbers, starts, places and weights."""
    piece_starts = data[1]
    left, right = columns_of(shapes[j], x)
    found = 0
    for u in range(left, right):
        _weigh_column(shapes[j], u, x, y, state[u], steps)
        for half in range(TILE // LANES):
            largest = np.float32(0)
            for v in range(LANES):
                largest = max(largest, steps[half * LANES + v])
            if largest < MIN_PIECE:
                continue
            if len(piece_starts) > 0:
                data[2][piece_starts[k] + found] = u * (TILE // LANES) + half
                for v in range(LANES):
                    data[3][piece_starts[k] + found, v] = np.uint16(np.int32(steps[half * LANES + v]))
            found += 1
    data[0][k] = found


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _weigh_column(shape, u, x, y, line, steps):
    walk_column(shape, u, x, y, line, steps, _weigh, ())


@numba.njit(forceinline=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _weigh(line, v, dx, dy, falloff, steps, data):
    """Weight of a splat at one pixel, as in compositing, in units of `STEP`."""
    steps[v] = absorb(line, v, alpha_at(line, dx, dy, falloff)) * np.float32(65535) + np.float32(0.5)


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _blend_tile(tile, pair_starts, splats, piece_starts, places, weights, colors, canvas):
    """Write a tile's image, one row per piece: first all reds, then greens and blues."""
    canvas[:] = 0
    for k in range(pair_starts[tile], pair_starts[tile + 1]):
        n = splats[k]
        red, green, blue = colors[n, 0] * STEP, colors[n, 1] * STEP, colors[n, 2] * STEP
        for j in range(piece_starts[k], piece_starts[k + 1]):
            add_piece(weights, j, red, green, blue, canvas, np.intp(places[j]))


@numba.njit(error_model="numpy", fastmath=FAST)
@no_type_check
def _gather_tile(tile, pair_starts, piece_starts, places, weights, canvas, lanes, by_pair):
    for k in range(pair_starts[tile], pair_starts[tile + 1]):
        lanes[:] = 0
        for j in range(piece_starts[k], piece_starts[k + 1]):
            sum_piece(weights, j, canvas, np.intp(places[j]), lanes)
        for channel in range(3):
            total = np.float32(0)
            for v in range(LANES):
                total += lanes[channel * LANES + v]
            by_pair[k, channel] = total * STEP


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _normal(portion, pair_starts, splats, piece_starts, places, weights, colors, trust, by_pair):
    height, width = trust.shape
    columns = (width + TILE - 1) // TILE
    rows = (len(pair_starts) - 1) // columns
    for place in range_of(portion, len(pair_starts) - 1):
        tile = place % rows * columns + place // rows
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        canvas, lanes = np.empty((_PIECES, 3 * LANES), np.float32), np.empty(3 * LANES, np.float32)
        _blend_tile(tile, pair_starts, splats, piece_starts, places, weights, colors, canvas)
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                line, lane = canvas[u * (TILE // LANES) + v // LANES], v % LANES
                for channel in range(3):
                    line[channel * LANES + lane] *= trust[y0 + v, x0 + u]
        _gather_tile(tile, pair_starts, piece_starts, places, weights, canvas, lanes, by_pair)


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _blend(portion, pair_starts, splats, piece_starts, places, weights, colors, image):
    height, width = image.shape[0], image.shape[1]
    columns = (width + TILE - 1) // TILE
    rows = (len(pair_starts) - 1) // columns
    for place in range_of(portion, len(pair_starts) - 1):
        tile = place % rows * columns + place // rows
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        canvas = np.empty((_PIECES, 3 * LANES), np.float32)
        _blend_tile(tile, pair_starts, splats, piece_starts, places, weights, colors, canvas)
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                for channel in range(3):
                    image[y0 + v, x0 + u, channel] = canvas[u * (TILE // LANES) + v // LANES][
                        channel * LANES + v % LANES
                    ]


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _gather(portion, pair_starts, piece_starts, places, weights, image, by_pair):
    height, width = image.shape[0], image.shape[1]
    columns = (width + TILE - 1) // TILE
    rows = (len(pair_starts) - 1) // columns
    for place in range_of(portion, len(pair_starts) - 1):
        tile = place % rows * columns + place // rows
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        canvas, lanes = np.zeros((_PIECES, 3 * LANES), np.float32), np.empty(3 * LANES, np.float32)
        for v in range(min(TILE, height - y0)):
            for u in range(min(TILE, width - x0)):
                line, lane = canvas[u * (TILE // LANES) + v // LANES], v % LANES
                for channel in range(3):
                    line[channel * LANES + lane] = image[y0 + v, x0 + u, channel]
        _gather_tile(tile, pair_starts, piece_starts, places, weights, canvas, lanes, by_pair)


@kernel(parallel=True, error_model="numpy", fastmath=FAST)
@no_type_check
def _squares(portion, pair_starts, piece_starts, places, weights, trust, by_pair):
    height, width = trust.shape
    columns = (width + TILE - 1) // TILE
    for tile in range_of(portion, len(pair_starts) - 1):
        x0, y0 = (tile % columns) * TILE, (tile // columns) * TILE
        for k in range(pair_starts[tile], pair_starts[tile + 1]):
            total = np.float32(0)
            for j in range(piece_starts[k], piece_starts[k + 1]):
                x, y = x0 + places[j] // (TILE // LANES), y0 + places[j] % (TILE // LANES) * LANES
                for v in range(min(LANES, height - y)):
                    weight = np.float32(weights[j, v]) * STEP
                    total += weight * weight * trust[y + v, x]
            by_pair[k, 0] = total


@kernel()
@no_type_check
def _add_pairs(splats, by_pair, sums):
    for k in range(len(splats)):
        n = splats[k]
        for channel in range(3):
            sums[n, channel] += by_pair[k, channel]


# SIMD intrinsics
# Eight weights at a time, for loops that LLVM does not vectorize by itself.

_FLOATS = ir.VectorType(ir.FloatType(), LANES)
_SHORTS = ir.VectorType(ir.IntType(16), LANES)
_CONTRACT = ("contract",)


@intrinsic
def add_piece(typing: Any, weights: Any, piece: Any, red: Any, green: Any, blue: Any, canvas: Any, place: Any) -> Any:
    """Add weights[piece, :] times (red, green, blue) to canvas[place], whose row has LANES reds, greens and blues."""

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
    """Add weights[piece, :] times canvas[place] to `lanes`, per lane and channel."""

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
    """Load a row of uint16 as float32."""
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
