"""GPU buffers of Gaussians, masks and projected splats, uploaded in slices to keep frames smooth."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import moderngl
import numpy as np
from jaxtyping import Float32, Int64, UInt8

from ...scene.flags import BitMask
from ...scene.gaussians import Gaussians
from .shaders import Switches

CHUNK = 1 << 19
"""Gaussians per buffer, as in splat_project.comp: 96 MiB at SH degree 3; llvmpipe's storage blocks have up to 128."""

RESTING_BYTES = 1 << 29
"""Memory for arrays that are no longer drawn, so that undo or the other image of a split view finds them."""

Harmonics = Literal["single", "half", "byte"]
"""GPU storage of colors: 32-bit floats; halves; or the first harmonic in halves and the others in signed bytes.

Reading them limits the frame rate on a GPU: 192, 96 or 56 bytes per Gaussian at SH degree 3.
"""

SH_BITS: dict[Harmonics, int] = {"single": 32, "half": 16, "byte": 8}  # value of the shader macro `SH_BITS`


@dataclass(frozen=True, slots=True)
class GaussianBuffers:
    """Buffers of one set of Gaussians, one per chunk; the first four are bound in this order from binding 0 on."""

    means_opacities: list[moderngl.Buffer]
    scales: list[moderngl.Buffer]
    quaternions: list[moderngl.Buffer]
    sh: list[moderngl.Buffer]
    wet_sh: list[moderngl.Buffer] = field(default_factory=list[moderngl.Buffer])
    """Wet colors; empty if not requested."""

    def chunks(self) -> Iterator[tuple[moderngl.Buffer, ...]]:
        return zip(self.means_opacities, self.scales, self.quaternions, self.sh, strict=True)


WetColors = Float32[np.ndarray, "n k 3"] | None  # second set of harmonics for the same Gaussians, or None
_Key = tuple[int, ...]
_Arrays = tuple[Float32[np.ndarray, "..."], ...]


@dataclass(slots=True)
class _Upload:
    """One array on the GPU, with a reference to its source so that the key (its identity) stays unique."""

    sources: tuple[Any, ...]
    buffers: list[moderngl.Buffer]
    is_awaited: bool = True
    """Uploaded before its first frame."""


class GpuArrays:
    """Uploads arrays on first use and finds them by identity.

    Gaussians are immutable, so two sets that share an array (the same geometry in other colors) share its buffers.
    Those of a single frame, such as haze, have buffers of their own, which remain and grow.
    """

    def __init__(self, context: moderngl.Context, harmonics: Harmonics = "half") -> None:
        self._context = context
        self.harmonics: Harmonics = harmonics
        self._arrays: dict[_Key, _Upload] = {}
        """Least recently drawn first."""
        self.masks: dict[_Key, _Upload] = {}
        """Masks and lists of members of the current frame, by the identity of their words."""
        self._used: set[_Key] = set()
        self._leaving: list[moderngl.Buffer] = []
        self._passing = Gaussians.empty()
        self._passing_buffers: list[list[GrowableBuffer]] = []
        """Of each chunk of those, in the order of `GaussianBuffers`."""

    def buffers(self, gaussians: Gaussians, wet_sh: WetColors = None) -> GaussianBuffers:
        """Return the buffers of a set and of its wet colors, uploading missing ones."""
        for _ in self.upload(gaussians, CHUNK, wet_sh=wet_sh):
            pass
        drawn = GaussianBuffers(*map(self._use, _sources(gaussians, wet_sh)))
        return replace(drawn, wet_sh=drawn.sh) if wet_sh is gaussians.sh else drawn  # one array has one key

    def passing_buffers(self, gaussians: Gaussians) -> GaussianBuffers:
        """Return buffers of Gaussians of one frame, which are written over those of the frame before."""
        chunks = range(0, len(gaussians), CHUNK)
        if gaussians is not self._passing:
            while len(self._passing_buffers) < len(chunks):
                self._passing_buffers.append([GrowableBuffer(self._context) for _ in _sources(gaussians)])
            for start, buffers in zip(chunks, self._passing_buffers, strict=False):
                for sources, buffer in zip(_sources(gaussians).values(), buffers, strict=True):
                    data = self._packed(sources, slice(start, start + CHUNK))
                    buffer.reserve(data.nbytes).write(data)
            self._passing = gaussians
        filled = self._passing_buffers[: len(chunks)]
        return GaussianBuffers(*([each[k].buffer for each in filled] for k in range(len(_sources(gaussians)))))

    def keep(self, wet_sh: WetColors) -> None:
        """Mark uploaded wet colors as used: at a wetness of 0 they are not read, but the next frame may need them."""
        if (id(wet_sh),) in self._arrays:
            self._use((id(wet_sh),))

    def _use(self, key: _Key) -> list[moderngl.Buffer]:
        self._used.add(key)
        array = self._arrays[key] = self._arrays.pop(key)  # moved to the end: most recently drawn
        array.is_awaited = False
        return array.buffers

    def upload(
        self, gaussians: Gaussians, slice_size: int = CHUNK // 64, *, wet_sh: WetColors = None
    ) -> Iterator[float]:
        """Upload a set slice by slice; yields the fraction done after each, so that frames can be drawn in between.

        Raises `MemoryError` if the graphics card is full.
        """
        missing = {key: each for key, each in _sources(gaussians, wet_sh).items() if key not in self._arrays}
        steps, done = max(1, len(missing) * -(-len(gaussians) // slice_size)), 0
        for key, sources in missing.items():
            array = _Upload(sources, [])
            try:
                for _ in self._written(array, slice_size):
                    done += 1
                    yield done / steps
            except BaseException:  # the upload was abandoned, or the card is full
                self._leaving += array.buffers
                raise
            if key in self._arrays:  # a frame has uploaded it meanwhile
                self._leaving += array.buffers
            else:
                self._arrays[key] = array

    def _written(self, array: _Upload, slice_size: int) -> Iterator[None]:
        """Create an array's buffers and fill them, one slice per step."""
        count, row_bytes = len(array.sources[0]), self._packed(array.sources, slice(0, 1)).shape[1]
        for start in range(0, count, CHUNK):
            array.buffers.append(reserve_buffer(self._context, row_bytes * min(CHUNK, count - start)))
        for start in range(0, count, slice_size):
            for at in range(start, min(start + slice_size, count), CHUNK):
                stop = min(at + CHUNK - at % CHUNK, start + slice_size, count)
                data = self._packed(array.sources, slice(at, stop))
                array.buffers[at // CHUNK].write(data, offset=row_bytes * (at % CHUNK))
            yield

    def missing(self, gaussians: Gaussians, wet_sh: WetColors = None) -> int:
        """Number of Gaussians to be uploaded before these can be drawn: all if any array is missing, or else 0."""
        return 0 if _sources(gaussians, wet_sh).keys() <= self._arrays.keys() else len(gaussians)

    def marks(self, left_out: BitMask | None, selected: BitMask | None) -> list[moderngl.Buffer]:
        """Return the bits of both masks, interleaved by word, one buffer per chunk; empty without masks."""
        if left_out is None and selected is None:
            return []
        words = [each.words if each is not None else None for each in (left_out, selected)]
        key = tuple(map(id, words))
        self._used.add(key)
        if key not in self.masks:
            pairs = np.zeros((max(len(each) for each in words if each is not None), 2), np.uint32)
            for column, each in enumerate(words):
                if each is not None:
                    pairs[:, column] = each
            step = CHUNK // 32
            chunks = [self._context.buffer(pairs[start : start + step]) for start in range(0, len(pairs), step)]
            self.masks[key] = _Upload(tuple(words), chunks)
        return self.masks[key].buffers

    def members(self, members: Int64[np.ndarray, " m"], selected: BitMask | None) -> moderngl.Buffer:
        """Return the numbers of a part's members, in the layout of splat_project.comp."""
        key = (id(members), id(selected))
        self._used.add(key)
        if key not in self.masks:
            numbers = members.astype(np.uint32)
            if selected is not None:
                numbers |= selected.flags[members].astype(np.uint32) << np.uint32(31)
            self.masks[key] = _Upload((members, selected), [self._context.buffer(numbers)])
        return self.masks[key].buffers[0]

    def release_unused(self) -> None:
        """Free arrays that were not used since the last call, one buffer per call, since freeing takes time.

        Arrays uploaded before their first frame stay, as do recently drawn ones up to `RESTING_BYTES`.
        """
        self._drop(self.masks, [key for key in self.masks if key not in self._used])
        room = RESTING_BYTES
        for key, array in reversed(list(self._arrays.items())):
            if key not in self._used and not array.is_awaited:
                room -= sum(buffer.size for buffer in array.buffers)
                if room < 0:
                    self._drop(self._arrays, [key])
        self._used.clear()
        if self._leaving:
            self._leaving.pop().release()

    def release_awaited(self) -> None:
        """Free arrays that were uploaded before their first frame and have not been drawn yet."""
        self._drop(self._arrays, [key for key, array in self._arrays.items() if array.is_awaited])

    def release_all_but(self, used: Iterable[tuple[Gaussians, WetColors]]) -> None:
        """Free all arrays except those of some sets and their wet colors, for a new scene."""
        keys = {key for each in used for key in _sources(*each)}
        self._drop(self._arrays, [key for key in self._arrays if key not in keys])

    def release_everything(self) -> None:
        """Free everything immediately. No upload may be in progress."""
        self.release_all_but(())
        self._drop(self.masks, list(self.masks))
        while self._leaving:
            self._leaving.pop().release()

    def _drop(self, arrays: dict[_Key, _Upload], keys: list[_Key]) -> None:
        for key in keys:
            self._leaving += arrays.pop(key).buffers

    def keep_harmonics_as(self, harmonics: Harmonics) -> None:
        """Change the storage of colors; uploaded ones are replaced for their next frame.

        No upload may be in progress.
        """
        self.harmonics = harmonics
        self._passing = Gaussians.empty()
        for key in [key for key, array in self._arrays.items() if array.sources[0].ndim == 3]:
            for buffer in self._arrays.pop(key).buffers:
                buffer.release()

    def _packed(self, sources: _Arrays, rows: slice) -> UInt8[np.ndarray, "m bytes"]:
        """Rows in the shader's layout: means with opacities, harmonics in their storage, the rest unchanged."""
        first = sources[0][rows]
        if len(sources) == 2:
            return _as_bytes(np.concatenate([first, sources[1][rows][:, None]], axis=1))
        return packed_harmonics(first, self.harmonics) if first.ndim == 3 else _as_bytes(np.ascontiguousarray(first))


def _sources(gaussians: Gaussians, wet_sh: WetColors = None) -> dict[_Key, _Arrays]:
    """Arrays of a set in the order of `GaussianBuffers`, by their identities."""
    g = gaussians
    arrays = [(g.means, g.opacities), (g.scales,), (g.quaternions,), (g.sh,), *([] if wet_sh is None else [(wet_sh,)])]
    return {tuple(map(id, each)): each for each in arrays}


def packed_harmonics(sh: Float32[np.ndarray, "m k 3"], storage: Harmonics) -> UInt8[np.ndarray, "m bytes"]:
    """Harmonics in the layout of splat_project.comp; rows are whole 32-bit words.

    Bytes store n/127 of a Gaussian's largest coefficient after the first harmonic; that number is stored as a half,
    next to the three of the first harmonic.
    """
    flat = np.ascontiguousarray(sh).reshape(len(sh), 3 * sh.shape[1])
    if storage == "single":
        return _as_bytes(flat)
    if storage == "half":
        return _as_bytes(_padded(_halves(flat), 2))
    rest = flat[:, 3:]
    step = _halves(np.max(np.abs(rest), axis=1, initial=0.0, keepdims=True) / np.float32(127))
    safe = np.where(step > 0, step, np.float16(1)).astype(np.float32)
    levels = np.clip(np.rint(rest / safe), -127, 127).astype(np.int8)
    head = _as_bytes(np.concatenate([_halves(flat[:, :3]), step], axis=1))
    return np.concatenate([head, _padded(_as_bytes(levels), 4)], axis=1)


def _halves(values: Float32[np.ndarray, "m n"]) -> "np.ndarray[tuple[int, int], np.dtype[np.float16]]":
    return np.clip(values, -65504, 65504).astype(np.float16)


def _padded(rows: "np.ndarray[Any, np.dtype[Any]]", multiple: int) -> "np.ndarray[Any, np.dtype[Any]]":
    return np.pad(rows, ((0, 0), (0, -rows.shape[1] % multiple)))


def _as_bytes(rows: "np.ndarray[Any, np.dtype[Any]]") -> UInt8[np.ndarray, "m bytes"]:
    return rows.view(np.uint8).reshape(len(rows), rows.shape[1] * rows.itemsize)


# GPU memory
# OpenGL reports a lack of memory only when queried.

_MAX_ERRORS = 8  # each kind of error is queued at most once; a lost context returns errors forever


def reserve_buffer(context: moderngl.Context, size: int) -> moderngl.Buffer:
    """Create a buffer of `size` bytes; raises `MemoryError` if the graphics card is full."""
    buffer = None
    try:
        buffer = context.buffer(reserve=size)
        check_gpu_memory(context, size)
    except moderngl.Error:
        raise _full_card(size) from None
    except MemoryError:
        if buffer is not None:
            buffer.release()
        raise
    return buffer


def check_gpu_memory(context: moderngl.Context, size: int) -> None:
    """Raise `MemoryError` if the driver failed to allocate the object of `size` bytes just created."""
    for _ in range(_MAX_ERRORS):
        error = context.error
        if error == "GL_OUT_OF_MEMORY":
            raise _full_card(size)
        if error == "GL_NO_ERROR":
            return


def _full_card(size: int) -> MemoryError:
    return MemoryError(f"the graphics card has no room for {max(1, size >> 20)} MiB more")


def sized_target(
    context: moderngl.Context, present: moderngl.Framebuffer | None, size: tuple[int, int]
) -> moderngl.Framebuffer:
    """Return a framebuffer of a size with color and depth: the present one if it fits, which is released otherwise."""
    if present is not None and present.size == size:
        return present
    if present is not None:
        for old in (*present.color_attachments, present.depth_attachment, present):
            old.release()
    return context.framebuffer([context.texture(size, 4)], context.depth_renderbuffer(size))


class GrowableBuffer:
    """Storage buffer that is replaced by a larger one on demand; its content is lost."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self.buffer = context.buffer(reserve=4)
        """Current buffer; replaced when it grows."""

    def reserve(self, size: int, at_most: int | None = None) -> moderngl.Buffer:
        """Make room for `size` bytes; grows with an eighth to spare, but to at most `at_most` bytes.

        Raises `MemoryError` if the graphics card is full.
        """
        if size > self.buffer.size:
            self.buffer.release()
            self.buffer = self._context.buffer(reserve=4)  # valid even if the next allocation fails
            roomy = size + size // 32 * 4
            self.buffer = reserve_buffer(self._context, roomy if at_most is None else max(size, min(roomy, at_most)))
        return self.buffer

    def bind(self, binding: int) -> None:
        self.buffer.bind_to_storage_buffer(binding)


# Projected splats

SLOTS_BY_BLOCK = 256  # slots that one workgroup of a projection fills, from the front; each dispatch starts a new block

WORK_BYTES = 4 * 7
"""The draw's command (5 numbers), the number of elements, and that including those beyond the limit; as in
visible_scan.comp.
"""

COUNT_OFFSET, TOTAL_OFFSET = 20, 24
"""Byte offsets in it."""

_SPLAT_BYTES, _MAX_RECORD_BLOCKS = 32, 4
_RECORDS, _SPARSE_KEYS, _COUNTS, _WORK = 8, 4, 5, 7


class ProjectedSplatBuffer:
    """Buffers of projected splats: records in blocks, sort keys, counts; `switches` are the matching shader macros."""

    def __init__(self, context: moderngl.Context) -> None:
        self._limit = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        self._block_shift = (self._limit // _SPLAT_BYTES).bit_length() - 1
        self._records = [GrowableBuffer(context) for _ in range(_MAX_RECORD_BLOCKS)]
        self._record_blocks = 1
        self._sparse_keys = GrowableBuffer(context)
        self.counts = GrowableBuffer(context)
        """Visible splats per block; after the prefix sum, the offset of each block."""
        self.work = context.buffer(reserve=WORK_BYTES)
        """Number of visible splats, and the draw's command; see `WORK_BYTES`."""

    @property
    def switches(self) -> Switches:
        return {"SPLAT_BLOCKS": self._record_blocks, "BLOCK_SHIFT": self._block_shift}

    def reserve(self, slots: int) -> None:
        """Make room for `slots`, a multiple of 256.

        Raises `MemoryError` if they exceed the driver's storage blocks.
        """
        by_block = 1 << self._block_shift
        if slots > _MAX_RECORD_BLOCKS * by_block:
            raise MemoryError(
                f"{slots} Gaussians need {_SPLAT_BYTES * slots >> 20} MiB of storage blocks; "
                f"this OpenGL driver allows {_MAX_RECORD_BLOCKS} of {self._limit >> 20} MiB"
            )
        self._record_blocks = max(1, -(-slots // by_block))
        for number in range(self._record_blocks):
            self._records[number].reserve(_SPLAT_BYTES * min(by_block, slots - number * by_block), at_most=self._limit)
        self._sparse_keys.reserve(4 * slots)
        self.counts.reserve(4 * (slots // SLOTS_BY_BLOCK))

    def bind_records(self) -> None:
        for number in range(self._record_blocks):
            self._records[number].bind(_RECORDS + number)

    def bind(self) -> None:
        self.bind_records()
        self._sparse_keys.bind(_SPARSE_KEYS)
        self.counts.bind(_COUNTS)
        self.work.bind_to_storage_buffer(_WORK)
