"""PLY files with the properties of 3DGS (Kerbl et al. 2023).

3DGS stores log scales, opacity logits and harmonics as 32-bit floats.
"""

import logging
import re
from collections.abc import Iterator
from dataclasses import replace
from io import BufferedReader
from pathlib import Path
from typing import Any, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64

from ...kernels import kernel
from ...safe_io.errors import SceneFormatError
from ...safe_io.limits import open_file
from ..gaussians import COEFFICIENTS_OF_DEGREE, Gaussians, sh_from_color
from ..scene import Actor, Layer, Scene
from ..sky_dome import dome_layer, sample_cubemap
from ..transforms import FILE_UP, far_place, flatten_scene, moved_gaussians, origin_in_file
from ._common import check_room, checked_gaussians, printable_name, stem_of, usable_rows
from .boxed_actor import hidden_actor
from .compressed_ply import is_compressed, read_compressed
from .ply_header import ANTIALIASED, PlyElement, element_rows, read_ply_header
from .sky_sidecar import TO_CUBEMAP, read_sky_sidecar

logger = logging.getLogger("gsrain")
_MEANS = ("x", "y", "z")
_BASE_SH = ("f_dc_0", "f_dc_1", "f_dc_2")
_COLORS = ("red", "green", "blue")
_SCALES = ("scale_0", "scale_1", "scale_2")
_QUATERNIONS = ("rot_0", "rot_1", "rot_2", "rot_3")
_REQUIRED = (*_MEANS, *_BASE_SH, "opacity", *_SCALES[:2], *_QUATERNIONS)
_NORMALS = ("nx", "ny", "nz")
"""Written as zeros, as in 3DGS itself: some readers count properties instead of reading their names."""

_SMOOTHING = "filter_3D"
"""Standard deviation of the 3D filter of Mip-Splatting (Yu et al. 2024), GOF and RaDe-GS, beside unfiltered scales."""

_MASKS = {"road_mask": "road", "sky_mask": "sky"}
"""Properties of Instant NuRec that tell the Gaussians of a layer by numbers above a half, and its name."""

_PREFIX = re.compile(r"scal(ar)?_")  # before each name, in files that CloudCompare has written
_MOVING = re.compile(r"trbf_\w+|(scale|scaling|cov)_t|rot_r_\d|motion_\d+|omega_\d+|velocity_\d+")
"""Properties of Gaussians over time: SpacetimeGaussians, 4DGS, PVG."""

_OBJECT_ELEMENT = "vertex_"  # StreetGaussians: one element each for background, sky and the objects obj_NNN

_CHUNK_BYTES = 1 << 18  # rows are read and distributed to the arrays in blocks that fit into the CPU cache
_CHUNK_LINES = 1024
_LONGEST_LINE = 1 << 14  # Bytes; a Gaussian of SH degree 3 has some 700
_MIN_TO_JUDGE = 64  # Gaussians; the range of fewer does not tell logarithms from sizes

_Arrays = tuple[
    Float32[np.ndarray, "n 3"],
    Float32[np.ndarray, "n 3"],
    Float32[np.ndarray, "n 4"],
    Float32[np.ndarray, " n"],
    Float32[np.ndarray, "n k 3"],
]
"""Means, log scales, quaternions, opacity logits, harmonics."""

_LARGEST_LOGIT = 100.0
"""Written for an opacity of 1 or 0, whose logit is infinite: it converts back to exactly 1 or 0 in 32-bit floats."""

_SMALLEST_SCALE = np.float32(1e-37)  # written for a scale of 0, whose logarithm is infinite


def read_ply(path: Path) -> Gaussians:
    """Read a 3DGS PLY of SH degree 0 to 3, or SuperSplat's compressed PLY, recognized by its header.

    Properties may have any order and type, in either byte order or as text; unknown properties and elements are
    skipped. An infinite logit is an opacity of 1 or 0. Of a file with an element for each object, those that stand
    still are read. Memory: the arrays and one block of 256 KB.

    Raises `SceneFormatError` if the file is damaged or is not a file of Gaussians.
    """
    with open_file(path) as file:
        elements = read_ply_header(path, file)
        if is_compressed(elements):
            return read_compressed(path, file, elements)
        still = [each for each in _vertex_elements(path, elements) if not _is_object(each)]
        return Gaussians.concatenate([_read_vertices(path, file, elements, each).in_file for each in still])


def read_ply_scene(path: Path) -> Scene:
    """Read a PLY as `read_ply` does, with its upward direction and, of StreetGaussians, its parts.

    Background and sky are layers, objects are hidden actors: a PLY has no tracks. Layers far from the origin have
    their place in `to_scene`, so that doubles lose nothing.
    """
    suffix = ".compressed.ply" if path.name.lower().endswith(".compressed.ply") else ".ply"
    name = printable_name(stem_of(path, suffix))
    layers: list[Layer] = []
    actors: list[Actor] = []
    with open_file(path) as file:
        elements = read_ply_header(path, file)
        if is_compressed(elements):
            vertices = [elements["vertex"]]
            layers.append(Layer(name, read_compressed(path, file, elements)))
        else:
            vertices = _vertex_elements(path, elements)
            for element in vertices:
                read = _read_vertices(path, file, elements, element)
                part = element.name.removeprefix(_OBJECT_ELEMENT) if len(vertices) > 1 else name
                if _is_object(element):
                    actors.append(hidden_actor(part, read.in_file))
                else:
                    layers += read.layers(part)
    if actors:
        logger.warning("%s: %d objects have no tracks in a PLY: they are hidden actors", path, len(actors))
    cubemap = read_sky_sidecar(path)
    if cubemap is not None:
        layers.append(dome_layer(lambda ways: sample_cubemap(cubemap, ways @ TO_CUBEMAP.T), layers))
    is_drive = bool(actors) or cubemap is not None
    up = vertices[0].up or ((0.0, 0.0, 1.0) if is_drive else None)  # recorded drives have z up
    return Scene(
        name, tuple(layers), tuple(actors), up=up or FILE_UP, up_is_assumed=up is None, unit_is_assumed=not is_drive
    )


def read_ply_parts(path: Path, rows: int) -> Iterator[Gaussians]:
    """Read a PLY as `read_ply` does, `rows` Gaussians at a time; one that is text or compressed all at once."""
    with open_file(path) as file:
        elements = read_ply_header(path, file)
        vertex = elements.get("vertex")
        if vertex is None or vertex.is_text or is_compressed(elements):
            yield read_ply(path)
            return
        for first in range(0, vertex.rows, rows):
            yield _read_vertices(path, file, elements, vertex, slice(first, first + rows)).in_file


def ply_rows(path: Path) -> int:
    """Number of Gaussians that the header of a PLY lists, usable ones or not. Raises `SceneFormatError`."""
    with open_file(path) as file:
        return sum(each.rows for each in _vertex_elements(path, read_ply_header(path, file)))


def write_ply(gaussians: Gaussians, path: Path, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    """Write the standard 3DGS layout, little endian, with normals of 0; f_rest has 0, 9, 24 or 45 properties.

    Means are relative to `origin` and written as doubles if that is not 0. Antialiased Gaussians are marked by a
    comment in the header, which other programs ignore.
    """
    rest = 3 * (gaussians.sh.shape[1] - 1)
    kind = "double" if any(origin) else "float"
    names = [*_NORMALS, *_BASE_SH, *(f"f_rest_{i}" for i in range(rest)), "opacity", *_SCALES, *_QUATERNIONS]
    properties = "".join(f"property {kind} {name}\n" for name in _MEANS)
    properties += "".join(f"property float {name}\n" for name in names)
    mark = f"comment {ANTIALIASED}\n" if gaussians.antialiased else ""
    header = f"ply\nformat binary_little_endian 1.0\n{mark}element vertex {len(gaussians)}\n{properties}end_header\n"
    row = np.dtype([("means", "<f8" if any(origin) else "<f4", 3), ("others", "<f4", len(names))])
    count = max(1, _CHUNK_BYTES // row.itemsize)
    with path.open("wb") as file:
        file.write(header.encode())
        for start in range(0, len(gaussians), count):
            part = gaussians.take(slice(start, start + count))
            rows = np.empty(len(part), row)
            rows["means"] = part.means + np.array(origin) if any(origin) else part.means
            rows["others"] = _columns_after_means(part)
            file.write(rows.tobytes())


def write_ply_scene(scene: Scene, path: Path) -> None:
    """Write the flattened scene, at its place in the coordinates of the file that it came from."""
    write_ply(flatten_scene(scene), path, origin_in_file(scene))


class _Vertices(NamedTuple):
    """Gaussians of one element, relative to a place far from the file's origin, or to that."""

    gaussians: Gaussians
    offset: Float64[np.ndarray, "3"]
    marks: dict[str, Bool[np.ndarray, " n"]]
    """Gaussians of layers of their own, by their names."""

    def layers(self, name: str) -> list[Layer]:
        """Layers of the Gaussians, those without a mark by the name of all."""
        rest = np.ones(len(self.gaussians), np.bool_)
        found: list[Layer] = []
        for part, marked in self.marks.items():
            own, rest = rest & marked, rest & ~marked
            found += self.layer(part, own) if own.any() else []
        return [*self.layer(name, rest), *found]

    def layer(self, name: str, rows: Bool[np.ndarray, " n"]) -> list[Layer]:
        own = self.gaussians if rows.all() else self.gaussians.take(np.flatnonzero(rows))
        return [Layer(name, own, "sky" if name == "sky" else "background", self.to_scene)]

    @property
    def to_scene(self) -> Float64[np.ndarray, "4 4"]:
        matrix = np.eye(4)
        matrix[:3, 3] = self.offset
        return matrix

    @property
    def in_file(self) -> Gaussians:
        return moved_gaussians(self.gaussians, self.offset)


def _vertex_elements(path: Path, elements: dict[str, PlyElement]) -> list[PlyElement]:
    """Elements with Gaussians: `vertex`, or of StreetGaussians one for each part."""
    if "vertex" in elements:
        moments = [name for name in elements if name == "time" or name.startswith("delta_vertex_")]
        if moments:
            raise SceneFormatError(path, f"its Gaussians change over time (element {moments[0]}): export one moment")
        return [elements["vertex"]]
    found = [each for name, each in elements.items() if name.startswith(_OBJECT_ELEMENT)]
    if not any(not _is_object(each) for each in found):
        names = ", ".join(elements) or "none"
        raise SceneFormatError(path, f"a PLY of Gaussians has an element 'vertex', not {names}")
    return found


def _is_object(element: PlyElement) -> bool:
    return element.name.startswith(f"{_OBJECT_ELEMENT}obj_")


def _read_vertices(
    path: Path, file: BufferedReader, elements: dict[str, PlyElement], vertex: PlyElement, rows: slice = slice(None)
) -> _Vertices:
    if vertex.is_text and vertex.dtype is not None:
        dtype, offset = vertex.dtype, None
    else:
        dtype, offset = element_rows(path, vertex)
    layout = _layout_of(path, dtype, has_faces="face" in elements)
    first, last, _ = rows.indices(vertex.rows)
    n = last - first
    check_room(path, n, layout.coefficients)
    means, scales, quaternions = (np.empty((n, size), np.float32) for size in (3, 3, 4))
    opacities = np.empty(n, np.float32)
    sh = np.empty((n, layout.coefficients, 3), np.float32)
    smoothing = np.zeros(n if layout.smoothing else 0, np.float32)
    marks = {part: np.zeros(n, np.bool_) for part in layout.masks}
    if offset is not None:
        file.seek(offset + first * dtype.itemsize)
        blocks = _binary_blocks(path, file, dtype, layout, n)
    else:
        _seek_text(file, elements, vertex)
        blocks = _text_blocks(path, file, dtype, n)
    place = np.zeros(3)
    # Numbers too large for 32 bits become infinite, and are reported below.
    with np.errstate(over="ignore", invalid="ignore"):
        start = 0
        for block, columns in blocks:
            if block.dtype == np.float64:
                xyz = [columns[name] for name in layout.names[:3]]
                if start == 0:
                    place = far_place(block[:, xyz])
                block[:, xyz] -= place
            numbers = block.astype(np.float32, copy=False)
            indices = np.array([columns[name] for name in layout.names], np.int64)
            _copy_rows(numbers, indices, (means, scales, quaternions, opacities, sh), start)
            if layout.smoothing:
                smoothing[start : start + len(block)] = block[:, columns[layout.smoothing]]
            for part, name in layout.masks.items():
                marks[part][start : start + len(block)] = block[:, columns[name]] > 0.5
            start += len(block)
        if not _are_activated(path, scales, opacities):
            np.exp(scales, out=scales)
            activate_opacities(opacities)
        if layout.is_flat:
            scales[:, 2] = 0
        if layout.color_range:
            sh[:, 0] = sh_from_color(sh[:, 0] / np.float32(layout.color_range))[:, 0]
        if layout.smoothing:
            apply_3d_filter(scales, opacities, smoothing)
    if marks and not (fit := usable_rows(path, means, scales, quaternions, opacities, sh)).all():
        means, scales, quaternions, opacities, sh = (each[fit] for each in (means, scales, quaternions, opacities, sh))
        marks = {part: marked[fit] for part, marked in marks.items()}
    found = checked_gaussians(path, means, scales, quaternions, opacities, sh)
    return _Vertices(replace(found, antialiased=vertex.is_antialiased or bool(layout.smoothing)), place, marks)


def activate_opacities(logits: Float32[np.ndarray, " n"]) -> None:
    """Convert logits to opacities in place: 1 / (1 + exp(-x))."""
    with np.errstate(over="ignore"):  # exp overflows for large negative logits, and the opacity is 0
        np.exp(np.negative(logits, out=logits), out=logits)
    logits += 1
    np.reciprocal(logits, out=logits)


def _are_activated(path: Path, scales: Float32[np.ndarray, "n 3"], opacities: Float32[np.ndarray, " n"]) -> bool:
    """Return whether scales and opacities are no logarithms and logits, as some programs write them.

    As logarithms, scales all from 0 on, most below 1, would be Gaussians all from 1 to 3 units wide.
    """
    if len(scales) < _MIN_TO_JUDGE or not scales.min() >= 0 or not np.median(scales) < 1:
        return False
    if not (opacities.min() >= 0 and opacities.max() <= 1):
        return False
    logger.warning("%s: its scales are no logarithms, its opacities no logits: both are taken as they are", path)
    return True


def apply_3d_filter(
    scales: Float32[np.ndarray, "n 3"], opacities: Float32[np.ndarray, " n"], smoothing: Float32[np.ndarray, " n"]
) -> None:
    """Apply the 3D filter of Mip-Splatting in place: wider Gaussians with the same integral (Yu et al. 2024, eq. 9)."""
    variances = scales**2
    filtered = variances + smoothing[:, None] ** 2
    opacities *= np.sqrt(np.prod(variances / np.maximum(filtered, np.finfo(np.float32).tiny), axis=1))
    np.sqrt(filtered, out=scales)


class _PlyLayout(NamedTuple):
    """Properties of a row that make up a Gaussian."""

    names: list[str]
    """In the order of the arrays: means, scales, quaternion, opacity, harmonics of red, green and blue by turns."""
    coefficients: int
    is_flat: bool
    """True without a third scale: the disks of 2DGS (Huang et al. 2024)."""
    color_range: float
    """Value of full red, green and blue, where these stand for the harmonics of degree 0; else 0."""
    smoothing: str | None
    masks: dict[str, str]
    """Properties by the names of the layers that they mark."""


def _layout_of(path: Path, dtype: "np.dtype[Any]", *, has_faces: bool) -> _PlyLayout:
    """Find the properties of Gaussians, those of CloudCompare and of nerfstudio's RGB mode, too."""
    own = dtype.names or ()
    names = {_PREFIX.sub("", name, count=1): name for name in own} | {name: name for name in own}
    moving = [name for name in own if _MOVING.fullmatch(name)]
    if moving:
        raise SceneFormatError(path, f"its Gaussians change over time (property {moving[0]}): export one moment")
    base, color_range = _BASE_SH, 0.0
    waves = sum(re.fullmatch(r"f_dc_\d+", name) is not None for name in names) // 3
    if waves > 1:  # StreetGaussians: a Fourier series for each channel, whose first term is the mean over time
        base = tuple(f"f_dc_{channel * waves}" for channel in range(3))
    elif _BASE_SH[0] not in names and all(name in names for name in _COLORS):
        base = _COLORS
        kind = dtype[names[_COLORS[0]]]
        color_range = float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0
    missing = [name for name in (*_MEANS, *base, *_REQUIRED[6:]) if name not in names]
    if missing:
        told = f"element 'vertex' has no property {', '.join(missing)}: not a PLY of Gaussians"
        if not any(name in names for name in (*_BASE_SH, *_SCALES, *_QUATERNIONS)):
            told += " but a mesh" if has_faces else " but a point cloud"
        raise SceneFormatError(path, told)
    rest = {name for name in names if re.fullmatch(r"f_rest_\d+", name)}
    expected = {3 * (coefficients - 1): coefficients for coefficients in COEFFICIENTS_OF_DEGREE}
    if len(rest) not in expected or rest != {f"f_rest_{i}" for i in range(len(rest))}:
        raise SceneFormatError(
            path, f"{len(rest)} properties f_rest_*: expected 0, 9, 24 or 45, counted from f_rest_0 (SH degree 0 to 3)"
        )
    # The file has all harmonics of red, then of green, of blue.
    of_color = len(rest) // 3
    harmonics = [f"f_rest_{channel * of_color + k}" for k in range(of_color) for channel in range(3)]
    is_flat = _SCALES[2] not in names
    scales = (*_SCALES[:2], _SCALES[1] if is_flat else _SCALES[2])
    ours = [*_MEANS, *scales, *_QUATERNIONS, "opacity", *base, *harmonics]
    masks = {part: names[name] for name, part in _MASKS.items() if name in names}
    columns = [names[name] for name in ours]
    return _PlyLayout(columns, expected[len(rest)], is_flat, color_range, names.get(_SMOOTHING), masks)


_Block = tuple[Float[np.ndarray, "r p"], dict[str, int]]
"""Numbers of some rows, and the column of each property; doubles unless all of them are 32-bit floats."""


def _binary_blocks(
    path: Path, file: BufferedReader, dtype: "np.dtype[Any]", layout: _PlyLayout, count: int
) -> Iterator[_Block]:
    """Read the file's next rows, some at a time, into the same memory."""
    piece = np.empty(min(count, max(1, _CHUNK_BYTES // dtype.itemsize)), dtype)
    places = {name: number for number, name in enumerate(dtype.names or ())}
    is_plain = all(dtype[name] == np.float32 for name in places)
    others = (*((layout.smoothing,) if layout.smoothing else ()), *layout.masks.values())
    used = list(dict.fromkeys((*layout.names, *others)))
    for start in range(0, count, len(piece) or 1):
        rows = piece[: count - start]
        if file.readinto(rows.view(np.uint8).data) != rows.nbytes:
            raise SceneFormatError(path, "the file became shorter while it was read")
        if is_plain:
            yield rows.view(np.float32).reshape(len(rows), len(places)), places
        else:
            numbers = np.stack([rows[name] for name in used], axis=1, dtype=np.float64, casting="unsafe")
            yield numbers, {name: number for number, name in enumerate(used)}


def _seek_text(file: BufferedReader, elements: dict[str, PlyElement], vertex: PlyElement) -> None:
    """Go to the first row of an element of text."""
    file.seek(vertex.header_bytes)
    for element in elements.values():
        if element.name == vertex.name:
            return
        for _ in range(element.rows):
            if not file.readline(_LONGEST_LINE):
                return


def _text_blocks(path: Path, file: BufferedReader, dtype: "np.dtype[Any]", count: int) -> Iterator[_Block]:
    """Read the numbers of the next lines of text, some at a time."""
    places = {name: number for number, name in enumerate(dtype.names or ())}
    for start in range(0, count, _CHUNK_LINES):
        lines = [
            file.readline(_LONGEST_LINE).decode("ascii", "replace") for _ in range(min(_CHUNK_LINES, count - start))
        ]
        for number, line in enumerate(lines, start):
            if len(line.split()) != len(places):
                found = len(line.split())
                raise SceneFormatError(
                    path, f"vertex {number}: {found} numbers in its line, its header lists {len(places)}"
                )
        try:
            yield np.loadtxt(lines, np.float64, comments=None, ndmin=2), places
        except ValueError:
            raise SceneFormatError(path, f"vertices {start} to {start + len(lines) - 1}: a word is no number") from None


def _columns_after_means(gaussians: Gaussians) -> Float32[np.ndarray, "n p"]:
    n = len(gaussians)
    opacities = gaussians.opacities.astype(np.float64)
    with np.errstate(divide="ignore"):
        logits = np.clip(np.log(opacities) - np.log1p(-opacities), -_LARGEST_LOGIT, _LARGEST_LOGIT)
    columns = (
        np.zeros((n, 3)),
        gaussians.sh[:, 0],
        gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(n, -1),
        logits[:, None],
        np.log(np.maximum(gaussians.scales, _SMALLEST_SCALE)),
        gaussians.quaternions,
    )
    return np.concatenate(columns, axis=1, dtype="<f4")


# Rows to arrays


def _copy_rows(rows: Float32[np.ndarray, "r p"], columns: Int64[np.ndarray, " c"], arrays: _Arrays, start: int) -> None:
    means, scales, quaternions, opacities, sh = (array[start : start + len(rows)] for array in arrays)
    _spread(rows, columns, means, scales, quaternions, opacities, sh.reshape(len(rows), 3 * sh.shape[1]))


@kernel()
@no_type_check
def _spread(rows, columns, means, scales, quaternions, opacities, sh):
    """Copy the numbers of a file, one row at a time: by columns, each number would touch a cache line.

    `columns` are those of `rows` for the elements of the arrays, in the arrays' memory order; the harmonics of a row
    are (3 k).
    """
    for n in range(len(rows)):
        for i in range(3):
            means[n, i] = rows[n, columns[i]]
            scales[n, i] = rows[n, columns[3 + i]]
        for i in range(4):
            quaternions[n, i] = rows[n, columns[6 + i]]
        opacities[n] = rows[n, columns[10]]
        for i in range(sh.shape[1]):
            sh[n, i] = rows[n, columns[11 + i]]
