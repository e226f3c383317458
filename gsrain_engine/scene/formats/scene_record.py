"""What stands in `scene.json`: plain values that msgspec checks, and the way from and to `Scene`."""

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from ..camera import DEFAULT_EXPOSURE_S
from ..gaussians import Gaussians
from ..members import Actor, Layer
from ..rotations import normalized
from ..scene import RigCamera, Scene
from ..track import Track

SCENE_VERSION = 1
"""Raised when a field is added. Each field has a default that says what older files meant, so that they can be read."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Row = tuple[float, float, float, float]
Positive = Annotated[float, Meta(gt=0)]
Pixels = Annotated[int, Meta(ge=1, le=16384)]


class TrackRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `Track`, one entry a sample in every list."""

    times: list[float]
    positions: list[Vector]
    quaternions_wxyz: list[Quaternion]
    valid: list[bool]


class LayerRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `Layer`; `file` is relative to the scene folder."""

    name: str
    file: str
    kind: Literal["background", "sky"] = "background"
    visible: bool = True


class ActorRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An `Actor`; `file` is relative to the scene folder."""

    id: str
    file: str
    track: TrackRecord
    class_name: str = msgspec.field(default="", name="class")
    size_lwh: Vector = (0.0, 0.0, 0.0)
    visible: bool = True


class CameraRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `RigCamera`."""

    name: str
    width: Pixels
    height: Pixels
    fx: Positive
    fy: Positive
    cx: float
    cy: float
    camera_to_ego: tuple[Row, Row, Row, Row]
    exposure_s: Positive = DEFAULT_EXPOSURE_S


class SceneRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A `Scene` without its Gaussians."""

    version: Annotated[int, Meta(ge=0, le=SCENE_VERSION)]
    name: str = ""
    metres_per_unit: Positive = 1.0
    up: Vector = (0.0, 0.0, 1.0)
    ground_m: float | None = None
    layers: list[LayerRecord] = []
    actors: list[ActorRecord] = []
    rigs: dict[str, list[CameraRecord]] = {}
    ego: TrackRecord | None = None
    rain: dict[str, Any] | None = None

    @property
    def files(self) -> list[str]:
        """Files of all layers, then of all actors."""
        return [each.file for each in (*self.layers, *self.actors)]


def record_of(scene: Scene, files: list[str]) -> SceneRecord:
    """Plain values of a scene whose layers, then actors, are kept in these files."""
    names = iter(files)
    return SceneRecord(
        version=SCENE_VERSION,
        name=scene.name,
        metres_per_unit=scene.metres_per_unit,
        up=scene.up,
        ground_m=scene.ground_m,
        layers=[
            LayerRecord(name=layer.name, kind=layer.kind, visible=layer.visible, file=next(names))
            for layer in scene.layers
        ],
        actors=[
            ActorRecord(
                id=actor.id,
                class_name=actor.class_name,
                size_lwh=actor.size_lwh,
                visible=actor.visible,
                file=next(names),
                track=_track_record(actor.track),
            )
            for actor in scene.actors
        ],
        rigs={name: [_camera_record(camera) for camera in cameras] for name, cameras in scene.rigs.items()},
        ego=_track_record(scene.ego) if scene.ego is not None else None,
        rain=dict(scene.rain) if scene.rain is not None else None,
    )


@np.errstate(over="ignore", invalid="ignore")  # numbers too large to be squared are named, like other wrong ones
def scene_of(record: SceneRecord, gaussians: list[Gaussians]) -> Scene:
    """Scene of a record and the Gaussians of its files, in the order of `record.files`.

    Raises:
        ValueError: Where numbers contradict one another; the message names the field.
    """
    given = iter(gaussians)
    if not np.isfinite(record.up).all() or not 1e-9 < np.linalg.norm(record.up) < 1e9:
        raise ValueError(f"`$.up` must be a direction, not {list(record.up)}")
    return Scene(
        name=record.name,
        layers=tuple(Layer(layer.name, next(given), layer.kind, visible=layer.visible) for layer in record.layers),
        actors=tuple(
            Actor(
                actor.id,
                actor.class_name,
                actor.size_lwh,
                next(given),
                _track(actor.track, f"`$.actors[{i}].track`"),
                visible=actor.visible,
            )
            for i, actor in enumerate(record.actors)
        ),
        metres_per_unit=record.metres_per_unit,
        up=record.up,
        ground_m=record.ground_m,
        rigs={name: tuple(_camera(camera, name) for camera in cameras) for name, cameras in record.rigs.items()},
        ego=_track(record.ego, "`$.ego`") if record.ego is not None else None,
        rain=record.rain,
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


def _track_record(track: Track) -> TrackRecord:
    return TrackRecord(
        times=track.times.tolist(),
        positions=[(float(x), float(y), float(z)) for x, y, z in track.positions],
        quaternions_wxyz=[(float(w), float(x), float(y), float(z)) for w, x, y, z in track.quaternions_wxyz],
        valid=track.valid.tolist(),
    )


def _track(record: TrackRecord, where: str) -> Track:
    n = len(record.times)
    if not n == len(record.positions) == len(record.quaternions_wxyz) == len(record.valid):
        raise ValueError(f"times, positions, quaternions_wxyz and valid must be equally long - at {where}")
    times = np.array(record.times, np.float64)
    positions = np.array(record.positions, np.float64).reshape(n, 3)
    quaternions = np.array(record.quaternions_wxyz, np.float64).reshape(n, 4)
    if (np.diff(times) <= 0).any():
        raise ValueError(f"times must rise - at {where}")
    lengths = np.linalg.norm(quaternions, axis=1)
    bad = np.flatnonzero(~((lengths > 1e-9) & (lengths < 1e9)))
    if len(bad):
        raise ValueError(f"quaternion {bad[0]} must be above 0 long and finite, not {lengths[bad[0]]:g} - at {where}")
    # What is unit already stays as it is, to the bit.
    exact = np.abs(lengths - 1) < 1e-12
    unit = np.where(exact[:, None], quaternions, normalized(quaternions))
    return Track(times, positions, unit, np.array(record.valid, np.bool_))


def _camera_record(camera: RigCamera) -> CameraRecord:
    a, b, c, d = (tuple(row) for row in camera.camera_to_ego.tolist())
    return CameraRecord(
        name=camera.name,
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        camera_to_ego=(a, b, c, d),
        exposure_s=camera.exposure_s,
    )


def _camera(record: CameraRecord, rig: str) -> RigCamera:
    matrix = np.array(record.camera_to_ego, np.float64)
    rotation = matrix[:3, :3]
    is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
    if not is_rotation or not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        raise ValueError(f"camera_to_ego of camera {record.name!r} must be a rotation and a place - at `$.rigs.{rig}`")
    return RigCamera(
        record.name,
        record.width,
        record.height,
        record.fx,
        record.fy,
        record.cx,
        record.cy,
        matrix,
        record.exposure_s,
    )
