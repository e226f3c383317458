"""A scene: layers and actors, and how they lie in the world; with what else a scene folder holds."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float64

from .grading import UNCHANGED
from .identity import Identity
from .mask import Mask
from .members import Actor, Layer, Part
from .paths.camera_path import CameraPath
from .track import Track


@dataclass(frozen=True, slots=True, eq=False)
class RigCamera:
    """A camera bolted to the ego vehicle, with its pose in the ego frame (x forward, y left, z up)."""

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_ego: Float64[np.ndarray, "4 4"]
    exposure_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that a scene folder holds.

    Layers, tracks, cameras and the ego path are in the scene's own units and axes, as they stand in files.
    `scene_to_world` takes them to the world: metres, z up, right-handed, which is where rain falls.
    """

    name: str
    layers: tuple[Layer, ...] = ()
    actors: tuple[Actor, ...] = ()
    metres_per_unit: float = 1.0
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Upward direction in scene axes."""
    ground_m: float | None = None
    """Height of the ground in the world, where it is known."""
    rigs: Mapping[str, tuple[RigCamera, ...]] = field(default_factory=dict[str, tuple[RigCamera, ...]])
    ego: Track | None = None
    """Where the ego vehicle drives: the origin of the rig frame, which is at sensor height."""
    path: CameraPath | None = None
    """The flight that a person has made, in scene units and axes."""
    rain: Mapping[str, Any] | None = None
    """The rain that was set when the scene was saved, as plain values."""
    weather: Mapping[str, Any] | None = None
    """How that rain changes over time, as plain values."""
    view: Mapping[str, Any] | None = None
    """From where it was looked at when it was saved, as plain values."""
    selections: Mapping[str, Mapping[str, Mask]] = field(default_factory=dict[str, Mapping[str, Mask]])
    """Selection sets by name; each by the keys of members."""
    unit_is_assumed: bool = False
    """Whether neither a file nor a person has said how long a unit is, so that it is only taken for a metre."""

    @property
    def scene_to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Similarity from scene units and axes to the world (metres, z up)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.metres_per_unit * rotation_to_z_up(self.up)
        return matrix

    @property
    def appearance(self) -> Hashable:
        """What a picture depends on: equal for two scenes that look the same; only their paths or notes differ."""
        return self.layers, self.actors, self.metres_per_unit, self.up, self.ground_m, self.ego

    @property
    def matter(self) -> Hashable:
        """What is there to be seen and sheltered under: equal where only selection, locks and names differ."""
        shown = [
            (each.gaussians, Identity(each.wet_sh), each.marks.left_out, each.opacity, each.grading)
            + ((each.kind, each.to_scene.tobytes()) if isinstance(each, Layer) else (each.track,))
            for each in self.members
            if each.visible
        ]
        return *shown, self.metres_per_unit, self.up, self.ground_m, self.ego

    @property
    def members(self) -> tuple[Layer | Actor, ...]:
        """Layers first, then actors, visible or not."""
        return (*self.layers, *self.actors)

    def member(self, key: str) -> Layer | Actor:
        """Find a member by its key; raises `KeyError` where there is none."""
        for each in self.members:
            if each.key == key:
                return each
        raise KeyError(key)

    def with_member(self, key: str, **fields: Any) -> "Scene":
        """Return the scene with fields of one member replaced."""
        layers = tuple(replace(each, **fields) if each.key == key else each for each in self.layers)
        actors = tuple(replace(each, **fields) if each.key == key else each for each in self.actors)
        return replace(self, layers=layers, actors=actors)

    @property
    def gaussian_count(self) -> int:
        """Gaussians in all layers and actors, visible or not, without the deleted ones."""
        deleted = sum(each.marks.deleted.size for each in self.members if each.marks.deleted is not None)
        return sum(len(each.gaussians) for each in self.members) - deleted

    @property
    def has_wet_colors(self) -> bool:
        """Whether anything that can be seen looks different when it is wet."""
        return any(each.wet_sh is not None for each in self.members if each.visible)

    def parts(self, time_s: float = 0.0, *, selection: bool = False, wetness: float = 0.0) -> list[Part]:
        """What can be seen at a time: layers first, then actors.

        `selection` has the selected ones tinted; `wetness` (0..1) blends in the wet colours of those that have them.
        """
        parts = [self.part(each, time_s, selection=selection, wetness=wetness) for each in self.members if each.visible]
        return [part for part in parts if part is not None]

    def part(
        self, member: Layer | Actor, time_s: float = 0.0, *, selection: bool = False, wetness: float = 0.0
    ) -> Part | None:
        """What of a member is drawn at a time; None while it is not there. See `parts`."""
        way = member.way(time_s)
        if way is None:
            return None
        return Part(
            member.gaussians,
            self.scene_to_world @ way,
            left_out=member.marks.left_out,
            selected=member.marks.selected if selection else None,
            opacity=member.opacity,
            colors=None if member.grading == UNCHANGED else member.grading.matrix,
            wet_sh=member.wet_sh,
            wetness=0.0 if member.wet_sh is None else wetness,
        )

    def ego_to_world(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        """Pose of the ego vehicle in metres, without scale; None where the scene has none at that time."""
        pose = self.ego.pose(time_s) if self.ego is not None else None
        if pose is None:
            return None
        matrix = self.scene_to_world @ pose
        matrix[:3, :3] /= self.metres_per_unit
        return matrix


@lru_cache(maxsize=64)
def rotation_to_z_up(up: tuple[float, float, float]) -> Float64[np.ndarray, "3 3"]:
    """Rotation that takes `up` to +z, the smallest but for the nearly upside-down; exact where `up` is an axis."""
    u = np.asarray(up, np.float64)
    u = u / np.linalg.norm(u)
    if u[2] < -0.999:  # the division below would lose all digits: half a turn about x first
        half_turn = np.diag([1.0, -1.0, -1.0])
        x, y, z = (half_turn @ u).tolist()
        rotation = rotation_to_z_up((x, y, z)) @ half_turn
    else:
        v = np.cross(u, [0.0, 0.0, 1.0])
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        rotation = np.eye(3) + cross + cross @ cross / (1 + u[2])
    rotation.flags.writeable = False  # it is handed out again
    return rotation
