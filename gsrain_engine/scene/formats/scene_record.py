"""What stands in `scene.json`: plain values that msgspec checks, and the way from and to `Scene`."""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from jaxtyping import Float32, Float64
from msgspec import Meta

from ..camera import DEFAULT_EXPOSURE_S
from ..gaussians import Gaussians
from ..grading import UNCHANGED, Grading
from ..members import Actor, Layer
from ..scene import RigCamera, Scene
from .marks_record import MarksRecord, marks_of, marks_record, selections_of, selections_record
from .path_record import PathRecord, path_of, path_record
from .track_record import TrackRecord, Vector, track_of, track_record

SCENE_VERSION = 4
"""Raised when a field is added. Each field has a default that says what older files meant, so that they can be read."""

Row = tuple[float, float, float, float]
Matrix = tuple[Row, Row, Row, Row]
Positive = Annotated[float, Meta(gt=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Pixels = Annotated[int, Meta(ge=1, le=16384)]

WetColors = Float32[np.ndarray, "_ _ 3"] | None

_IDENTITY: Matrix = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))


class LayerRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `Layer`; `file` and `wet_file` are relative to the scene folder."""

    name: str
    file: str
    wet_file: str | None = None
    kind: Literal["background", "sky"] = "background"
    visible: bool = True
    locked: bool = False
    opacity: Share = 1.0
    grading: Grading = UNCHANGED
    marks: MarksRecord = MarksRecord()
    to_scene: Matrix = _IDENTITY


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
    grading: Grading = UNCHANGED
    marks: MarksRecord = MarksRecord()


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


class SceneRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `Scene` without its Gaussians."""

    version: Annotated[int, Meta(ge=0, le=SCENE_VERSION)]
    name: str = ""
    metres_per_unit: Positive = 1.0
    unit_is_assumed: bool = False
    up: Vector = (0.0, 0.0, 1.0)
    ground_m: float | None = None
    layers: list[LayerRecord] = []
    actors: list[ActorRecord] = []
    rigs: dict[str, list[CameraRecord]] = {}
    ego: TrackRecord | None = None
    path: PathRecord | None = None
    rain: dict[str, Any] | None = None
    weather: dict[str, Any] | None = None
    view: dict[str, Any] | None = None
    selections: dict[str, dict[str, str]] = {}
    in_drawing_order: bool = False
    """Whether the files hold their Gaussians as they are best drawn, so that they need not be sorted when opened."""

    @property
    def files(self) -> list[str]:
        """Files of all layers, then of all actors."""
        return [each.file for each in (*self.layers, *self.actors)]

    @property
    def wet_files(self) -> list[str | None]:
        """Files of the wet colours of all layers, then of all actors; None for those that have none."""
        return [each.wet_file for each in (*self.layers, *self.actors)]

    @property
    def every_file(self) -> list[str]:
        """Files of all layers, then of all actors, then those of their wet colours."""
        return [*self.files, *(file for file in self.wet_files if file is not None)]


def record_of(
    scene: Scene, files: list[str], wet_files: Sequence[str | None] | None = None, *, in_drawing_order: bool = False
) -> SceneRecord:
    """Plain values of a scene whose layers, then actors, are kept in these files, and their wet colours in others."""
    names, wet_names = iter(files), iter(wet_files or [None] * len(files))
    return SceneRecord(
        version=SCENE_VERSION,
        name=scene.name,
        metres_per_unit=scene.metres_per_unit,
        unit_is_assumed=scene.unit_is_assumed,
        up=scene.up,
        ground_m=scene.ground_m,
        layers=[_layer_record(layer, next(names), next(wet_names)) for layer in scene.layers],
        actors=[_actor_record(actor, next(names), next(wet_names)) for actor in scene.actors],
        rigs={name: [_camera_record(camera) for camera in cameras] for name, cameras in scene.rigs.items()},
        ego=track_record(scene.ego) if scene.ego is not None else None,
        path=path_record(scene.path) if scene.path is not None else None,
        rain=dict(scene.rain) if scene.rain is not None else None,
        weather=dict(scene.weather) if scene.weather is not None else None,
        view=dict(scene.view) if scene.view is not None else None,
        selections=selections_record(scene.selections, {each.key: len(each.gaussians) for each in scene.members}),
        in_drawing_order=in_drawing_order,
    )


@np.errstate(over="ignore", invalid="ignore")  # numbers too large to be squared are named, like other wrong ones
def scene_of(record: SceneRecord, gaussians: list[Gaussians], wet: Sequence[WetColors] | None = None) -> Scene:
    """Scene of a record and what its files hold, in the order of `record.files`: Gaussians, and wet colours if any.

    Raises:
        ValueError: Where numbers contradict one another; the message names the field.
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
    return Scene(
        name=record.name,
        layers=layers,
        actors=actors,
        metres_per_unit=record.metres_per_unit,
        unit_is_assumed=record.unit_is_assumed,
        up=record.up,
        ground_m=record.ground_m,
        rigs={name: tuple(_camera(camera, name) for camera in cameras) for name, cameras in record.rigs.items()},
        ego=track_of(record.ego, "`$.ego`") if record.ego is not None else None,
        path=path_of(record.path, "`$.path`") if record.path is not None else None,
        rain=record.rain,
        weather=record.weather,
        view=record.view,
        selections=selections_of(record.selections, counts),
    )


def places_not_finite(value: object, place: str = "$") -> Iterator[str]:
    """Where plain values hold NaN or infinity: JSON has neither, and msgspec would write null in their place."""
    if isinstance(value, float) and not math.isfinite(value):
        yield place
    elif isinstance(value, dict):
        for name, each in value.items():
            yield from places_not_finite(each, f"{place}.{name}")
    elif isinstance(value, list | tuple):
        for i, each in enumerate(value):
            yield from places_not_finite(each, f"{place}[{i}]")


def _layer_record(layer: Layer, file: str, wet_file: str | None) -> LayerRecord:
    return LayerRecord(
        name=layer.name,
        file=file,
        wet_file=wet_file,
        kind=layer.kind,
        visible=layer.visible,
        locked=layer.locked,
        opacity=layer.opacity,
        grading=layer.grading,
        marks=marks_record(layer.marks),
        to_scene=_rows(layer.to_scene),
    )


def _layer(record: LayerRecord, gaussians: Gaussians, wet_sh: WetColors, where: str) -> Layer:
    return Layer(
        record.name,
        gaussians,
        record.kind,
        _similarity(record.to_scene, f"{where}.to_scene`"),
        visible=record.visible,
        locked=record.locked,
        opacity=record.opacity,
        grading=record.grading,
        marks=marks_of(record.marks, len(gaussians), f"{where}.marks"),
        wet_sh=wet_sh,
    )


def _actor_record(actor: Actor, file: str, wet_file: str | None) -> ActorRecord:
    return ActorRecord(
        id=actor.id,
        file=file,
        wet_file=wet_file,
        track=track_record(actor.track),
        class_name=actor.class_name,
        size_lwh=actor.size_lwh,
        visible=actor.visible,
        locked=actor.locked,
        opacity=actor.opacity,
        grading=actor.grading,
        marks=marks_record(actor.marks),
    )


def _actor(record: ActorRecord, gaussians: Gaussians, wet_sh: WetColors, where: str) -> Actor:
    return Actor(
        record.id,
        record.class_name,
        record.size_lwh,
        gaussians,
        track_of(record.track, f"{where}.track`"),
        visible=record.visible,
        locked=record.locked,
        opacity=record.opacity,
        grading=record.grading,
        marks=marks_of(record.marks, len(gaussians), f"{where}.marks"),
        wet_sh=wet_sh,
    )


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
    return CameraRecord(
        name=camera.name,
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        camera_to_ego=_rows(camera.camera_to_ego),
        exposure_s=camera.exposure_s,
    )


def _camera(record: CameraRecord, rig: str) -> RigCamera:
    matrix = np.array(record.camera_to_ego, np.float64)
    if not _is_pose(matrix):
        raise ValueError(f"camera_to_ego of camera {record.name!r} must be a rotation and a place - at `$.rigs.{rig}`")
    return RigCamera(
        record.name, record.width, record.height, record.fx, record.fy, record.cx, record.cy, matrix, record.exposure_s
    )
