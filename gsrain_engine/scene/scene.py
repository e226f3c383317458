"""A scene: named layers of Gaussians, actors that move along tracks, and how the scene lies in the world."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from .gaussians import Gaussians
from .rotations import matrices_from_quaternions


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Gaussians that stand still, in scene units and axes."""

    name: str
    gaussians: Gaussians
    kind: Literal["background", "sky"] = "background"
    visible: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where an actor is over time: samples, linear and slerp between them. Outside its times it stays put."""

    times: Float64[np.ndarray, " t"]
    """Seconds, rising."""
    positions: Float64[np.ndarray, "t 3"]
    """Bottom centre of the object, in scene units and axes."""
    quaternions_wxyz: Float64[np.ndarray, "t 4"]
    """Object (x forward, y left, z up) to scene axes, unit."""
    valid: Bool[np.ndarray, " t"]
    """Whether the object is in the scene from this sample to the next."""

    def pose(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        """Object to scene at a time, or None while the object is not there."""
        if not len(self.times):
            return None
        lower = max(int(np.searchsorted(self.times, time_s, side="right")) - 1, 0)
        upper = min(lower + 1, len(self.times) - 1)
        if not self.valid[lower]:
            return None
        span = self.times[upper] - self.times[lower]
        part = float(np.clip((time_s - self.times[lower]) / span, 0, 1)) if span > 0 else 0.0
        matrix = np.eye(4)
        matrix[:3, :3] = matrices_from_quaternions(
            _slerp(self.quaternions_wxyz[lower], self.quaternions_wxyz[upper], part)
        )
        matrix[:3, 3] = (1 - part) * self.positions[lower] + part * self.positions[upper]
        return matrix


@dataclass(frozen=True, slots=True, eq=False)
class Actor:
    """A thing that moves: Gaussians in its own frame (x forward, y left, z up, origin at the bottom centre)."""

    id: str
    class_name: str
    size_lwh: tuple[float, float, float]
    gaussians: Gaussians
    track: Track
    visible: bool = True


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


class Part(NamedTuple):
    """What a renderer draws: Gaussians, and the similarity that takes them to the world (metres, z up)."""

    gaussians: Gaussians
    to_world: Float64[np.ndarray, "4 4"]
    limit: int | None = None
    """Draw only the first so many of them; none draws all."""
    growth: float = 1.0
    """Draw them so many times larger, to fill in for those that are left out."""

    @property
    def drawn_count(self) -> int:
        """How many are drawn."""
        return len(self.gaussians) if self.limit is None else min(self.limit, len(self.gaussians))


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
    rain: Mapping[str, Any] | None = None
    """The rain that was set when the scene was saved, as plain values."""

    @property
    def scene_to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Similarity from scene units and axes to the world (metres, z up)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.metres_per_unit * rotation_to_z_up(self.up)
        return matrix

    @property
    def gaussian_count(self) -> int:
        """Gaussians in all layers and actors, visible or not."""
        return sum(len(each.gaussians) for each in (*self.layers, *self.actors))

    def parts(self, time_s: float = 0.0) -> list[Part]:
        """What can be seen at a time: visible layers first, then actors, each with its way to the world."""
        to_world = self.scene_to_world
        parts = [Part(layer.gaussians, to_world) for layer in self.layers if layer.visible]
        for actor in self.actors:
            pose = actor.track.pose(time_s) if actor.visible else None
            if pose is not None:
                parts.append(Part(actor.gaussians, to_world @ pose))
        return parts

    def ego_to_world(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        """Pose of the ego vehicle in metres, without scale; None where the scene has none at that time."""
        pose = self.ego.pose(time_s) if self.ego is not None else None
        if pose is None:
            return None
        matrix = self.scene_to_world @ pose
        matrix[:3, :3] /= self.metres_per_unit
        return matrix

    def with_layer(self, name: str, gaussians: Gaussians) -> "Scene":
        """Return the scene with the Gaussians of one layer replaced."""
        if name not in [layer.name for layer in self.layers]:
            raise ValueError(f"scene {self.name!r} has no layer {name!r}")
        layers = tuple(replace(layer, gaussians=gaussians) if layer.name == name else layer for layer in self.layers)
        return replace(self, layers=layers)


def rotation_to_z_up(up: tuple[float, float, float]) -> Float64[np.ndarray, "3 3"]:
    """Rotation that takes `up` to +z, the smallest but for the nearly upside-down; exact where `up` is an axis."""
    u = np.asarray(up, np.float64)
    u = u / np.linalg.norm(u)
    if u[2] < -0.999:  # the division below would lose all digits: half a turn about x first
        half_turn = np.diag([1.0, -1.0, -1.0])
        x, y, z = half_turn @ u
        return rotation_to_z_up((x, y, z)) @ half_turn
    v = np.cross(u, [0.0, 0.0, 1.0])
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + u[2])


def _slerp(start: Float64[np.ndarray, "4"], end: Float64[np.ndarray, "4"], part: float) -> Float64[np.ndarray, "4"]:
    """Spherical linear interpolation of unit quaternions along the shorter way (Shoemake, 1985)."""
    cosine = float(start @ end)
    if cosine < 0:
        end, cosine = -end, -cosine
    if cosine > 0.9995:  # nearly equal: the sine below would divide by nothing
        mixed = (1 - part) * start + part * end
    else:
        angle = np.arccos(cosine)
        mixed = (np.sin((1 - part) * angle) * start + np.sin(part * angle) * end) / np.sin(angle)
    return mixed / np.linalg.norm(mixed)
