"""Gaussians on the GPU: one set of buffers an array, uploaded once, in slices where a frame must not stall."""

from collections.abc import Iterator
from dataclasses import dataclass

import moderngl
import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.gaussians import Gaussians

CHUNK = 1 << 19
"""Gaussians a buffer: at SH degree 3 that is 96 MiB, below the 128 MiB that a storage block may have on llvmpipe."""


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


class GpuArrays:
    """Uploads arrays the first time they are seen and finds them again by identity.

    Gaussians are values, so two sets that share an array (the same geometry in other colours) share its buffers.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
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
            found.append(self._arrays[key].buffers)
        return GaussianBuffers(*found)

    def upload(self, gaussians: Gaussians, slice_size: int = CHUNK) -> Iterator[float]:
        """Upload a set slice by slice; yields the fraction done after each, so that frames can go between them."""
        missing = [sources for sources in _sources(gaussians) if tuple(map(id, sources)) not in self._arrays]
        steps = max(1, sum(-(-len(gaussians) // slice_size) for _ in missing))
        done = 0
        for sources in missing:
            array = _Array(sources, [])
            width = _packed(sources, slice(0, 0)).shape[1]
            for start in range(0, len(gaussians), CHUNK):
                array.buffers.append(self._context.buffer(reserve=4 * width * min(CHUNK, len(gaussians) - start)))
            for start in range(0, len(gaussians), slice_size):
                for at in range(start, min(start + slice_size, len(gaussians)), CHUNK):
                    stop = min(at + CHUNK - at % CHUNK, start + slice_size, len(gaussians))
                    data = _packed(sources, slice(at, stop))
                    array.buffers[at // CHUNK].write(data, offset=4 * width * (at % CHUNK))
                done += 1
                yield done / steps
            self._arrays[tuple(map(id, sources))] = array

    def release_unused(self) -> None:
        """Free every array that nobody asked for since the last call."""
        for key in [key for key in self._arrays if key not in self._used]:
            for buffer in self._arrays.pop(key).buffers:
                buffer.release()
        self._used.clear()


def _sources(gaussians: Gaussians) -> list[tuple[Float32[np.ndarray, "..."], ...]]:
    return [(gaussians.means, gaussians.opacities), (gaussians.scales,), (gaussians.quaternions,), (gaussians.sh,)]


def _packed(sources: tuple[Float32[np.ndarray, "..."], ...], rows: slice) -> Float32[np.ndarray, "m w"]:
    """Rows as the shader reads them: means beside opacities, scales padded to four numbers, the rest as it is."""
    first = sources[0][rows].reshape(len(sources[0][rows]), int(np.prod(sources[0].shape[1:])))
    if len(sources) == 2:
        return np.concatenate([first, sources[1][rows][:, None]], axis=1)
    if first.shape[1] == 3 and sources[0].ndim == 2:
        return np.pad(first, ((0, 0), (0, 1)))
    return np.ascontiguousarray(first)
