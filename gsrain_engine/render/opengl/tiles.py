"""Rasterizer of tiles: pairs of tile and splat in depth order, sorted by tile, blended in shared memory.

The splats are sorted by depth once; their pairs are then sorted by tile alone, stably, so that each tile has its splats
nearest first. The image is drawn in strips of tile rows if all its pairs don't fit into the buffers.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import moderngl
import numpy as np

from ..cpu.tiles import TILE
from .buffers import (
    SLOTS_BY_BLOCK,
    WORK_BYTES,
    GrowableBuffer,
    ProjectedSplatBuffer,
)
from .shaders import ComputeShader, GpuTimers, ShaderVariants, Switches, load_compute_shader
from .sort import KEYS, WORK, PrefixSum, RadixSort, total_in

_ORDER, _SLOTS, _COUNTS, _BLOCK_COUNTS, _PAIRS = 1, 2, 4, 5, 6  # storage bindings
_PICTURE, _DEPTHS, _LAMP_LIGHTS = 0, 1, 2  # image bindings
_FIRST_PAIRS = 1 << 20


class TileRasterizer:
    """Blends sorted splats front to back with compute shaders.

    Pairs are counted before they are written. The count of the frame before tells how much room is needed; it is waited
    for only if that is unknown or close to the limit, and `pairs_left_out` tells whether that was wrong.

    Args:
        context: OpenGL 4.3 or later.
        max_pairs: Limit of pairs at a time; None takes that of the driver's storage blocks.
    """

    def __init__(self, context: moderngl.Context, max_pairs: int | None = None) -> None:
        self._context = context
        limit = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        self._max_pairs = min(max_pairs or limit // 4, limit // 4)
        self._count, self._emit, self._blend = (
            ShaderVariants(context, f"tile_{name}.comp") for name in ("count", "emit", "blend")
        )
        self._ranges = load_compute_shader(context, "tile_ranges.comp")
        self._scan = PrefixSum(context)
        self._sort = RadixSort(context, limit)
        self._capacity = 0
        self._tile_counts, self._block_counts, self._starts = (GrowableBuffer(context) for _ in range(3))
        self._work = context.buffer(np.zeros(WORK_BYTES // 4, np.uint32))
        self._expected: int | None = None
        self._size = 0, 0

    def draw(
        self,
        store: ProjectedSplatBuffer,
        order: moderngl.Buffer,
        capacity: int,
        image: tuple[moderngl.Texture, moderngl.Texture | None, moderngl.Texture | None],
        switches: Switches,
        lights: Mapping[str, Any],
        timers: GpuTimers,
    ) -> None:
        """Draw splats into a texture of four floats.

        With WITH_DEPTH there is one of two (weighted depth and weight), with LAMPS one of four (the rain's light of
        lamps).

        Args:
            store: Projected splats.
            order: Slots, nearest first; their number is in the store's work.
            capacity: Largest number of visible splats.
            image: Textures of the same size.
            switches: LINEAR_RAIN, WITH_DEPTH, MEDIUM, LAMPS, ELLIPSOIDS, OVERDRAW: macros of tile_blend.comp.
            lights: Uniforms of tile_blend.comp for LINEAR_RAIN and MEDIUM.
            timers: For the stages `sort` and `draw`.
        """
        blocks = -(-capacity // SLOTS_BY_BLOCK)
        self._tile_counts.reserve(4 * max(capacity, 1))
        self._block_counts.reserve(4 * max(blocks, 1))
        size = image[0].size
        if size != self._size:
            self._size, self._expected = size, None
        switches = {**store.switches, **switches}
        for strip in self._strips(store, order, blocks, switches, timers):
            with timers.stage("sort"):
                self._bin(store, order, blocks, strip, switches)
            with timers.stage("draw"):
                self._blend_strip(store, strip, image, switches, lights)

    def pairs_left_out(self) -> int:
        """Number of pairs of the last image that had no room; waits for the GPU. The next image has room for them."""
        if self._expected is None:  # strips are only drawn if they fit
            return 0
        self._expected = total_in(self._work)
        return max(0, self._expected - self._capacity)

    @property
    def _tiles(self) -> tuple[int, int]:
        return -(-self._size[0] // TILE), -(-self._size[1] // TILE)

    def _strips(
        self, store: ProjectedSplatBuffer, order: moderngl.Buffer, blocks: int, switches: Switches, timers: GpuTimers
    ) -> Iterator[range]:
        """Ranges of tile rows whose pairs fit into the buffers; each has been counted when it is yielded."""
        columns, rows = self._tiles
        waiting = [range(rows)]
        while waiting:
            strip = waiting.pop()
            is_sure = len(strip) == rows and self._expected is not None and 2 * self._expected <= self._capacity
            with timers.stage("sort"):
                self._count_pairs(store, order, blocks, strip, switches)
            if not is_sure:
                pairs = total_in(self._work)
                if pairs > self._max_pairs:
                    if len(strip) == 1:
                        raise MemoryError(
                            f"a row of {columns} tiles has {pairs} fragments of splats; this OpenGL driver allows "
                            f"{self._max_pairs}"
                        )
                    half = len(strip) // 2
                    waiting += [strip[half:], strip[:half]]
                    continue
                if pairs > self._capacity:
                    self._grow(pairs)
                    waiting.append(strip)  # is counted once more, now with the new limit
                    continue
                self._expected = pairs if len(strip) == rows else None
            yield strip

    def _grow(self, pairs: int) -> None:
        """Make room for twice as many pairs, or for as many as the graphics card can hold."""
        for wanted in (2 * pairs, pairs):
            room = min(max(wanted, _FIRST_PAIRS), self._max_pairs)
            try:
                self._sort.reserve(room)
            except MemoryError:
                self._capacity = 0
                if room <= pairs:
                    raise
                continue
            self._capacity = room
            return

    def _count_pairs(
        self, store: ProjectedSplatBuffer, order: moderngl.Buffer, blocks: int, strip: range, switches: Switches
    ) -> None:
        """Count the tiles of each splat; scan the counts by blocks, and write the pairs' number."""
        shader = self._with_tiles(self._count(switches), strip)
        store.bind_records()
        store.work.bind_to_storage_buffer(WORK)
        order.bind_to_storage_buffer(_ORDER)
        self._tile_counts.bind(_COUNTS)
        self._block_counts.bind(_BLOCK_COUNTS)
        shader.run_all(blocks)
        self._context.memory_barrier()
        self._scan.run(
            self._block_counts.buffer, self._work, blocks, max_elements=self._capacity,
            found=(store.work, 0, 1),
        )  # fmt: skip

    def _bin(
        self, store: ProjectedSplatBuffer, order: moderngl.Buffer, blocks: int, strip: range, switches: Switches
    ) -> None:
        """Write the pairs and sort them by tile."""
        columns, _ = self._tiles
        tile_count = columns * len(strip)
        shader = self._with_tiles(self._emit(switches), strip)
        keys, slots = self._sort.unsorted
        store.bind_records()
        for binding, buffer in (
            (KEYS, keys), (_ORDER, order), (_SLOTS, slots), (_PAIRS, self._work), (WORK, store.work),
        ):  # fmt: skip
            buffer.bind_to_storage_buffer(binding)
        self._tile_counts.bind(_COUNTS)
        self._block_counts.bind(_BLOCK_COUNTS)
        shader.run_all(blocks)
        self._context.memory_barrier()
        keys, slots = self._sort.sort_pairs(self._work, tile_count.bit_length())
        self._starts.reserve(4 * (tile_count + 1))
        keys.bind_to_storage_buffer(KEYS)
        slots.bind_to_storage_buffer(_SLOTS)
        self._starts.bind(_COUNTS)
        self._work.bind_to_storage_buffer(WORK)
        self._ranges.set(tile_count=tile_count)
        self._ranges.run(-(-(tile_count + 1) // SLOTS_BY_BLOCK))
        self._context.memory_barrier()

    def _blend_strip(
        self,
        store: ProjectedSplatBuffer,
        strip: range,
        image: tuple[moderngl.Texture, moderngl.Texture | None, moderngl.Texture | None],
        switches: Switches,
        lights: Mapping[str, Any],
    ) -> None:
        shader = self._with_tiles(self._blend(switches), strip)
        shader.set(image_size=self._size, **lights)
        store.bind_records()
        self._starts.bind(_COUNTS)
        picture, depths, lamp_lights = image
        picture.bind_to_image(_PICTURE, read=False, write=True)
        if depths is not None:
            depths.bind_to_image(_DEPTHS, read=False, write=True)
        if lamp_lights is not None:
            lamp_lights.bind_to_image(_LAMP_LIGHTS, read=False, write=True)
        shader.run(self._tiles[0], len(strip))
        self._context.memory_barrier()

    def _with_tiles(self, shader: ComputeShader, strip: range) -> ComputeShader:
        shader.set(tiles=(self._tiles[0], len(strip)), first_row=strip.start)
        return shader
