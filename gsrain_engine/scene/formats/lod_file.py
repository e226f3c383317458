"""Files of level-of-detail trees (.lod), next to the PLY of their Gaussians in a scene folder."""

import hashlib
import mmap
from pathlib import Path

import msgspec
import numpy as np

from ...safe_io.limits import open_file
from ..files import SceneFormatError
from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from ..lod_tree import FAN_OUT, MAX_ROOTS, LodTree, level_starts

_MAGIC = b"GSRAINLOD"
_HEADER_BYTES = 256
_VERSION = 1
_SAMPLES = 1 << 16  # maximum number of Gaussians in a fingerprint, evenly in order


class _Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """JSON after the magic word, padded with spaces; the arrays follow, in the order of `_layout`."""

    version: int
    gaussians: int
    coefficients: int
    fan_out: int
    max_roots: int
    fingerprint: str
    """Hash of the Gaussians that the tree was built from."""


def write_lod_tree(tree: LodTree, path: Path) -> None:
    """Write a tree, without its Gaussians: a header of 256 bytes, then little-endian arrays one after the other."""
    header = msgspec.json.encode(_header(tree.gaussians))
    with path.open("wb") as file:
        file.write((_MAGIC + header).ljust(_HEADER_BYTES))
        for array in (*tree.nodes.arrays, tree.radii, tree.errors, tree.leaves):
            file.write(np.ascontiguousarray(array).data)


def read_lod_tree(path: Path, gaussians: Gaussians) -> LodTree:
    """Read the tree of a set; its nodes are mapped from the file, so that only drawn ones take memory.

    Raises `SceneFormatError` if the file is damaged, of another version, or of other Gaussians.
    """
    with open_file(path) as file:
        head = file.read(_HEADER_BYTES)
        if not head.startswith(_MAGIC):
            raise SceneFormatError(path, "is not a level-of-detail tree")
        try:
            header = msgspec.json.decode(head[len(_MAGIC) :].strip(), type=_Header)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise SceneFormatError(path, f"the header is damaged: {error}") from None
        if header != _header(gaussians):
            raise SceneFormatError(path, "belongs to other Gaussians, or to another version of this program")
        count, k = len(gaussians), gaussians.sh.shape[1]
        if path.stat().st_size != _file_bytes(count, k):
            raise SceneFormatError(path, f"has {path.stat().st_size} bytes, expected {_file_bytes(count, k)}")
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    arrays: list[np.ndarray] = []
    offset = _HEADER_BYTES
    for shape, dtype in _layout(count, k):
        size = int(np.prod(shape))
        arrays.append(np.frombuffer(mapped, dtype, size, offset).reshape(shape))
        offset += size * dtype.itemsize
    means, scales, quaternions, opacities, sh, radii, errors, leaves = arrays
    if count and int(leaves.max()) >= count:
        raise SceneFormatError(path, f"names Gaussian {int(leaves.max())} of {count}")
    return LodTree(gaussians, leaves, Gaussians(means, scales, quaternions, opacities, sh), radii, errors)


def lod_file_bytes(tree: LodTree) -> int:
    return _file_bytes(len(tree.leaves), tree.nodes.sh.shape[1])


def _header(gaussians: Gaussians) -> _Header:
    return _Header(_VERSION, len(gaussians), gaussians.sh.shape[1], FAN_OUT, MAX_ROOTS, _fingerprint(gaussians))


def _fingerprint(gaussians: Gaussians) -> str:
    """Hash (16 hex digits) of evenly sampled means, which a PLY holds to the last bit."""
    sample = np.ascontiguousarray(gaussians.means[:: -(-len(gaussians) // _SAMPLES) or 1])
    return hashlib.blake2b(sample.data, digest_size=8).hexdigest()


def _layout(
    count: int, coefficients: int
) -> list[tuple[tuple[int, ...], "np.dtype[np.float32] | np.dtype[np.uint32]"]]:
    """Shapes and types of the arrays."""
    assert coefficients in COEFFICIENTS_OF_DEGREE
    m, real = int(level_starts(count)[-1]), np.dtype("<f4")
    shapes = (m, 3), (m, 3), (m, 4), (m,), (m, coefficients, 3), (m,), (m,)
    return [*((shape, real) for shape in shapes), ((count,), np.dtype("<u4"))]


def _file_bytes(count: int, coefficients: int) -> int:
    return _HEADER_BYTES + sum(int(np.prod(shape)) * dtype.itemsize for shape, dtype in _layout(count, coefficients))
