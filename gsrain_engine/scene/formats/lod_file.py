"""Files of level-of-detail trees (.lod): a tree and its Gaussians as arrays that are mapped into memory, not read."""

import hashlib
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import platformdirs

from ...safe_io.errors import SceneFormatError
from ...safe_io.limits import open_file
from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians
from ..lod_tree import FAN_OUT, MAX_ROOTS, LodTree, level_starts
from ..mapped_arrays import map_arrays
from .ply import read_ply_parts
from .registry import read_gaussians

_MAGIC = b"GSRAINLOD"
_HEADER_BYTES = 512
_VERSION = 2
_BLOCKS, _BLOCK_BYTES = 1024, 4096  # of a file that a fingerprint covers, evenly spaced
_ROWS = 1 << 18  # Gaussians that are read, and indices that are checked, at a time


class _Fingerprint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file of a layer or actor that holds the same Gaussians."""

    size_bytes: int
    blocks: str
    """Hash of evenly spaced blocks."""
    whole: str
    """Hash of the file."""


class _Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """JSON after the magic word, padded with spaces; the arrays follow, in the order of `_layout`."""

    version: int
    gaussians: int
    coefficients: int
    fan_out: int
    max_roots: int
    source: _Fingerprint
    antialiased: bool = False


class _FileVersion(msgspec.Struct):
    version: int


def write_lod_tree(tree: LodTree, path: Path, source: Path) -> None:
    """Write a tree and its Gaussians: a header of 512 bytes, then little-endian arrays one after the other.

    The Gaussians are those that a reader of `source` gets, to the last bit; they are read from it a part at a time.
    """
    count, k = len(tree.gaussians), tree.gaussians.sh.shape[1]
    fingerprint = _Fingerprint(source.stat().st_size, _hash_of_blocks(source), _hash_of(source))
    header = _Header(_VERSION, count, k, FAN_OUT, MAX_ROOTS, fingerprint, tree.gaussians.antialiased)
    with path.open("wb") as file:
        file.write((_MAGIC + msgspec.json.encode(header)).ljust(_HEADER_BYTES))
        for array in (*tree.nodes.arrays, tree.radii, tree.errors, tree.leaves):
            file.write(np.ascontiguousarray(array).data)
        first = 0
        for part in read_ply_parts(source, _ROWS) if source.suffix == ".ply" else [read_gaussians(source)]:
            for offset, array in zip(_offsets(count, k)[8:], part.arrays, strict=False):
                file.seek(offset + first * (array.nbytes // max(len(part), 1)))
                file.write(np.ascontiguousarray(array).data)
            first += len(part)
    _note(_record_of_check(path))


def read_lod_tree(path: Path, source: Path) -> LodTree:
    """Map a tree and its Gaussians, so that only what is used takes memory; `source` is the file of these Gaussians.

    Only blocks of it are read, and all of it if it is newer, to check that they are the same. The numbers of a tree
    that this program has not written itself are read once, to check them.

    Raises `SceneFormatError` if the file is damaged, of another version, or of other Gaussians.
    """
    with open_file(path) as file:
        head = file.read(_HEADER_BYTES)
        if not head.startswith(_MAGIC):
            raise SceneFormatError(path, "is not a level-of-detail tree")
        try:
            text = head[len(_MAGIC) :].strip()
            if msgspec.json.decode(text, type=_FileVersion).version != _VERSION:
                raise SceneFormatError(path, "belongs to another version of this program")
            header = msgspec.json.decode(text, type=_Header)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise SceneFormatError(path, f"the header is damaged: {error}") from None
        count, k = header.gaussians, header.coefficients
        if (header.fan_out, header.max_roots) != (FAN_OUT, MAX_ROOTS):
            raise SceneFormatError(path, "belongs to another version of this program")
        if not 0 <= count < 1 << 32 or k not in COEFFICIENTS_OF_DEGREE:
            raise SceneFormatError(path, f"the header lists {count} Gaussians of {k} coefficients a color")
        if path.stat().st_size != _offsets(count, k)[-1]:
            raise SceneFormatError(path, f"has {path.stat().st_size} bytes, expected {_offsets(count, k)[-1]}")
        if not _is_of(path, header.source, source):
            raise SceneFormatError(path, f"belongs to other Gaussians than those of {source.name}")
        if not (record := _record_of_check(path)).is_file():
            _check_values(path, count, k)
            _note(record)
        layout = zip(_layout(count, k), _offsets(count, k), strict=False)
        arrays = map_arrays(file, [(shape, dtype, offset) for (shape, dtype), offset in layout])
    nodes, (radii, errors, leaves), own = arrays[:5], arrays[5:8], arrays[8:]
    leaf_gaussians, merged = (Gaussians(*each, antialiased=header.antialiased) for each in (own, nodes))
    return LodTree(leaf_gaussians, leaves, merged, radii, errors)


def _check_values(path: Path, count: int, coefficients: int) -> None:
    """Check all indices and numbers, a part at a time: kernels use them without a check."""
    offset = _offsets(count, coefficients)[7]
    for first in range(0, count, _ROWS):
        leaves = np.fromfile(path, "<u4", min(_ROWS, count - first), offset=offset + 4 * first)
        if int(leaves.max(initial=0)) >= count:
            raise SceneFormatError(path, f"names Gaussian {int(leaves.max())} of {count}")
    for (shape, dtype), offset in zip(_layout(count, coefficients), _offsets(count, coefficients), strict=False):
        size = int(np.prod(shape))
        for first in range(0, size if dtype.kind == "f" else 0, _ROWS):
            numbers = np.fromfile(path, dtype, min(_ROWS, size - first), offset=offset + 4 * first)
            if not np.isfinite(numbers).all():
                raise SceneFormatError(path, "holds numbers that are not finite")


def _record_of_check(path: Path) -> Path:
    """File that exists if the numbers of a tree were checked in its present state, or written by this program."""
    state = path.stat()
    key = repr((_VERSION, state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns)).encode()
    name = hashlib.blake2b(key, digest_size=8).hexdigest()
    return Path(platformdirs.user_cache_dir("gsrain", appauthor=False)) / "checked-trees" / name


def _note(record: Path) -> None:
    with suppress(OSError):  # checked again at the next start
        record.parent.mkdir(parents=True, exist_ok=True)
        record.touch()


def _is_of(path: Path, fingerprint: _Fingerprint, source: Path) -> bool:
    """Return whether a tree belongs to a file: by size and blocks, and by all of it if it is newer than the tree."""
    if source.stat().st_size != fingerprint.size_bytes or _hash_of_blocks(source) != fingerprint.blocks:
        return False
    return source.stat().st_mtime_ns <= path.stat().st_mtime_ns or _hash_of(source) == fingerprint.whole


def _hash_of_blocks(path: Path) -> str:
    digest, size = hashlib.blake2b(digest_size=8), path.stat().st_size
    with path.open("rb", buffering=0) as file:
        for start in np.unique(np.linspace(0, max(size - _BLOCK_BYTES, 0), _BLOCKS).astype(np.int64)).tolist():
            file.seek(start)
            digest.update(file.read(_BLOCK_BYTES))
    return digest.hexdigest()


def _hash_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def _layout(
    count: int, coefficients: int
) -> list[tuple[tuple[int, ...], "np.dtype[np.float32] | np.dtype[np.uint32]"]]:
    """Shapes and types of the arrays."""
    m, real = int(level_starts(count)[-1]), np.dtype("<f4")

    def set_of(n: int) -> list[tuple[int, ...]]:
        return [(n, 3), (n, 3), (n, 4), (n,), (n, coefficients, 3)]

    nodes = [(shape, real) for shape in (*set_of(m), (m,), (m,))]
    return [*nodes, ((count,), np.dtype("<u4")), *((shape, real) for shape in set_of(count))]


def _offsets(count: int, coefficients: int) -> list[int]:
    """Byte offset of each array, and the size of the file."""
    sizes = [int(np.prod(shape)) * dtype.itemsize for shape, dtype in _layout(count, coefficients)]
    return [_HEADER_BYTES + sum(sizes[:number]) for number in range(len(sizes) + 1)]
