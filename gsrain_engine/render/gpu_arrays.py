"""Gaussians on the GPU: one set of buffers an array, uploaded once, in slices where a frame must not stall."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import moderngl
import numpy as np
from jaxtyping import Float32, UInt8

from gsrain_engine.scene.gaussians import Gaussians

CHUNK = 1 << 19
"""Gaussians a buffer: at SH degree 3 that is 96 MiB, below the 128 MiB that a storage block may have on llvmpipe."""

Harmonics = Literal["single", "half", "byte"]
"""How colours lie on the GPU: 32-bit floats; halves; or the first harmonic in halves and the others in signed bytes.

Reading them is what bounds a frame on a GPU: 192, 96 or 56 bytes a Gaussian at SH degree 3.
"""

SH_BITS: dict[Harmonics, int] = {"single": 32, "half": 16, "byte": 8}
"""The shaders' name for each."""


@dataclass(frozen=True, slots=True)
class GaussianBuffers:
    """The buffers of one set of Gaussians, a chunk each; bound in this order from binding 0 on."""

    means_opacities: list[moderngl.Buffer]
    scales: list[moderngl.Buffer]
    quaternions: list[moderngl.Buffer]
    sh: list[moderngl.Buffer]

    def chunks(self) -> Iterator[tuple[moderngl.Buffer, ...]]:
        """Yield the four buffers of each chunk."""
        return zip(self.means_opacities, self.scales, self.quaternions, self.sh, strict=True)


_Key = tuple[int, ...]


@dataclass(slots=True)
class _Array:
    """One array on the GPU; holds on to its source, so that the key (its identity) stays taken."""

    sources: tuple[Float32[np.ndarray, "..."], ...]
    buffers: list[moderngl.Buffer]
    is_awaited: bool = True
    """Uploaded ahead of its first frame."""


class GpuArrays:
    """Uploads arrays the first time they are seen and finds them again by identity.

    Gaussians are values, so two sets that share an array (the same geometry in other colours) share its buffers.
    """

    def __init__(self, context: moderngl.Context, harmonics: Harmonics = "half") -> None:
        self._context = context
        self.harmonics: Harmonics = harmonics
        self._arrays: dict[_Key, _Array] = {}
        self._used: set[_Key] = set()

    def buffers(self, gaussians: Gaussians) -> GaussianBuffers:
        """Return the buffers of a set, uploading what is not there yet."""
        for _ in self.upload(gaussians):
            pass
        found: list[list[moderngl.Buffer]] = []
        for sources in _sources(gaussians):
            key = tuple(map(id, sources))
            self._used.add(key)
            self._arrays[key].is_awaited = False
            found.append(self._arrays[key].buffers)
        return GaussianBuffers(*found)

    def upload(self, gaussians: Gaussians, slice_size: int = CHUNK) -> Iterator[float]:
        """Upload a set slice by slice; yields the fraction done after each, so that frames can go between them."""
        missing = [sources for sources in _sources(gaussians) if tuple(map(id, sources)) not in self._arrays]
        steps = max(1, sum(-(-len(gaussians) // slice_size) for _ in missing))
        done = 0
        for sources in missing:
            array = _Array(sources, [])
            row_bytes = self._packed(sources, slice(0, 1)).shape[1]
            for start in range(0, len(gaussians), CHUNK):
                array.buffers.append(self._context.buffer(reserve=row_bytes * min(CHUNK, len(gaussians) - start)))
            for start in range(0, len(gaussians), slice_size):
                for at in range(start, min(start + slice_size, len(gaussians)), CHUNK):
                    stop = min(at + CHUNK - at % CHUNK, start + slice_size, len(gaussians))
                    data = self._packed(sources, slice(at, stop))
                    array.buffers[at // CHUNK].write(data, offset=row_bytes * (at % CHUNK))
                done += 1
                yield done / steps
            self._arrays[tuple(map(id, sources))] = array

    def release_unused(self, *, awaited_too: bool = False) -> None:
        """Free every array that nobody asked for since the last call; what waits for its first frame only if told."""
        for key, array in list(self._arrays.items()):
            if key not in self._used and (awaited_too or not array.is_awaited):
                del self._arrays[key]
                for buffer in array.buffers:
                    buffer.release()
        self._used.clear()

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


def _halves(values: Float32[np.ndarray, "m n"]) -> "np.ndarray[tuple[int, int], np.dtype[np.float16]]":
    return np.clip(values, -65504, 65504).astype(np.float16)


def _padded(rows: "np.ndarray[Any, np.dtype[Any]]", multiple: int) -> "np.ndarray[Any, np.dtype[Any]]":
    return np.pad(rows, ((0, 0), (0, -rows.shape[1] % multiple)))


def _as_bytes(rows: "np.ndarray[Any, np.dtype[Any]]") -> UInt8[np.ndarray, "m bytes"]:
    return rows.view(np.uint8).reshape(len(rows), rows.shape[1] * rows.itemsize)


def _sources(gaussians: Gaussians) -> list[tuple[Float32[np.ndarray, "..."], ...]]:
    return [(gaussians.means, gaussians.opacities), (gaussians.scales,), (gaussians.quaternions,), (gaussians.sh,)]
