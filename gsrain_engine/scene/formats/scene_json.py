"""Content of `scene.json`: plain values validated by msgspec, and their conversion from and to `Scene`."""

import base64
import binascii
import zlib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from jaxtyping import Float32, Float64
from msgspec import Meta

from ..camera import DEFAULT_EXPOSURE_S
from ..camera_path import CameraPath, Interpolation
from ..easing import Easing, KeyEasing
from ..flags import UNMARKED, BitMask, SelectionFlags
from ..gaussians import Gaussians
from ..geometry import normalized
from ..ground_water import GroundWater
from ..lamps import Lamp
from ..lens import Lens
from ..named_view import NamedView, check_views
from ..rolling_shutter import ReadoutDirection
from ..scene import UNCHANGED, Actor, ColorGrading, Layer, PoseTrack, RigCamera, Scene

SCENE_VERSION = 9
"""Incremented when a field is added. The default of each field is its meaning in older files, which stay readable.

Version 7 adds lenses and rolling shutters of rig cameras, version 8 the origin and whether the upward direction is
assumed, version 9 named views.
"""

Row = tuple[float, float, float, float]
Matrix = tuple[Row, Row, Row, Row]
Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Pixels = Annotated[int, Meta(ge=1, le=16384)]
WetColors = Float32[np.ndarray, "_ _ 3"] | None
_IDENTITY: Matrix = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))

# Flags and masks
# Packed bits, deflated, in base64.


class FlagsRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """`SelectionFlags` of a member; each mask is text of `mask_to_text`."""

    selected: str | None = None
    hidden: str | None = None
    deleted: str | None = None


class LayerRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `Layer`; `file` and `wet_file` are relative to the scene folder."""

    name: str
    file: str
    wet_file: str | None = None
    kind: Literal["background", "sky"] = "background"
    visible: bool = True
    locked: bool = False
    opacity: Share = 1.0
    grading: ColorGrading = UNCHANGED
    marks: FlagsRecord = FlagsRecord()
    to_scene: Matrix = _IDENTITY


# Tracks

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class TrackRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `PoseTrack`; every list has one entry per sample."""

    times: list[float]
    positions: list[Vector]
    quaternions_wxyz: list[Quaternion]
    valid: list[bool]


class ActorRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An `Actor`; `file` and `wet_file` are relative to the scene folder."""

    id: str
    file: str
    track: TrackRecord
    wet_file: str | None = None
    class_name: str = msgspec.field(default="", name="class")
    size_lwh: Vector = (0.0, 0.0, 0.0)
    visible: bool = True
    locked: bool = False
    opacity: Share = 1.0
    grading: ColorGrading = UNCHANGED
    marks: FlagsRecord = FlagsRecord()


class CameraRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `RigCamera`."""

    name: str
    width: Pixels
    height: Pixels
    fx: Positive
    fy: Positive
    cx: float
    cy: float
    camera_to_ego: Matrix
    exposure_s: Positive = DEFAULT_EXPOSURE_S
    lens: Lens | None = None
    readout_s: Annotated[float, Meta(ge=0, le=10)] = 0.0
    readout_direction: ReadoutDirection = "down"


# Camera paths


class KeyframeRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """One keyframe; position in scene units and axes, camera axes as OpenCV's."""

    time_s: float
    position: Vector
    quaternion_wxyz: Quaternion
    vertical_fov_deg: Annotated[float, Meta(gt=0, lt=180)]
    easing: KeyEasing | None = None


class PathRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `CameraPath`."""

    keyframes: Annotated[list[KeyframeRecord], Meta(min_length=1)]
    exposure_s: Annotated[float, Meta(gt=0)] = DEFAULT_EXPOSURE_S
    interpolation: Interpolation = "spline"
    easing: Easing = "none"
    loop: bool = False
    is_timed: bool = True
    plane_m: Annotated[float, Meta(gt=0)] | msgspec.UnsetType = msgspec.UNSET


_MAX_CELLS = 1 << 24  # of a map of water: 32 MB


class WaterRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A `GroundWater`; `cover` is its bytes, row by row, as a zlib stream (RFC 1950) in base64.

    So are `heights`, as little-endian 32-bit differences in millimeters along each row, the first from 0.
    """

    corner_m: tuple[float, float]
    cell_m: Annotated[float, Meta(ge=0.01, le=100)]
    rows: Annotated[int, Meta(ge=1, le=16384)]
    columns: Annotated[int, Meta(ge=1, le=16384)]
    cover: str
    heights: str | None = None
    scatter_m: Annotated[float, Meta(ge=0, le=100)] = 0.0


class SceneRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `Scene` without its Gaussians."""

    version: Annotated[int, Meta(ge=0, le=SCENE_VERSION)]
    name: str = ""
    metres_per_unit: Positive = 1.0
    unit_is_assumed: bool = False
    up: Vector = (0.0, 0.0, 1.0)
    up_is_assumed: bool = False
    origin: Vector = (0.0, 0.0, 0.0)
    ground_m: float | None = None
    layers: list[LayerRecord] = []
    actors: list[ActorRecord] = []
    rigs: dict[str, list[CameraRecord]] = {}
    ego: TrackRecord | None = None
    path: PathRecord | None = None
    lamps: list[Lamp] = []
    water: WaterRecord | None = None
    rain: dict[str, Any] | None = None
    weather: dict[str, Any] | None = None
    view: dict[str, Any] | None = None
    views: list[NamedView] = []
    selections: dict[str, dict[str, str]] = {}
    in_drawing_order: bool = False
    """True if the Gaussians are in LOD order in the files, so that they need no sorting when opened."""

    @property
    def files(self) -> list[str]:
        return [each.file for each in (*self.layers, *self.actors)]

    @property
    def wet_files(self) -> list[str | None]:
        """Files of the wet colors of all layers, then of all actors; None for members without."""
        return [each.wet_file for each in (*self.layers, *self.actors)]

    @property
    def every_file(self) -> list[str]:
        """Files of all layers, then of all actors, then those of their wet colors."""
        return [*self.files, *(file for file in self.wet_files if file is not None)]


def record_of(
    scene: Scene, files: list[str], wet_files: Sequence[str | None] | None = None, *, in_drawing_order: bool = False
) -> SceneRecord:
    """Plain values of a scene with the files of its layers, then actors, and of their wet colors."""
    names, wet_names = iter(files), iter(wet_files or [None] * len(files))
    return SceneRecord(
        version=SCENE_VERSION,
        **_fields(scene, _SCENE),
        layers=[_layer_record(layer, next(names), next(wet_names)) for layer in scene.layers],
        actors=[_actor_record(actor, next(names), next(wet_names)) for actor in scene.actors],
        rigs={name: [_camera_record(camera) for camera in cameras] for name, cameras in scene.rigs.items()},
        ego=track_record(scene.ego) if scene.ego is not None else None,
        path=path_record(scene.path) if scene.path is not None else None,
        lamps=list(scene.lamps),
        water=None if scene.water is None else water_record(scene.water),
        rain=dict(scene.rain) if scene.rain is not None else None,
        weather=dict(scene.weather) if scene.weather is not None else None,
        view=dict(scene.view) if scene.view is not None else None,
        views=list(scene.views),
        selections=selections_record(scene.selections, {each.key: len(each.gaussians) for each in scene.members}),
        in_drawing_order=in_drawing_order,
    )


@np.errstate(over="ignore", invalid="ignore")  # overflow is reported like other invalid numbers
def scene_of(record: SceneRecord, gaussians: list[Gaussians], wet: Sequence[WetColors] | None = None) -> Scene:
    """Scene of a record and the contents of its files, in the order of `record.files`: Gaussians, and any wet colors.

    Raises `ValueError` if numbers contradict one another; the message names the field.
    """
    given, wet_given = iter(gaussians), iter(wet or [None] * len(gaussians))
    if not np.isfinite(record.up).all() or not 1e-9 < np.linalg.norm(record.up) < 1e9:
        raise ValueError(f"`$.up` must be a direction, not {list(record.up)}")
    layers = tuple(
        _layer(each, next(given), next(wet_given), f"`$.layers[{i}]") for i, each in enumerate(record.layers)
    )
    actors = tuple(
        _actor(each, next(given), next(wet_given), f"`$.actors[{i}]") for i, each in enumerate(record.actors)
    )
    counts = {each.key: len(each.gaussians) for each in (*layers, *actors)}
    if not np.isfinite(record.origin).all():
        raise ValueError(f"`$.origin` must be a place, not {list(record.origin)}")
    check_views(record.views)
    return Scene(
        **_fields(record, _SCENE),
        layers=layers,
        actors=actors,
        rigs={name: tuple(_camera(camera, name) for camera in cameras) for name, cameras in record.rigs.items()},
        ego=track_of(record.ego, "`$.ego`") if record.ego is not None else None,
        path=path_of(record.path, "`$.path`") if record.path is not None else None,
        lamps=tuple(record.lamps),
        water=None if record.water is None else water_of(record.water),
        rain=record.rain,
        weather=record.weather,
        view=record.view,
        views=tuple(record.views),
        selections=selections_of(record.selections, counts),
    )


def _layer_record(layer: Layer, file: str, wet_file: str | None) -> LayerRecord:
    return LayerRecord(
        name=layer.name, file=file, wet_file=wet_file, kind=layer.kind, to_scene=_rows(layer.to_scene),
        marks=flags_record(layer.marks), **_fields(layer, _NODE),
    )  # fmt: skip


def _layer(record: LayerRecord, gaussians: Gaussians, wet_sh: WetColors, where: str) -> Layer:
    to_scene = _similarity(record.to_scene, f"{where}.to_scene`")
    marks = flags_of(record.marks, len(gaussians), f"{where}.marks")
    return Layer(record.name, gaussians, record.kind, to_scene, marks=marks, wet_sh=wet_sh, **_fields(record, _NODE))


def _actor_record(actor: Actor, file: str, wet_file: str | None) -> ActorRecord:
    return ActorRecord(
        file=file, wet_file=wet_file, track=track_record(actor.track), marks=flags_record(actor.marks),
        **_fields(actor, ("id", "class_name", "size_lwh", *_NODE)),
    )  # fmt: skip


def _actor(record: ActorRecord, gaussians: Gaussians, wet_sh: WetColors, where: str) -> Actor:
    return Actor(
        gaussians=gaussians, track=track_of(record.track, f"{where}.track`"), wet_sh=wet_sh,
        marks=flags_of(record.marks, len(gaussians), f"{where}.marks"),
        **_fields(record, ("id", "class_name", "size_lwh", *_NODE)),
    )  # fmt: skip


_NODE = ("visible", "locked", "opacity", "grading")
_CAMERA = ("name", "width", "height", "fx", "fy", "cx", "cy", "exposure_s", "lens", "readout_s", "readout_direction")
_FLAGS = ("selected", "hidden", "deleted")
_PATH = ("exposure_s", "interpolation", "easing", "loop", "is_timed")
_SCENE = ("name", "metres_per_unit", "unit_is_assumed", "up", "up_is_assumed", "origin", "ground_m")


def _fields(source: object, names: Sequence[str]) -> dict[str, Any]:
    """Fields that a scene and its record name alike."""
    return {name: getattr(source, name) for name in names}


def _rows(matrix: Float64[np.ndarray, "4 4"]) -> Matrix:
    a, b, c, d = (tuple(row) for row in matrix.tolist())
    return a, b, c, d


def _similarity(rows: Matrix, where: str) -> Float64[np.ndarray, "4 4"]:
    matrix = np.array(rows, np.float64)
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    if not 1e-9 < scale < 1e9 or not _is_pose(matrix / [scale, scale, scale, 1.0]):
        raise ValueError(f"the matrix must be a rotation, one scale above 0 and a place - at {where}")
    return matrix


def _is_pose(matrix: Float64[np.ndarray, "4 4"]) -> bool:
    rotation = matrix[:3, :3]
    is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
    return bool(is_rotation and np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6))


def _camera_record(camera: RigCamera) -> CameraRecord:
    return CameraRecord(camera_to_ego=_rows(camera.camera_to_ego), **_fields(camera, _CAMERA))


def _camera(record: CameraRecord, rig: str) -> RigCamera:
    matrix = np.array(record.camera_to_ego, np.float64)
    if not _is_pose(matrix):
        raise ValueError(f"camera_to_ego of camera {record.name!r} must be a rotation and a place - at `$.rigs.{rig}`")
    if record.lens is not None:
        record.lens.check_drawable()
    return RigCamera(camera_to_ego=matrix, **_fields(record, _CAMERA))


def flags_record(marks: SelectionFlags) -> FlagsRecord:
    """Plain values of flags; omits masks without any Gaussian."""
    masks = _fields(marks, _FLAGS)
    return FlagsRecord(**{name: mask_to_text(mask) for name, mask in masks.items() if mask})


def flags_of(record: FlagsRecord, count: int, where: str) -> SelectionFlags:
    """Flags of a member of `count` Gaussians.

    Raises `ValueError` if a text is no mask of `count` bits; `where` is its field in the file.
    """
    if record == FlagsRecord():
        return UNMARKED
    masks = {
        name: mask_from_text(text, count, f"{where}.{name}`")
        for name, text in _fields(record, _FLAGS).items()
        if text is not None
    }
    return SelectionFlags(**masks)


def mask_to_text(mask: BitMask) -> str:
    """Encode a mask: its words, little endian, as a zlib stream (RFC 1950) in base64."""
    return base64.b64encode(zlib.compress(mask.words.astype("<u4", copy=False).tobytes(), 1)).decode()


def mask_from_text(text: str, count: int, where: str) -> BitMask:
    """Decode a mask of `count` Gaussians.

    Raises `ValueError` if the text is damaged or a mask of another count; `where` is its field in the file.
    """
    data = _inflated(text, 4 * -(-count // 32), "mask", f"of {count} Gaussians", where)
    words = np.frombuffer(data, "<u4").astype(np.uint32)
    if count % 32 and words[-1] >> np.uint32(count % 32):
        raise ValueError(f"the mask means Gaussians beyond the {count} that there are - at {where}")
    return BitMask(count, words)


def water_record(water: GroundWater) -> WaterRecord:
    rows, columns = water.cover.shape[:2]
    heights = None
    if water.heights_m is not None:
        millimeters = np.rint(1000 * water.heights_m.astype(np.float64)).astype(np.int32)
        heights = _deflated(np.diff(millimeters, axis=1, prepend=0).astype("<i4"))
    return WaterRecord(
        corner_m=water.corner_m, cell_m=water.cell_m, rows=rows, columns=columns, cover=_deflated(water.cover),
        heights=heights, scatter_m=water.scatter_m,
    )  # fmt: skip


def water_of(record: WaterRecord) -> GroundWater:
    """Map of plain values; raises `ValueError` if it is damaged or too large."""
    shape = record.rows, record.columns, 2
    if record.rows * record.columns > _MAX_CELLS:
        raise ValueError(f"a map of {record.rows} x {record.columns} cells has more than {_MAX_CELLS} - at `$.water`")
    if not np.isfinite(record.corner_m).all():
        raise ValueError("corner_m must be finite - at `$.water`")
    data = _inflated(record.cover, int(np.prod(shape)), "map", f"of {shape[0]} x {shape[1]} cells", "`$.water.cover`")
    cover, heights = np.frombuffer(data, np.uint8).reshape(shape), None
    if record.heights is not None:
        steps = _inflated(record.heights, 4 * shape[0] * shape[1], "heights", "of the map", "`$.water.heights`")
        millimeters = np.cumsum(np.frombuffer(steps, "<i4").reshape(shape[:2]), axis=1, dtype=np.int64)
        heights = (millimeters / 1000).astype(np.float32)
    return GroundWater(record.corner_m, record.cell_m, cover, heights, record.scatter_m)


def _deflated(array: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 6)).decode()


def _inflated(text: str, size: int, noun: str, of: str, where: str) -> bytes:
    """Decode a zlib stream of `size` bytes in base64; raises `ValueError` if it is damaged or of another size."""
    stream = zlib.decompressobj()
    try:
        # One extra byte detects text that is too long, without a false length filling the memory.
        data = stream.decompress(base64.b64decode(text, validate=True), size + 1)
    except (binascii.Error, zlib.error, ValueError) as error:
        raise ValueError(f"no {noun} can be read ({error}) - at {where}") from None
    if len(data) != size:
        found = f"more than {size}" if len(data) > size else str(len(data))
        raise ValueError(f"a {noun} {of} takes {size} bytes, this one has {found} - at {where}")
    if not stream.eof:
        raise ValueError(f"the {noun} is cut off - at {where}")
    return data


def selections_record(
    selections: Mapping[str, Mapping[str, BitMask]], counts: Mapping[str, int]
) -> dict[str, dict[str, str]]:
    """Plain values of selection sets, without members that are missing or have other Gaussians."""
    return {
        name: {key: mask_to_text(mask) for key, mask in masks.items() if counts.get(key) == mask.count}
        for name, masks in selections.items()
    }


def selections_of(record: Mapping[str, Mapping[str, str]], counts: Mapping[str, int]) -> dict[str, dict[str, BitMask]]:
    """Selection sets of members with these `counts` of Gaussians, by their keys.

    Raises `ValueError` if a set names a missing member, or a mask does not fit.
    """
    sets: dict[str, dict[str, BitMask]] = {}
    for name, masks in record.items():
        where = f"`$.selections[{name!r}]`"
        unknown = [key for key in masks if key not in counts]
        if unknown:
            raise ValueError(f"there is no layer or actor {unknown[0]!r} - at {where}")
        sets[name] = {key: mask_from_text(text, counts[key], where) for key, text in masks.items()}
    return sets


def path_record(path: CameraPath) -> PathRecord:
    columns = (path.times_s, path.positions, path.quaternions_wxyz, path.vertical_fov_deg)
    easings = path.key_easings or (None,) * len(path.times_s)
    rows = zip(*(each.tolist() for each in columns), easings, strict=True)
    return PathRecord(
        keyframes=[
            KeyframeRecord(
                time_s=t, position=(x, y, z), quaternion_wxyz=(qw, qx, qy, qz), vertical_fov_deg=fov, easing=easing
            )
            for t, (x, y, z), (qw, qx, qy, qz), fov, easing in rows
        ],
        plane_m=path.plane_m or msgspec.UNSET,
        **_fields(path, _PATH),
    )


def path_of(record: PathRecord, where: str) -> CameraPath:
    """Path of plain values.

    Raises `ValueError` if its times do not increase or a rotation is invalid; `where` is its field in the file.
    """
    keys = record.keyframes
    times = np.array([key.time_s for key in keys], np.float64)
    if (np.diff(times) <= 0).any():
        raise ValueError(f"times must rise - at {where}")
    return CameraPath(
        times,
        np.array([key.position for key in keys], np.float64).reshape(-1, 3),
        unit_quaternions([key.quaternion_wxyz for key in keys], where),
        np.array([key.vertical_fov_deg for key in keys], np.float64),
        key_easings=tuple(key.easing for key in keys) if any(key.easing for key in keys) else (),
        plane_m=0.0 if record.plane_m is msgspec.UNSET else record.plane_m,
        **_fields(record, _PATH),
    )


def track_record(track: PoseTrack) -> TrackRecord:
    return TrackRecord(
        times=track.times.tolist(),
        positions=[(float(x), float(y), float(z)) for x, y, z in track.positions],
        quaternions_wxyz=[(float(w), float(x), float(y), float(z)) for w, x, y, z in track.quaternions_wxyz],
        valid=track.valid.tolist(),
    )


def track_of(record: TrackRecord, where: str) -> PoseTrack:
    """Track of plain values.

    Raises `ValueError` if they contradict one another; `where` is their field in the file.
    """
    n = len(record.times)
    if not n == len(record.positions) == len(record.quaternions_wxyz) == len(record.valid):
        raise ValueError(f"times, positions, quaternions_wxyz and valid must be equally long - at {where}")
    times = np.array(record.times, np.float64)
    positions = np.array(record.positions, np.float64).reshape(n, 3)
    if (np.diff(times) <= 0).any():
        raise ValueError(f"times must rise - at {where}")
    return PoseTrack(
        times, positions, unit_quaternions(record.quaternions_wxyz, where), np.array(record.valid, np.bool_)
    )


def unit_quaternions(values: list[Quaternion], where: str) -> Float64[np.ndarray, "n 4"]:
    """Normalize quaternions of any length but zero; those that are unit already stay bit-identical.

    Raises `ValueError` if one is 0 or not finite.
    """
    quaternions = np.array(values, np.float64).reshape(len(values), 4)
    lengths = np.linalg.norm(quaternions, axis=1)
    bad = np.flatnonzero(~((lengths > 1e-9) & (lengths < 1e9)))
    if len(bad):
        raise ValueError(f"quaternion {bad[0]} must be above 0 long and finite, not {lengths[bad[0]]:g} - at {where}")
    exact = np.abs(lengths - 1) < 1e-12
    return np.where(exact[:, None], quaternions, normalized(quaternions))
