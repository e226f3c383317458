"""Gaussians on the GPU: one set of buffers an array, uploaded once, in slices where a frame must not stall."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import moderngl
import numpy as np
from jaxtyping import Float32, UInt8, UInt32

from ...scene.flags import BitMask
from ...scene.gaussians import Gaussians
from .prefix_sum import WORK_BYTES
from .shaders import Switches

CHUNK = 1 << 19
"""Gaussians a buffer: at SH degree 3 that is 96 MiB, below the 128 MiB that a storage block may have on llvmpipe."""

_RESTING_BYTES = 1 << 29
"""Of arrays that nobody draws any more: a step back in the history, or the other of two pictures, finds them here."""

Harmonics = Literal["single", "half", "byte"]
"""How colours lie on the GPU: 32-bit floats; halves; or the first harmonic in halves and the others in signed bytes.

Reading them is what bounds a frame on a GPU: 192, 96 or 56 bytes a Gaussian at SH degree 3.
"""

SH_BITS: dict[Harmonics, int] = {"single": 32, "half": 16, "byte": 8}
"""The shaders' name for each."""


@dataclass(frozen=True, slots=True)
class GaussianBuffers:
    """The buffers of one set of Gaussians, a chunk each; the first four are bound in this order from binding 0 on."""

    means_opacities: list[moderngl.Buffer]
    scales: list[moderngl.Buffer]
    quaternions: list[moderngl.Buffer]
    sh: list[moderngl.Buffer]
    wet_sh: list[moderngl.Buffer] = field(default_factory=list[moderngl.Buffer])
    """Of the wet colours; none where they were not asked for."""

    def chunks(self) -> Iterator[tuple[moderngl.Buffer, ...]]:
        return zip(self.means_opacities, self.scales, self.quaternions, self.sh, strict=True)


WetColors = Float32[np.ndarray, "n k 3"] | None
"""A second set of harmonics for the same Gaussians; none where there is none."""

_Key = tuple[int, ...]


@dataclass(slots=True)
class _Array:
    """One array on the GPU; holds on to its source, so that the key (its identity) stays taken."""

    sources: tuple[Any, ...]
    buffers: list[moderngl.Buffer]
    is_awaited: bool = True
    """Uploaded ahead of its first frame."""

    @property
    def nbytes(self) -> int:
        return sum(buffer.size for buffer in self.buffers)


class GpuArrays:
    """Uploads arrays the first time they are seen and finds them again by identity.

    Gaussians are values, so two sets that share an array (the same geometry in other colours) share its buffers.
    """

    def __init__(self, context: moderngl.Context, harmonics: Harmonics = "half") -> None:
        self._context = context
        self.harmonics: Harmonics = harmonics
        self._arrays: dict[_Key, _Array] = {}
        """Those that were drawn last come last."""
        self._marks: dict[_Key, _Array] = {}
        self._used: set[_Key] = set()
        self._leaving: list[moderngl.Buffer] = []

    def buffers(self, gaussians: Gaussians, wet_sh: WetColors = None) -> GaussianBuffers:
        """Return the buffers of a set and of its wet colours, uploading what is not there yet."""
        for _ in self.upload(gaussians, wet_sh=wet_sh):
            pass
        found: list[list[moderngl.Buffer]] = []
        for sources in _sources(gaussians, wet_sh):
            key = tuple(map(id, sources))
            self._used.add(key)
            array = self._arrays[key] = self._arrays.pop(key)  # to the end
            array.is_awaited = False
            found.append(array.buffers)
        return GaussianBuffers(*found)

    def keep(self, wet_sh: WetColors) -> None:
        """Count wet colours as drawn where they are here: at a wetness of 0 nobody reads them, but the next may."""
        key = (id(wet_sh),)
        if key in self._arrays:
            self._used.add(key)
            array = self._arrays[key] = self._arrays.pop(key)
            array.is_awaited = False

    def upload(self, gaussians: Gaussians, slice_size: int = CHUNK, *, wet_sh: WetColors = None) -> Iterator[float]:
        """Upload a set slice by slice; yields the fraction done after each, so that frames can go between them.

        Raises `MemoryError` where the graphics card has no room for it.
        """
        missing = [sources for sources in _sources(gaussians, wet_sh) if tuple(map(id, sources)) not in self._arrays]
        steps = max(1, sum(-(-len(gaussians) // slice_size) for _ in missing))
        done = 0
        for sources in missing:
            key, array = tuple(map(id, sources)), _Array(sources, [])
            try:
                for _ in self._written(array, slice_size):
                    done += 1
                    yield done / steps
            except BaseException:  # nobody waits for it any more, or the card is full
                self._leave(array)
                raise
            if key in self._arrays:  # a frame could not wait for it
                self._leave(array)
            else:
                self._arrays[key] = array

    def _written(self, array: _Array, slice_size: int) -> Iterator[None]:
        """Make an array's buffers and fill them, a slice at each step."""
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
        """How many Gaussians would have to be uploaded to draw these: all or none, were it for a single array."""
        is_here = all(tuple(map(id, sources)) in self._arrays for sources in _sources(gaussians, wet_sh))
        return 0 if is_here else len(gaussians)

    def marks(self, left_out: BitMask | None, selected: BitMask | None) -> list[moderngl.Buffer]:
        """Return the bits of both masks, word beside word, a buffer for each chunk; none where there is no mask."""
        if left_out is None and selected is None:
            return []
        words = [each.words if each is not None else None for each in (left_out, selected)]
        key = tuple(map(id, words))
        self._used.add(key)
        if key not in self._marks:
            chunks = _packed_marks(words)
            self._marks[key] = _Array(tuple(words), [self._context.buffer(chunk) for chunk in chunks])
        return self._marks[key].buffers

    @property
    def mark_count(self) -> int:
        """Pairs of masks that are here."""
        return len(self._marks)

    def release_unused(self) -> None:
        """Free what nobody asked for since the last call, a buffer a call: giving memory back takes its time.

        What waits for its first frame stays, and so do some of the arrays that were drawn before.
        """
        for key in [key for key in self._marks if key not in self._used]:
            self._leave(self._marks.pop(key))
        room = _RESTING_BYTES
        for key, array in reversed(list(self._arrays.items())):
            if key not in self._used and not array.is_awaited:
                room -= array.nbytes
                if room < 0:
                    self._leave(self._arrays.pop(key))
        self._used.clear()
        if self._leaving:
            self._leaving.pop().release()

    def release_awaited(self) -> None:
        """Give up what was uploaded ahead of its first frame and has not been drawn yet."""
        for key in [key for key, array in self._arrays.items() if array.is_awaited]:
            self._leave(self._arrays.pop(key))

    def release_all_but(self, kept: Iterable[tuple[Gaussians, WetColors]]) -> None:
        """Free all arrays but those of some sets and their wet colours: another scene has come."""
        keys = {tuple(map(id, sources)) for each in kept for sources in _sources(*each)}
        for key in [key for key in self._arrays if key not in keys]:
            self._leave(self._arrays.pop(key))

    def release_everything(self) -> None:
        """Free all of it at once. No upload may be under way."""
        self.release_all_but(())
        for key in list(self._marks):
            self._leave(self._marks.pop(key))
        while self._leaving:
            self._leaving.pop().release()

    def _leave(self, array: _Array) -> None:
        self._leaving += array.buffers

    def keep_harmonics_as(self, harmonics: Harmonics) -> None:
        """Keep colours in another storage; those that are here are uploaded anew for their next frame.

        No upload may be under way.
        """
        self.harmonics = harmonics
        for key in [key for key, array in self._arrays.items() if array.sources[0].ndim == 3]:
            for buffer in self._arrays.pop(key).buffers:
                buffer.release()

    def _packed(self, sources: tuple[Float32[np.ndarray, "..."], ...], rows: slice) -> UInt8[np.ndarray, "m bytes"]:
        """Rows as the shader reads them: means beside opacities, harmonics in their storage, the rest as it is."""
        first = sources[0][rows]
        if len(sources) == 2:
            return _as_bytes(np.concatenate([first, sources[1][rows][:, None]], axis=1))
        if first.ndim == 3:
            return packed_harmonics(first, self.harmonics)
        return _as_bytes(np.ascontiguousarray(first))


def packed_harmonics(sh: Float32[np.ndarray, "m k 3"], storage: Harmonics) -> UInt8[np.ndarray, "m bytes"]:
    """Harmonics as splat_project.comp reads them; rows are whole 32-bit words.

    Bytes hold n/127 of a Gaussian's largest coefficient after the first harmonic; that one number stands, as a half,
    beside the three of the first harmonic.
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


def _packed_marks(words: Sequence[UInt32[np.ndarray, " w"] | None]) -> Iterator[UInt32[np.ndarray, "c 2"]]:
    """Two masks word beside word, 0 where one is missing, cut at chunks."""
    count = max(len(each) for each in words if each is not None)
    pairs = np.zeros((count, 2), np.uint32)
    for column, each in enumerate(words):
        if each is not None:
            pairs[:, column] = each
    for start in range(0, count, CHUNK // 32):
        yield pairs[start : start + CHUNK // 32]


def _halves(values: Float32[np.ndarray, "m n"]) -> "np.ndarray[tuple[int, int], np.dtype[np.float16]]":
    return np.clip(values, -65504, 65504).astype(np.float16)


def _padded(rows: "np.ndarray[Any, np.dtype[Any]]", multiple: int) -> "np.ndarray[Any, np.dtype[Any]]":
    return np.pad(rows, ((0, 0), (0, -rows.shape[1] % multiple)))


def _as_bytes(rows: "np.ndarray[Any, np.dtype[Any]]") -> UInt8[np.ndarray, "m bytes"]:
    return rows.view(np.uint8).reshape(len(rows), rows.shape[1] * rows.itemsize)


def _sources(gaussians: Gaussians, wet_sh: WetColors = None) -> list[tuple[Float32[np.ndarray, "..."], ...]]:
    wet = [] if wet_sh is None else [(wet_sh,)]
    return [
        (gaussians.means, gaussians.opacities),
        (gaussians.scales,),
        (gaussians.quaternions,),
        (gaussians.sh,),
        *wet,
    ]


# § Memory of the graphics card: OpenGL only says that there was none left when it is asked.

_MAX_ERRORS = 8
"""Each kind is kept once until it is asked for; a context that is lost never stops telling."""


def reserve_buffer(context: moderngl.Context, size: int) -> moderngl.Buffer:
    """Make a buffer of so many bytes; raises `MemoryError` where the card has no room for it."""
    try:
        buffer = context.buffer(reserve=size)
    except moderngl.Error:
        raise MemoryError(_size_text(size)) from None
    try:
        check_gpu_memory(context, size)
    except MemoryError:
        buffer.release()
        raise
    return buffer


def check_gpu_memory(context: moderngl.Context, size: int) -> None:
    """Raise `MemoryError` where the driver has had no room for something of so many bytes that was just made."""
    for _ in range(_MAX_ERRORS):
        error = context.error
        if error == "GL_OUT_OF_MEMORY":
            raise MemoryError(_size_text(size))
        if error == "GL_NO_ERROR":
            return


def _size_text(size: int) -> str:
    return f"the graphics card has no room for {max(1, size >> 20)} MiB more"


# § A storage buffer that is made anew, larger, when more is asked of it.


class GrowableBuffer:
    """Keeps nothing of what was in it when it grows."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._buffer = context.buffer(reserve=4)

    @property
    def buffer(self) -> moderngl.Buffer:
        """The buffer as it is now; another one after it has grown."""
        return self._buffer

    def reserve(self, size: int, at_most: int | None = None) -> moderngl.Buffer:
        """Make room for so many bytes; where it has to grow it takes an eighth more, but `at_most` so many in all.

        Raises `MemoryError` where the graphics card has no room for it.
        """
        if size > self._buffer.size:
            self._buffer.release()
            self._buffer = self._context.buffer(reserve=4)  # to be there whatever comes
            roomy = size + size // 32 * 4
            self._buffer = reserve_buffer(self._context, roomy if at_most is None else max(size, min(roomy, at_most)))
        return self._buffer

    def bind(self, binding: int) -> None:
        self._buffer.bind_to_storage_buffer(binding)


# § Where projected splats lie on the GPU: records in blocks, their keys, and how many of them can be seen.

NEAR_M = 0.2
"""Gaussians whose centre is nearer than this are left out, as in the reference rasterizer."""

SLOTS_BY_BLOCK = 256
"""Slots that one workgroup of a projection fills, from the front; each dispatch starts with a new such block."""

_SPLAT_BYTES = 32

_MAX_RECORD_BLOCKS = 4

_RECORDS, _SPARSE_KEYS, _COUNTS, _WORK = 8, 4, 5, 7


class ProjectedSplatBuffer:
    """Buffers for a number of slots; `switches` tell the shaders how they are split."""

    def __init__(self, context: moderngl.Context) -> None:
        self._limit = int(context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        self._block_shift = (self._limit // _SPLAT_BYTES).bit_length() - 1
        self._records = [GrowableBuffer(context) for _ in range(_MAX_RECORD_BLOCKS)]
        self._record_blocks = 1
        self._sparse_keys = GrowableBuffer(context)
        self.counts = GrowableBuffer(context)
        """Visible splats of each block; after the scan, where they begin."""
        self.work = context.buffer(reserve=WORK_BYTES)
        """See `visible_scan`."""

    @property
    def switches(self) -> Switches:
        """How the shaders are to be compiled."""
        return {"SPLAT_BLOCKS": self._record_blocks, "BLOCK_SHIFT": self._block_shift}

    def reserve(self, slots: int) -> None:
        """Make room for so many slots, a multiple of 256.

        Raises `MemoryError` when the driver's storage blocks can't hold them.
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

    def bind(self) -> None:
        for number in range(self._record_blocks):
            self._records[number].bind(_RECORDS + number)
        self._sparse_keys.bind(_SPARSE_KEYS)
        self.counts.bind(_COUNTS)
        self.work.bind_to_storage_buffer(_WORK)
