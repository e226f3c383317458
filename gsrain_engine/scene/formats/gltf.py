"""glTF files (`.glb`, `.gltf`) with Gaussians: the extension KHR_gaussian_splatting of Khronos, kernel `ellipse`.

glTF has y up and z toward the front, the files of 3DGS y down and z forward: half a turn about z lies between them.
Gaussians that a draft extension compresses as SPZ are read, and cameras with their animation as camera paths.
"""

import base64
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar
from urllib.parse import unquote

import msgspec
import numpy as np
import scipy  # loads its submodules on first use: most files are opened without their cameras
from jaxtyping import Float32, Float64, UInt8
from msgspec import Meta
from msgspec.structs import replace as replace_fields

from ...safe_io.errors import SceneFormatError, readable_validation_error
from ...safe_io.limits import read_file
from ..camera_path import CameraPath
from ..gaussians import COEFFICIENTS_OF_DEGREE, SH_C0, Gaussians, sh_from_color
from ..geometry import matrices_from_quaternions, quaternions_from_matrices, srgb_to_linear
from ..scene import Scene
from ..transforms import far_place, flatten_scene, moved_gaussians, origin_in_file, transform_gaussians
from ._common import check_room, checked_gaussians, rounded_bytes, single_layer, stem_of
from .spz import decode_spz, spz_size

_EXTENSION = "KHR_gaussian_splatting"
_SPZ_EXTENSION = "KHR_gaussian_splatting_compression_spz_2"
_READABLE = (_EXTENSION, _SPZ_EXTENSION, "KHR_mesh_quantization")
_MAGIC, _JSON, _BINARY = b"glTF", b"JSON", b"BIN\0"
_HEADER = struct.Struct("<4sII")  # magic, version, bytes of the file
_CHUNK = struct.Struct("<I4s")  # bytes, kind
_COLORS = "COLOR_0"
_POINTS = 0
_FLOAT, _UNSIGNED_BYTE = 5126, 5121
_ARRAY_BUFFER = 34962
_DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_SH_NAME = re.compile(rf"{_EXTENSION}:SH_DEGREE_(\d)_COEF_(\d)")
_LARGEST_FILE = 2**32 - 1  # its length has 32 bits
_SIMILAR = 1e-4  # relative difference between the scales of a node's axes

_ANIMATED = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}
_SAMPLED = "LINEAR", "STEP"

_POINT_FLIP = np.array([-1, -1, 1], np.float32)
_SH_FLIP = np.array([(-1) ** (m % 2) for degree in range(4) for m in range(-degree, degree + 1)], np.float32)
_QUATERNION_SIGNS = np.array([-1, -1, 1, 1], np.float32)
"""Half a turn about z negates x and y, and every harmonic of odd order m; a quaternion's components change places."""

_Index = Annotated[int, Meta(ge=0)]
_Row = TypeVar("_Row")


# Unknown fields are ignored: glTF describes much that is no Gaussian.
class _Compression(msgspec.Struct, frozen=True, rename="camel"):
    buffer_view: _Index


class _Compressions(msgspec.Struct, frozen=True, rename={"spz": _SPZ_EXTENSION}):
    spz: _Compression | None = None


class _Splatting(msgspec.Struct, frozen=True, rename="camel"):
    kernel: str = "ellipse"
    color_space: str = "srgb_rec709_display"
    extensions: _Compressions = _Compressions()


class _PrimitiveExtensions(msgspec.Struct, frozen=True, rename={"splatting": _EXTENSION}):
    splatting: _Splatting | None = None


class _Primitive(msgspec.Struct, frozen=True):
    attributes: dict[str, _Index] = {}
    mode: int = 4
    extensions: _PrimitiveExtensions = _PrimitiveExtensions()
    extras: Any = None


class _Mesh(msgspec.Struct, frozen=True):
    primitives: list[_Primitive] = []


class _Node(msgspec.Struct, frozen=True):
    children: list[_Index] = []
    mesh: _Index | None = None
    camera: _Index | None = None
    matrix: Annotated[list[float], Meta(min_length=16, max_length=16)] | None = None
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


class _Perspective(msgspec.Struct, frozen=True):
    yfov: float


class _Camera(msgspec.Struct, frozen=True):
    perspective: _Perspective | None = None


class _Target(msgspec.Struct, frozen=True):
    path: str
    node: _Index | None = None


class _Channel(msgspec.Struct, frozen=True):
    sampler: _Index
    target: _Target


class _Sampler(msgspec.Struct, frozen=True):
    input: _Index
    output: _Index
    interpolation: str = "LINEAR"


class _Animation(msgspec.Struct, frozen=True):
    channels: list[_Channel] = []
    samplers: list[_Sampler] = []


class _SceneNodes(msgspec.Struct, frozen=True):
    nodes: list[_Index] = []


class _Accessor(msgspec.Struct, frozen=True, rename="camel"):
    component_type: int
    count: _Index
    type: str
    buffer_view: _Index | None = None
    byte_offset: _Index = 0
    normalized: bool = False
    sparse: Any = None


class _BufferView(msgspec.Struct, frozen=True, rename="camel"):
    buffer: _Index
    byte_length: _Index
    byte_offset: _Index = 0
    byte_stride: Annotated[int, Meta(ge=4, le=252)] | None = None


class _Buffer(msgspec.Struct, frozen=True, rename="camel"):
    byte_length: _Index
    uri: str | None = None


class _GltfDocument(msgspec.Struct, frozen=True, rename="camel"):
    extensions_required: list[str] = []
    scene: _Index = 0
    scenes: list[_SceneNodes] = []
    nodes: list[_Node] = []
    meshes: list[_Mesh] = []
    cameras: list[_Camera] = []
    animations: list[_Animation] = []
    accessors: list[_Accessor] = []
    buffer_views: list[_BufferView] = []
    buffers: list[_Buffer] = []


class _Placed(NamedTuple):
    primitive: _Primitive
    to_scene: Float64[np.ndarray, "4 4"]
    gaussians: int
    sh_degree: int


def read_gltf(path: Path) -> Gaussians:
    """Read the Gaussians of a glTF file, those of all nodes of its scene, in PLY axes.

    Buffers may be in the file, as data in its description, or files next to it. Raises `SceneFormatError` if the file
    is damaged, has no Gaussians, or needs an extension that is not read.
    """
    gaussians, place = _GltfReader(path, read_file(path)).read()
    return moved_gaussians(gaussians, place)


def read_gltf_scene(path: Path) -> Scene:
    """Read Gaussians as `read_gltf` does; nodes far from the origin lose nothing, as `to_scene` has their place."""
    gaussians, place = _GltfReader(path, read_file(path)).read()
    scene = single_layer(stem_of(path, path.suffix), gaussians)
    to_scene = np.eye(4)
    to_scene[:3, 3] = place
    return replace(scene, layers=(replace(scene.layers[0], to_scene=to_scene),))


def read_gltf_camera_path(path: Path) -> CameraPath:
    """Read the first animated camera of a glTF file (.glb, .gltf), or its first one, as a path in meters and PLY axes.

    Keyframes are at all times of the samples of the camera's node and of its parents, and the path is straight between
    them. Raises `SceneFormatError` if the file is damaged, has no perspective camera, or splines between its samples.
    """
    reader = _GltfReader(path, read_file(path))
    try:
        with np.errstate(all="ignore"):  # the path's own checks report overflow and division by 0
            return reader.camera_path()
    except SceneFormatError:
        raise
    except ValueError as error:
        raise SceneFormatError(path, f"glTF: {error}") from None


GLTF = (".glb", ".gltf")
"""Suffixes of glTF files."""


class _GltfReader:
    """One file: its description and its buffers."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        text, self.binary = _chunks(path, data) if data.startswith(_MAGIC) else (data, memoryview(b""))
        self.buffers: dict[int, memoryview] = {}
        try:
            self.document = msgspec.json.decode(text, type=_GltfDocument)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise SceneFormatError(path, f"glTF: {readable_validation_error(error, _GltfDocument)}") from None
        unknown = [name for name in self.document.extensions_required if name not in _READABLE]
        if unknown:
            raise SceneFormatError(path, f"glTF: it requires {', '.join(unknown)[:80]}, which is not read")

    def read(self) -> tuple[Gaussians, Float64[np.ndarray, "3"]]:
        """Gaussians relative to a place far from the origin, or to that, and the place; both in PLY axes."""
        placed = self._placed()
        if not placed:
            raise SceneFormatError(self.path, f"glTF: none of its meshes has Gaussians ({_EXTENSION})")
        coefficients = COEFFICIENTS_OF_DEGREE[max(each.sh_degree for each in placed)]
        check_room(self.path, sum(each.gaussians for each in placed), coefficients)
        place = far_place(np.array([each.to_scene[:3, 3] for each in placed]))
        for each in placed:
            each.to_scene[:3, 3] -= place
        return Gaussians.concatenate([self._gaussians(each) for each in placed]), place * _POINT_FLIP

    def _placed(self) -> list[_Placed]:
        """Primitives with Gaussians and their placement, by a walk through the nodes of the scene."""
        document = self.document
        if document.scenes:
            roots = self._at(document.scenes, document.scene, "scenes").nodes
        else:
            roots = sorted(
                {*range(len(document.nodes))} - {child for node in document.nodes for child in node.children}
            )
        found: list[_Placed] = []
        visited: set[int] = set()
        waiting = [(index, np.eye(4)) for index in reversed(roots)]
        while waiting:
            index, parent = waiting.pop()
            node = self._at(document.nodes, index, "nodes")
            if index in visited:
                raise SceneFormatError(self.path, f"glTF: node {index} has several parents")
            visited.add(index)
            with np.errstate(all="ignore"):
                to_scene = parent @ _node_matrix(node)
            waiting += [(child, to_scene) for child in reversed(node.children)]
            if node.mesh is not None:
                for primitive in self._at(document.meshes, node.mesh, "meshes").primitives:
                    if primitive.extensions.splatting is not None:
                        self._check(primitive, index, to_scene)
                        found.append(_Placed(primitive, to_scene, *self._size(primitive)))
        return found

    def _check(self, primitive: _Primitive, node: int, to_scene: Float64[np.ndarray, "4 4"]) -> None:
        splatting = primitive.extensions.splatting
        assert splatting is not None
        if primitive.mode != _POINTS:
            raise SceneFormatError(self.path, f"glTF: a primitive of Gaussians has mode 0, not {primitive.mode}")
        if splatting.kernel != "ellipse":
            raise SceneFormatError(self.path, f"glTF: kernel {splatting.kernel[:40]!r} can't be read, 'ellipse' can")
        if splatting.color_space != "srgb_rec709_display":
            told = f"colorSpace {splatting.color_space[:40]!r} can't be read, 'srgb_rec709_display' can"
            raise SceneFormatError(self.path, f"glTF: {told}")
        with np.errstate(all="ignore"):  # what is too large or no number is rejected
            squares = to_scene[:3, :3].T @ to_scene[:3, :3]
        scale = np.trace(squares) / 3
        is_similarity = np.isfinite(to_scene).all() and 0 < scale < np.inf and np.linalg.det(to_scene[:3, :3]) > 0
        if not is_similarity or np.abs(squares / scale - np.eye(3)).max() > _SIMILAR:
            raise SceneFormatError(self.path, f"glTF: node {node} must move, rotate and scale equally along all axes")

    def _size(self, primitive: _Primitive) -> tuple[int, int]:
        """Number of Gaussians of a primitive, and their SH degree."""
        compression = primitive.extensions.splatting and primitive.extensions.splatting.extensions.spz
        if compression:
            return spz_size(self.path, self._view(compression.buffer_view))
        count = self._accessor(primitive, "POSITION").count
        if _is_draft(primitive):
            return count, 0
        found = {match.groups() for name in primitive.attributes if (match := _SH_NAME.fullmatch(name))}
        degrees = [*range(max((int(degree) for degree, _ in found), default=0) + 1)]
        expected = {(str(degree), str(n)) for degree in degrees for n in range(2 * degree + 1)}
        if degrees[-1] >= len(COEFFICIENTS_OF_DEGREE) or found != expected:
            told = f"{len(found)} attributes SH_DEGREE_*_COEF_*: expected 1, 4, 9 or 16 (SH degree 0 to 3)"
            raise SceneFormatError(self.path, f"glTF: {told}")
        for name in (name for name in primitive.attributes if name.startswith(_EXTENSION)):
            if self._accessor(primitive, name).count != count:
                raise SceneFormatError(self.path, f"glTF: {name} has not as many rows as the {count} of POSITION")
        return count, degrees[-1]

    def _gaussians(self, placed: _Placed) -> Gaussians:
        primitive = placed.primitive
        compression = primitive.extensions.splatting and primitive.extensions.splatting.extensions.spz
        if compression:
            gaussians = _turned(decode_spz(self.path, bytes(self._view(compression.buffer_view))))
        elif _is_draft(primitive):
            colors = self._values(primitive, _COLORS, "VEC4")
            gaussians = checked_gaussians(
                self.path,
                self._values(primitive, "POSITION", "VEC3"),
                self._values(primitive, "_SCALE", "VEC3"),
                np.ascontiguousarray(self._values(primitive, "_ROTATION", "VEC4")[:, [3, 0, 1, 2]]),
                np.ascontiguousarray(colors[:, 3]),
                sh_from_color(colors[:, :3]),
            )
        else:
            sh = np.empty((placed.gaussians, COEFFICIENTS_OF_DEGREE[placed.sh_degree], 3), np.float32)
            for degree in range(placed.sh_degree + 1):
                for n in range(2 * degree + 1):
                    name = f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{n}"
                    sh[:, degree * degree + n] = self._values(primitive, name, "VEC3")
            gaussians = checked_gaussians(
                self.path,
                self._values(primitive, "POSITION", "VEC3"),
                self._values(primitive, f"{_EXTENSION}:SCALE", "VEC3"),
                np.ascontiguousarray(self._values(primitive, f"{_EXTENSION}:ROTATION", "VEC4")[:, [3, 0, 1, 2]]),
                self._values(primitive, f"{_EXTENSION}:OPACITY", "SCALAR")[:, 0],
                sh,
            )
        if isinstance(primitive.extras, dict) and primitive.extras.get("antialiased") is True:
            gaussians = replace(gaussians, antialiased=True)
        with np.errstate(over="ignore"):  # infinity is rejected
            found = _turned(transform_gaussians(gaussians, placed.to_scene))
        return replace(checked_gaussians(self.path, *found.arrays), antialiased=found.antialiased)

    def _accessor(self, primitive: _Primitive, name: str) -> _Accessor:
        if name not in primitive.attributes:
            raise SceneFormatError(self.path, f"glTF: a primitive of Gaussians has no attribute {name}")
        return self._at(self.document.accessors, primitive.attributes[name], "accessors")

    def _values(self, primitive: _Primitive, name: str, kind: str) -> Float32[np.ndarray, "n w"]:
        """Numbers of an attribute."""
        return self._rows(self._accessor(primitive, name), name, kind)

    def _rows(self, accessor: _Accessor, name: str, kind: str) -> Float32[np.ndarray, "n w"]:
        """Numbers of an accessor, each row contiguous, as float32; `name` is that in errors."""
        if accessor.type != kind or accessor.component_type not in _DTYPES:
            told = f"{name} is {accessor.type[:20]!r} of component type {accessor.component_type}"
            raise SceneFormatError(self.path, f"glTF: {told}, {kind} of 5120 to 5123 or 5126 would be right")
        if accessor.sparse is not None or accessor.buffer_view is None:
            raise SceneFormatError(self.path, f"glTF: {name} must be in a bufferView, without `sparse`")
        view = self._view(accessor.buffer_view)
        dtype, width = np.dtype(_DTYPES[accessor.component_type]), _WIDTHS[kind]
        stride = self.document.buffer_views[accessor.buffer_view].byte_stride or dtype.itemsize * width
        end = accessor.byte_offset + stride * max(accessor.count - 1, 0) + dtype.itemsize * width * (accessor.count > 0)
        if end > len(view) or stride < dtype.itemsize * width:
            raise SceneFormatError(self.path, f"glTF: {name} ends at byte {end} of a bufferView of {len(view)}")
        stored = np.ndarray((accessor.count, width), dtype, view, accessor.byte_offset, (stride, dtype.itemsize))
        values = np.array(stored, np.float32, order="C")
        if accessor.normalized and dtype.kind in "iu":
            values = np.maximum(values / np.float32(np.iinfo(dtype).max), np.float32(-1))
        return values

    def camera_path(self) -> CameraPath:
        nodes = self.document.nodes
        parents = {child: index for index, node in enumerate(nodes) for child in node.children}
        samplers = {
            (channel.target.node, channel.target.path): self._at(animation.samplers, channel.sampler, "samplers")
            for animation in self.document.animations
            for channel in animation.channels
        }
        moving = {node for node, _ in samplers}
        chains = [self._chain(index, parents) for index, node in enumerate(nodes) if node.camera is not None]
        if not chains:
            raise SceneFormatError(self.path, "glTF: it has no camera")
        chain = next((each for each in chains if not moving.isdisjoint(each)), chains[0])
        perspective = self._at(self.document.cameras, nodes[chain[0]].camera or 0, "cameras").perspective
        if perspective is None:
            raise SceneFormatError(self.path, "glTF: its camera has no perspective, which a camera path needs")
        own = (key for key in samplers if key[0] in chain and key[1] in _ANIMATED)
        curves = {key: self._curve(samplers[key], key[1]) for key in own}
        times = np.unique(np.concatenate([times for times, _ in curves.values()] or [np.zeros(1)]))
        poses = np.tile(np.eye(4), (len(times), 1, 1))
        for row, time_s in enumerate(times.tolist()):
            for index in chain:
                now = {name: at(time_s).tolist() for (node, name), (_, at) in curves.items() if node == index}
                poses[row] = _node_matrix(replace_fields(nodes[index], **now)) @ poses[row]
        rotations = poses[:, :3, :3] / np.linalg.norm(poses[:, :3, :3], axis=1, keepdims=True)
        rotations = _POINT_FLIP[:, None] * rotations * np.array([1.0, -1.0, -1.0])  # glTF's camera: y up, z back
        fov = np.full(len(times), np.degrees(perspective.yfov))
        quaternions = quaternions_from_matrices(rotations)
        return CameraPath(times, poses[:, :3, 3] * _POINT_FLIP, quaternions, fov, interpolation="linear")

    def _chain(self, index: int, parents: dict[int, int]) -> list[int]:
        """A node, its parent, and so on."""
        self._at(self.document.nodes, index, "nodes")
        chain = [index]
        while (above := parents.get(chain[-1])) is not None:
            if above in chain:
                raise SceneFormatError(self.path, f"glTF: node {above} is its own parent")
            chain.append(above)
        return chain

    def _curve(self, sampler: _Sampler, name: str) -> tuple[Float64[np.ndarray, " k"], Callable[[float], Any]]:
        """Times of a sampler, and a function of time for its values, which are constant outside."""
        if sampler.interpolation not in _SAMPLED:
            told = f"its camera's {name} is {sampler.interpolation[:20]!r}: export it sampled, as LINEAR or STEP"
            raise SceneFormatError(self.path, f"glTF: {told}")
        accessors = self.document.accessors
        inputs, outputs = (self._at(accessors, each, "accessors") for each in (sampler.input, sampler.output))
        times = self._rows(inputs, "an animation's input", "SCALAR")[:, 0].astype(np.float64)
        values = self._rows(outputs, f"an animation's {name}", _ANIMATED[name]).astype(np.float64)
        if not (0 < len(times) == len(values) and (np.diff(times) > 0).all() and np.isfinite(values).all()):
            raise SceneFormatError(self.path, f"glTF: its camera's {name} needs finite values at rising times")
        if sampler.interpolation == "STEP" or len(times) == 1:
            return times, lambda time_s: values[max(np.searchsorted(times, time_s, "right") - 1, 0)]
        if name == "rotation":
            turn = scipy.spatial.transform.Slerp(times, scipy.spatial.transform.Rotation.from_quat(values))
            return times, lambda time_s: turn(min(max(time_s, times[0]), times[-1])).as_quat()
        between = scipy.interpolate.make_interp_spline(times, values, k=1)
        return times, lambda time_s: between(min(max(time_s, times[0]), times[-1]))

    def _view(self, index: int) -> memoryview:
        view = self._at(self.document.buffer_views, index, "bufferViews")
        buffer = self._buffer(view.buffer)
        end = view.byte_offset + view.byte_length
        if end > len(buffer):
            told = f"bufferView {index} ends at byte {end}, buffer {view.buffer} has {len(buffer)}"
            raise SceneFormatError(self.path, f"glTF: {told}")
        return buffer[view.byte_offset : end]

    def _buffer(self, index: int) -> memoryview:
        """Bytes of a buffer; the first one of a binary file may be its binary chunk."""
        if index not in self.buffers:
            buffer = self._at(self.document.buffers, index, "buffers")
            own = self.binary if index == 0 and buffer.uri is None else None
            data = memoryview(_outer_buffer(self.path, buffer.uri or "")) if own is None else own
            if len(data) < buffer.byte_length:
                told = f"buffer {index} has {len(data)} bytes instead of {buffer.byte_length}: it is cut off"
                raise SceneFormatError(self.path, f"glTF: {told}")
            self.buffers[index] = data[: buffer.byte_length]
        return self.buffers[index]

    def _at(self, rows: list[_Row], index: int, name: str) -> _Row:
        if index >= len(rows):
            raise SceneFormatError(self.path, f"glTF: there is no number {index} in {name}, which has {len(rows)}")
        return rows[index]


def _is_draft(primitive: _Primitive) -> bool:
    """Return whether Gaussians have the attributes of the first draft of the extension: colors without harmonics."""
    return {"_SCALE", "_ROTATION", _COLORS} <= primitive.attributes.keys()


def _chunks(path: Path, data: bytes) -> tuple[memoryview, memoryview]:
    """Description and binary data of a file."""
    if len(data) < _HEADER.size + _CHUNK.size:
        raise SceneFormatError(path, f"a binary glTF file has at least 20 bytes, this one has {len(data)}")
    magic, version, size = _HEADER.unpack_from(data)
    if magic != _MAGIC or version != 2:
        raise SceneFormatError(path, "not a binary glTF file of version 2: it must start with 'glTF' and 2")
    if size > len(data):
        raise SceneFormatError(path, f"glTF: the header says {size} bytes, the file has {len(data)}: it is cut off")
    chunks = {_JSON: memoryview(b""), _BINARY: memoryview(b"")}
    start = _HEADER.size
    while start + _CHUNK.size <= size:
        length, kind = _CHUNK.unpack_from(data, start)
        start += _CHUNK.size
        if start + length > size:
            raise SceneFormatError(path, f"glTF: a chunk ends at byte {start + length}, the file has {size}")
        if kind in chunks and not chunks[kind]:
            chunks[kind] = memoryview(data)[start : start + length]
        start += length
    return chunks[_JSON], chunks[_BINARY]


def _outer_buffer(path: Path, uri: str) -> bytes:
    """Bytes of a buffer that stands in the description itself, or in a file of the same folder."""
    head, _, coded = uri.partition(",")
    if head.startswith("data:"):
        try:
            return base64.b64decode(coded, validate=True)
        except ValueError:  # characters outside of the alphabet, or of ASCII
            raise SceneFormatError(path, "glTF: its buffer is no base64") from None
    try:
        file = path.parent / unquote(uri)
        if not uri or "\0" in str(file) or not file.resolve().is_relative_to(path.parent.resolve()):
            raise SceneFormatError(path, f"glTF: its buffer {uri[:80]!r} must be a file next to it")
        return read_file(file)
    except OSError as error:
        raise SceneFormatError(path, f"glTF: its buffer {uri[:80]!r} can't be read: {error.strerror}") from None


def _node_matrix(node: _Node) -> Float64[np.ndarray, "4 4"]:
    if node.matrix is not None:
        return np.array(node.matrix, np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = node.rotation
    matrix[:3, :3] = matrices_from_quaternions(np.array([w, x, y, z], np.float64)) * np.array(node.scale, np.float64)
    matrix[:3, 3] = node.translation
    return matrix


def _turned(gaussians: Gaussians) -> Gaussians:
    """Half a turn about z, between glTF's axes and those of PLY; exact."""
    return replace(
        gaussians,
        means=gaussians.means * _POINT_FLIP,
        quaternions=np.ascontiguousarray(gaussians.quaternions[:, ::-1]) * _QUATERNION_SIGNS,
        sh=gaussians.sh * _SH_FLIP[: gaussians.sh.shape[1], None],
    )


def write_glb_scene(scene: Scene, path: Path) -> None:
    """Write the flattened scene, at its place in the coordinates of the file that it came from."""
    write_glb(flatten_scene(scene), path, origin_in_file(scene))


def write_glb(gaussians: Gaussians, path: Path, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    """Write a binary glTF file: one node, mesh and primitive of points with 32-bit floats, in glTF's axes.

    Means are relative to `origin`, in PLY axes, to which the node is moved. `COLOR_0` holds colors and opacities for
    viewers that draw points. `extras` marks antialiased Gaussians.

    Raises `ValueError` without Gaussians, or for more than fit into 4 GiB.
    """
    if not len(gaussians):
        raise ValueError("glTF has accessors of at least one row; there is no Gaussian to write")
    turned = _turned(gaussians)
    columns: dict[str, tuple[str, Float32[np.ndarray, "n w"] | UInt8[np.ndarray, "n w"]]] = {
        "POSITION": ("VEC3", turned.means),
        _COLORS: ("VEC4", _point_colors(turned)),
        f"{_EXTENSION}:ROTATION": ("VEC4", turned.quaternions[:, [1, 2, 3, 0]]),
        f"{_EXTENSION}:SCALE": ("VEC3", turned.scales),
        f"{_EXTENSION}:OPACITY": ("SCALAR", turned.opacities[:, None]),
    }
    for degree in range(turned.sh_degree + 1):
        for n in range(2 * degree + 1):
            columns[f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{n}"] = "VEC3", turned.sh[:, degree * degree + n]
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    offset = 0
    for kind, values in columns.values():
        is_float = values.dtype == np.float32
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes, "target": _ARRAY_BUFFER})
        accessor = {"bufferView": len(accessors), "count": len(values), "type": kind}
        accessor["componentType"] = _FLOAT if is_float else _UNSIGNED_BYTE
        accessors.append(accessor | ({} if is_float else {"normalized": True}))
        offset += values.nbytes  # a multiple of 4, as accessors need
    accessors[0] |= {"min": turned.means.min(axis=0).tolist(), "max": turned.means.max(axis=0).tolist()}
    splatting = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    splatting |= {"projection": "perspective", "sortingMethod": "cameraDistance"}
    primitive: dict[str, Any] = {
        "attributes": {name: index for index, name in enumerate(columns)},
        "mode": _POINTS,
        "extensions": {_EXTENSION: splatting},
    }
    if gaussians.antialiased:
        primitive["extras"] = {"antialiased": True}
    node: dict[str, Any] = {"mesh": 0}
    if any(origin):
        node["translation"] = (np.array(origin) * _POINT_FLIP).tolist()
    text = msgspec.json.encode(
        {
            "asset": {"version": "2.0", "generator": "GSRAIN"},
            "extensionsUsed": [_EXTENSION],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [node],
            "meshes": [{"primitives": [primitive]}],
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": offset}],
        }
    )
    text += b" " * (-len(text) % 4)
    size = _HEADER.size + 2 * _CHUNK.size + len(text) + offset
    if size > _LARGEST_FILE:
        raise ValueError(f"a binary glTF file has at most {_LARGEST_FILE:,} bytes, this one would have {size:,}")
    with path.open("wb") as file:
        file.write(_HEADER.pack(_MAGIC, 2, size) + _CHUNK.pack(len(text), _JSON) + text)
        file.write(_CHUNK.pack(offset, _BINARY))
        for _, values in columns.values():
            file.write(np.ascontiguousarray(values, "<f4" if values.dtype == np.float32 else "u1").data)


def _point_colors(gaussians: Gaussians) -> UInt8[np.ndarray, "n 4"]:
    """Linear colors and opacities in bytes, of viewers that draw points."""
    display = (gaussians.sh[:, 0] * np.float32(SH_C0) + np.float32(0.5)).clip(0, 1)
    colors = np.concatenate([srgb_to_linear(display), gaussians.opacities[:, None]], axis=1)
    return rounded_bytes(colors.astype(np.float32) * 255)
