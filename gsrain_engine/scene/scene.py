"""Scenes: layers, actors, pose tracks and color grading, their transformation to the world, and their bounds."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64
from msgspec import Meta

from ..settings import Settings
from .camera import Camera
from .camera_path import CameraPath
from .flags import UNMARKED, BitMask, SelectionFlags
from .gaussians import Gaussians, IdentityKey, scene_cache
from .geometry import LUMINANCE, matrices_from_quaternions, quaternions_from_matrices
from .ground_water import GroundWater
from .lamps import Lamp, LitLamps, lit_lamps
from .lens import Lens
from .lod_tree import LodTree
from .named_view import NamedView
from .rolling_shutter import ReadoutDirection, RollingShutter

_ROBUST_SHARE = 0.98  # fraction of the opacity along an axis inside the robust box; captures have strays far outside
_SAMPLES = 1_000_000
"""Maximum number of Gaussians sampled for the robust box, evenly in order: sorting all of 10 million takes seconds."""

_CORE_SAMPLES = 100_000
"""Maximum number of Gaussians sampled for the core, evenly in order: a tenth of a second for any scene."""

_CORE_SHARE = 0.25  # minimum fraction of the opacity in the core
_GROWTH = 0.15  # the core's radius R maximizes share / R^0.15: twice the radius must gain 11 %
_SHELL_BEGINS = 3.0
"""Distance from the core's center, in radii of the core, beyond which Gaussians may belong to a shell."""

_SHELL_COVERS = 0.2
"""Minimum fraction of all directions that a shell covers; a dome covers half of them, strays next to nothing."""

_RINGS, _SECTORS = 4, 8  # cells of directions with equal solid angle


class Aabb(NamedTuple):
    """An axis-aligned bounding box."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]


# Items to draw


class DrawItem(NamedTuple):
    """Gaussians to draw, with the similarity from them to the world (meters, z up)."""

    gaussians: Gaussians
    to_world: Float64[np.ndarray, "4 4"]
    limit: int | None = None
    """Draw only the first `limit` Gaussians; None draws all."""
    growth: float = 1.0
    """Scale factor of the drawn Gaussians, to fill in for omitted ones."""
    left_out: BitMask | None = None
    """Gaussians that are not drawn."""
    selected: BitMask | None = None
    """Gaussians that are drawn tinted."""
    opacity: float = 1.0
    """Factor on each Gaussian's own opacity."""
    colors: Float64[np.ndarray, "3 4"] | None = None
    """Affine map of display colors, before clamping at 0."""
    wet_sh: Float32[np.ndarray, "n k 3"] | None = None
    """Harmonics of the Gaussians when fully wet; None without wet colors."""
    wetness: float = 0.0
    """0..1: colors are (1 - wetness) of the clear ones and wetness of the wet ones."""
    members: Int64[np.ndarray, " m"] | None = None
    """Indices of the Gaussians that are drawn, instead of `limit` and `left_out`; None draws all."""
    tree: LodTree | None = None
    """Tree of the Gaussians for a cut; renderers ignore it."""
    film: Float32[np.ndarray, "n 2"] | None = None
    """Shares of a film and of standing water that mirror the scene, by Gaussian; None without water."""
    to_world_ends: tuple[Float64[np.ndarray, "4 4"], Float64[np.ndarray, "4 4"]] | None = None
    """Similarities at the first and the last row of a rolling shutter; None if it does not move meanwhile."""

    @property
    def is_wet(self) -> bool:
        """Return whether wet colors contribute."""
        return self.wet_sh is not None and self.wetness > 0

    @property
    def drawn_count(self) -> int:
        """Number of Gaussians within the limit, including those in `left_out`, or of `members`."""
        if self.members is not None:
            return len(self.members)
        return len(self.gaussians) if self.limit is None else min(self.limit, len(self.gaussians))

    @property
    def remaining(self) -> Gaussians:
        """Gaussians without those in `left_out`; the identical object if there are none."""
        return self.gaussians if not self.left_out else self.gaussians.take((~self.left_out).indices)


class SkyShell(NamedTuple):
    """A sky or other distant surroundings of a scene, relative to the core's center."""

    middle: Float64[np.ndarray, "3"]
    nearest_m: float
    """Gaussians nearer to the center do not belong to it."""
    radius_m: float
    """Median distance from the center, weighted by covered solid angle."""
    smallest: float
    """Size over distance: Gaussians that appear smaller from the center are strays and do not belong to it either."""

    def holds(self, part: DrawItem) -> Bool[np.ndarray, " n"]:
        """Mask of an item's Gaussians that belong to the shell, including those in `left_out`."""
        means = part.gaussians.means @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        distances = np.linalg.norm(means - self.middle, axis=1)
        scale = np.cbrt(np.linalg.det(part.to_world[:3, :3]))
        sizes = scale * part.gaussians.scales.max(axis=1, initial=0)
        return (distances > self.nearest_m) & (sizes > self.smallest * distances)


class SceneCore(NamedTuple):
    """The dense region of a scene. World frame, meters."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    shell: SkyShell | None = None
    """Distant surroundings, if any."""

    @property
    def middle(self) -> Float64[np.ndarray, "3"]:
        return (self.low + self.high) / 2

    @property
    def corners(self) -> Float64[np.ndarray, "8 3"]:
        return np.stack(np.meshgrid(*zip(self.low, self.high, strict=True)), axis=-1).reshape(-1, 3)

    @property
    def radius_m(self) -> float:
        return float(np.linalg.norm(self.high - self.low)) / 2

    @property
    def farthest_m(self) -> float:
        """Maximum viewing distance from the center: inside the shell, otherwise limited by visibility."""
        if self.shell is None:
            return 50 * self.radius_m
        return max(0.8 * self.shell.radius_m, 1.2 * self.radius_m)


def core_bounds(parts: Sequence[DrawItem], sky: Sequence[DrawItem] = ()) -> SceneCore:
    """Find the dense core of items, and the shell far around it; `sky` are items known to belong to the shell.

    The core's center is found by six times keeping the denser half of the Gaussians (half-sample mode of Robertson and
    Cryer 1974, with medians); the core ends where a larger radius gains little, see `_GROWTH`. Opacities are weights.
    The box holds 98 % of the core along each axis, and is never smaller than a typical Gaussian. Gaussians beyond three
    radii are a shell if they cover a fifth of all directions. Non-finite values are ignored; without Gaussians the core
    is a point at the origin.
    """
    samples = _samples(parts)
    means, sizes, weights = samples
    if not len(means):
        return SceneCore(np.zeros(3), np.zeros(3))
    size = 2 * float(_weighted_quantiles(sizes, weights, [0.5])[0])
    middle, near = np.zeros(3), np.ones(len(means), np.bool_)
    for _ in range(6):
        middle = np.array([_weighted_quantiles(column, weights[near], [0.5])[0] for column in means[near].T])
        distances = np.linalg.norm(means - middle, axis=1)
        near &= distances <= np.median(distances[near])
    distances = np.linalg.norm(means - middle, axis=1)
    order = np.argsort(distances)
    shares = np.cumsum(weights[order]) / weights.sum()
    worth = shares / np.maximum(distances[order], max(size, 1e-9)) ** _GROWTH
    radius = float(distances[order][np.argmax(np.where(shares >= _CORE_SHARE, worth, 0.0))])
    inside = distances <= radius
    ends = [(1 - _ROBUST_SHARE) / 2, (1 + _ROBUST_SHARE) / 2]
    low, high = np.array([_weighted_quantiles(column, weights[inside], ends) for column in means[inside].T]).T
    half = np.maximum((high - low) / 2, size)
    core = SceneCore((low + high) / 2 - half, (low + high) / 2 + half)
    return core._replace(shell=_shell(core, samples, _samples(sky)))


class _PointSamples(NamedTuple):
    means: Float64[np.ndarray, "n 3"]
    sizes: Float64[np.ndarray, " n"]
    """Largest standard deviations."""
    weights: Float64[np.ndarray, " n"]


def _samples(parts: Sequence[DrawItem]) -> _PointSamples:
    step = -(-sum(len(part.gaussians) for part in parts) // _CORE_SAMPLES) or 1
    places, sizes, weights = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0)]
    for part in parts:
        there = np.arange(0, len(part.gaussians), step)
        if part.left_out:
            there = there[~part.left_out.flags[there]]
        g, scale = part.gaussians, float(np.cbrt(np.linalg.det(part.to_world[:3, :3])))
        means = g.means[there].astype(np.float64) @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        longest = scale * g.scales[there].max(axis=1, initial=0.0).astype(np.float64)
        opacities = part.opacity * g.opacities[there].astype(np.float64)
        good = np.isfinite(means).all(axis=1) & np.isfinite(longest) & np.isfinite(opacities)
        places.append(means[good])
        sizes.append(longest[good])
        weights.append(opacities[good])
    weight = np.concatenate(weights)
    return _PointSamples(np.concatenate(places), np.concatenate(sizes), weight if weight.sum() > 0 else weight + 1)


def _shell(core: SceneCore, samples: _PointSamples, sky: _PointSamples) -> SkyShell | None:
    """Find distant surroundings of the core by the fraction of directions that they cover."""
    nearest_m = _SHELL_BEGINS * max(core.radius_m, 1e-9)
    means, sizes, weights = (np.concatenate(pair) for pair in zip(samples, sky, strict=True))
    is_sky = np.arange(len(means)) >= len(samples[0])
    away = means - core.middle
    distances = np.linalg.norm(away, axis=1)
    far = (distances > nearest_m) | (is_sky & (distances > 0))
    if not far.any():
        return None
    away, distances = away[far], distances[far]
    covered = 2 * np.pi * weights[far] * (sizes[far] / distances) ** 2  # steradians
    ring = np.clip((away[:, 2] / distances + 1) * _RINGS / 2, 0, _RINGS - 1).astype(int)
    sector = np.clip((np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS, 0, _SECTORS - 1).astype(int)
    cells = _RINGS * _SECTORS
    full = 4 * np.pi / cells
    share = np.minimum(np.bincount(ring * _SECTORS + sector, covered, cells) / full, 1.0).mean()
    if share < _SHELL_COVERS and not is_sky.any():
        return None
    weights = covered if covered.sum() > 0 else np.ones(len(covered))
    radius_m = float(_weighted_quantiles(distances, weights, [0.5])[0])
    size = float(_weighted_quantiles(sizes[far] / distances, weights, [0.5])[0])
    return SkyShell(core.middle, nearest_m, radius_m, size / 10)


def bounds(gaussians: Gaussians) -> Aabb:
    """Box around all centers; without Gaussians a point at the origin."""
    if not len(gaussians):
        return Aabb(np.zeros(3), np.zeros(3))
    low, high = ([end(column) for column in gaussians.means.T] for end in (np.min, np.max))
    return Aabb(np.array(low, np.float64), np.array(high, np.float64))


def robust_bounds(*sets: Gaussians, share: float = _ROBUST_SHARE) -> Aabb:
    """Box of the middle `share` (0..1) of all opacity along each axis; without Gaussians a point at the origin.

    If everything is fully transparent, all centers have equal weight. More than a million Gaussians are sampled evenly.
    """
    step = -(-sum(map(len, sets)) // _SAMPLES) or 1
    means = np.concatenate([np.zeros((0, 3), np.float32), *(each.means[::step] for each in sets)])
    weights = np.concatenate([np.zeros(0), *(each.opacities[::step].astype(np.float64) for each in sets)])
    if not weights.sum() > 0:
        weights = np.ones(len(weights))
    ends = [(1 - share) / 2, (1 + share) / 2]
    columns = [_weighted_quantiles(column, weights, ends) for column in means.T] if len(means) else []
    low, high = np.array(columns, np.float64).T if columns else np.zeros((2, 3))
    return Aabb(low, high)


_OBJECT_M = 20.0


def is_single_object(scene: "Scene") -> bool:
    """Return whether a scene shows one thing without surroundings: neither sky nor drive, at most 20 m wide."""
    if scene.ego is not None or any(each.kind == "sky" for each in scene.layers):
        return False
    layers = tuple(each.gaussians for each in scene.layers if each.visible)
    return scene.metres_per_unit * _widest(layers) <= _OBJECT_M


@scene_cache(maxsize=4)
def _widest(layers: tuple[Gaussians, ...]) -> float:
    """Longest edge of the robust box, in the scene's unit."""
    low, high = robust_bounds(*layers)
    return float((high - low).max())


def _weighted_quantiles(
    values: Float[np.ndarray, " n"], weights: Float64[np.ndarray, " n"], shares: list[float]
) -> Float64[np.ndarray, " s"]:
    """Smallest values with at least these fractions of the weight at or below them."""
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    index = np.searchsorted(summed, np.array(shares) * summed[-1])
    return values[order[np.minimum(index, len(values) - 1)]].astype(np.float64)


# Rigs


@dataclass(frozen=True, slots=True, eq=False)
class RigCamera:
    """A camera mounted on the ego vehicle, with its pose in the ego frame (x forward, y left, z up)."""

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_ego: Float64[np.ndarray, "4 4"]
    exposure_s: float
    lens: Lens | None = None
    """None is a pinhole."""
    readout_s: float = 0.0
    """Time from the first row of a picture to the last, of scene and rain; 0 is a global shutter."""
    readout_direction: ReadoutDirection = "down"

    @property
    def is_bent(self) -> bool:
        """True with a lens or a rolling shutter."""
        return self.lens is not None or self.readout_s > 0

    def camera(self, ego_to_world: Float64[np.ndarray, "4 4"], rolling: RollingShutter | None = None) -> Camera:
        """Camera in the world for a pose of the ego vehicle."""
        return Camera(
            self.width, self.height, self.fx, self.fy, self.cx, self.cy,
            np.linalg.inv(ego_to_world @ self.camera_to_ego), self.exposure_s, self.lens, rolling,
        )  # fmt: skip

    def rolling(
        self, first_row: Float64[np.ndarray, "4 4"] | None, last_row: Float64[np.ndarray, "4 4"] | None
    ) -> RollingShutter | None:
        """Rolling shutter between poses of the ego vehicle; None for a global shutter, or where there is none."""
        if self.readout_s == 0 or first_row is None or last_row is None:
            return None
        ends = first_row @ self.camera_to_ego, last_row @ self.camera_to_ego
        return RollingShutter.between(*ends, self.readout_s, self.readout_direction)[1]


# Pose tracks


@dataclass(frozen=True, slots=True, eq=False)
class PoseTrack:
    """Poses over time: samples, with linear interpolation and slerp between them, constant outside."""

    times: Float64[np.ndarray, " t"]
    """Seconds, increasing."""
    positions: Float64[np.ndarray, "t 3"]
    """Bottom center of the object, in scene units and axes."""
    quaternions_wxyz: Float64[np.ndarray, "t 4"]
    """Object (x forward, y left, z up) to scene axes, unit."""
    valid: Bool[np.ndarray, " t"]
    """True if the object is in the scene from this sample to the next."""

    @classmethod
    def standing(cls, pose: Float64[np.ndarray, "4 4"]) -> "PoseTrack":
        """Track of an object at rest; of a pose with scale, it uses only position and rotation."""
        turn = pose[:3, :3] / np.cbrt(np.linalg.det(pose[:3, :3]))
        quaternion = np.asarray(quaternions_from_matrices(turn[None]), np.float64)
        return cls(np.zeros(1), pose[None, :3, 3].copy(), quaternion, np.ones(1, bool))

    def pose(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        """Object to scene at a time, or None while the object is absent."""
        if not len(self.times):
            return None
        lower = max(int(self.times.searchsorted(time_s, side="right")) - 1, 0)
        upper = min(lower + 1, len(self.times) - 1)
        if not self.valid[lower]:
            return None
        first, last = float(self.times[lower]), float(self.times[upper])
        part = min(max((time_s - first) / (last - first), 0.0), 1.0) if last > first else 0.0
        matrix = np.eye(4)
        quaternion = _slerp(self.quaternions_wxyz[lower], self.quaternions_wxyz[upper], part)
        matrix[:3, :3] = matrices_from_quaternions(quaternion)
        matrix[:3, 3] = (1 - part) * self.positions[lower] + part * self.positions[upper]
        return matrix

    def moved(self, similarity: Float64[np.ndarray, "4 4"]) -> "PoseTrack":
        turn = similarity[:3, :3] / np.cbrt(np.linalg.det(similarity[:3, :3]))
        quaternions = quaternions_from_matrices(turn @ matrices_from_quaternions(self.quaternions_wxyz))
        return PoseTrack(self.times, self.positions @ similarity[:3, :3].T + similarity[:3, 3], quaternions, self.valid)


# Color grading
# An affine map of display colors, so that it can be baked into harmonics exactly.


class ColorGrading(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Color adjustments in the order of application. The defaults change nothing."""

    exposure_ev: Annotated[
        float, Meta(ge=-6, le=6, title="Exposure", description="Stops brighter or darker.", extra={"unit": "EV"})
    ] = 0.0
    temperature: Annotated[
        float, Meta(ge=-1, le=1, title="Temperature", description="Blue to the left, amber to the right.")
    ] = 0.0
    tint: Annotated[float, Meta(ge=-1, le=1, title="Tint", description="Green to the left, magenta to the right.")] = (
        0.0
    )
    contrast: Annotated[
        float, Meta(ge=0, le=3, title="Contrast", description="Distance from middle gray; 1 changes nothing.")
    ] = 1.0
    saturation: Annotated[
        float, Meta(ge=0, le=3, title="Saturation", description="Distance from gray; 1 changes nothing, 0 is gray.")
    ] = 1.0

    @property
    def matrix(self) -> Float64[np.ndarray, "3 4"]:
        """Affine map: display color c (0..1) becomes matrix[:, :3] @ c + matrix[:, 3]."""
        light = 2.0**self.exposure_ev * np.array(
            [2.0 ** (self.temperature + self.tint / 2), 2.0**-self.tint, 2.0 ** (-self.temperature + self.tint / 2)]
        )
        gains = np.diag(light ** (1 / _ENCODING))
        greyed = np.outer(np.ones(3), LUMINANCE)
        linear = (self.saturation * np.eye(3) + (1 - self.saturation) * greyed) @ (self.contrast * gains)
        return np.concatenate([linear, np.full((3, 1), 0.5 * (1 - self.contrast))], axis=1)


_ENCODING = 2.2  # approximate display gamma: a factor on light is this root of it in display values
UNCHANGED = ColorGrading()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneNode:
    """Common fields of layers and actors."""

    visible: bool = True
    locked: bool = False
    """True if selection and edits skip it."""
    opacity: float = 1.0
    """Factor on the opacity of each Gaussian; 0..1."""
    grading: ColorGrading = UNCHANGED
    marks: SelectionFlags = UNMARKED
    """Selected, hidden and deleted Gaussians."""
    wet_sh: Float32[np.ndarray, "n k 3"] | None = None
    """Harmonics of its Gaussians when fully wet, of the same shape as the clear ones; None without wet colors.

    Treat the array as immutable, and as one with `gaussians`: reorder or rotate both together.
    """
    tree: LodTree | None = None
    """Level-of-detail tree of its Gaussians; after an edit of them it does not fit any more, and is ignored."""


@dataclass(frozen=True, slots=True, eq=False)
class Layer(SceneNode):
    """Static Gaussians."""

    name: str
    gaussians: Gaussians
    kind: Literal["background", "sky"] = "background"
    to_scene: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Similarity from the Gaussians' own units and axes to the scene's."""

    def __post_init__(self) -> None:
        _check_wet_colors(self.key, self.gaussians, self.wet_sh)

    @property
    def key(self) -> str:
        """Name among all members of a scene."""
        return f"layers/{self.name}"

    def pose_at(self, time_s: float) -> Float64[np.ndarray, "4 4"]:
        """Similarity to the scene, the same at any time."""
        return self.to_scene


@dataclass(frozen=True, slots=True, eq=False)
class Actor(SceneNode):
    """A moving object: Gaussians in its own frame (x forward, y left, z up, origin at the bottom center)."""

    id: str
    class_name: str
    size_lwh: tuple[float, float, float]
    gaussians: Gaussians
    track: PoseTrack

    def __post_init__(self) -> None:
        _check_wet_colors(self.key, self.gaussians, self.wet_sh)

    @property
    def key(self) -> str:
        return f"actors/{self.id}"

    @property
    def name(self) -> str:
        return self.id

    def pose_at(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        """Pose in the scene at a time; None while it is absent."""
        return self.track.pose(time_s)


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Scene:
    """Content of a scene folder.

    Layers, tracks, cameras and the ego path are in the scene's own units and axes, as in files. `scene_to_world` maps
    them to the world: meters, z up, right-handed, the frame of the rain.
    """

    name: str
    layers: tuple[Layer, ...] = ()
    actors: tuple[Actor, ...] = ()
    metres_per_unit: float = 1.0
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Upward direction in scene axes."""
    ground_m: float | None = None
    """Height of the ground in the world, if known."""
    rigs: Mapping[str, tuple[RigCamera, ...]] = field(default_factory=dict[str, tuple[RigCamera, ...]])
    ego: PoseTrack | None = None
    """Track of the ego vehicle: the origin of the rig frame, which is at sensor height."""
    motions: Mapping[str, PoseTrack] = field(default_factory=dict[str, PoseTrack])
    """Motions that led to poses which are fixed, for spray: by the ids of actors, and "ego". Not saved."""
    path: CameraPath | None = None
    """The user's camera path, in scene units and axes."""
    rain: Mapping[str, Any] | None = None
    """Rain settings saved with the scene, as plain values."""
    weather: Mapping[str, Any] | None = None
    """Rain over time, as plain values."""
    view: Mapping[str, Any] | None = None
    """Camera view of the window saved with the scene, as plain values."""
    views: tuple[NamedView, ...] = ()
    """Named views in the order of their list."""
    selections: Mapping[str, Mapping[str, BitMask]] = field(default_factory=dict[str, Mapping[str, BitMask]])
    """Selection sets by name; each by the keys of members."""
    lamps: tuple[Lamp, ...] = ()
    """Lamps that light drops and medium."""
    water: GroundWater | None = None
    """Water on the ground, which mirrors the scene; None without a map of it."""
    unit_is_assumed: bool = False
    """True if neither a file nor the user has set the length of a unit, so that it is assumed to be a meter."""
    up_is_assumed: bool = False
    """True if neither a file nor the user has set the upward direction, so that it is assumed to be that of COLMAP."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Place of the scene's origin in the coordinates of the files that it came from, in its units and axes.

    32-bit floats hold no details of places such as those of UTM, so positions are relative to this one.
    """

    def __repr__(self) -> str:
        counts = f"{len(self.layers)} layers, {len(self.actors)} actors, {self.gaussian_count:,} Gaussians"
        return f"<gsrain.Scene {self.name!r}: {counts}>"

    @property
    def scene_to_world(self) -> Float64[np.ndarray, "4 4"]:
        """Similarity from scene units and axes to the world (meters, z up)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.metres_per_unit * rotation_to_z_up(self.up)
        return matrix

    @property
    def appearance(self) -> Hashable:
        """Key of everything that an image depends on: equal for scenes that differ only in paths or notes."""
        return (
            self.layers,
            self.actors,
            self.metres_per_unit,
            self.up,
            self.ground_m,
            self.ego,
            self.lamps,
            IdentityKey(self.water),
        )

    @property
    def geometry_key(self) -> Hashable:
        """Key of the geometry that is visible and shelters from rain: selection, locks and names do not change it."""
        shown = [
            (each.gaussians, IdentityKey(each.wet_sh), each.marks.left_out, each.opacity, each.grading)
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
        """Return a member by its key; raises `KeyError` if there is none."""
        for each in self.members:
            if each.key == key:
                return each
        raise KeyError(key)

    def with_member(self, key: str, **fields: Any) -> "Scene":
        layers = tuple(replace(each, **fields) if each.key == key else each for each in self.layers)
        actors = tuple(replace(each, **fields) if each.key == key else each for each in self.actors)
        return replace(self, layers=layers, actors=actors)

    @property
    def gaussian_count(self) -> int:
        """Number of Gaussians in all layers and actors, visible or not, without the deleted ones."""
        deleted = sum(each.marks.deleted.size for each in self.members if each.marks.deleted is not None)
        return sum(len(each.gaussians) for each in self.members) - deleted

    @property
    def has_wet_colors(self) -> bool:
        """Return whether any visible member has wet colors."""
        return any(each.wet_sh is not None for each in self.members if each.visible)

    @property
    def has_rainy_light(self) -> bool:
        """Return whether the surroundings themselves have wet colors, not only actors in them."""
        return any(each.wet_sh is not None for each in self.layers if each.visible)

    def parts(
        self,
        time_s: float = 0.0,
        *,
        selection: bool = False,
        wetness: float = 0.0,
        overcast: float | None = None,
        readout_s: float = 0.0,
    ) -> list[DrawItem]:
        """Visible items at a time: layers first, then actors.

        `selection` tints selected Gaussians; `wetness` (0..1) blends in the wet colors of members that have them, and
        `overcast` those of sky layers (None: `wetness`, too). During a readout around that time, actors move.
        """
        sky, to_world, parts = wetness if overcast is None else overcast, self.scene_to_world, list[DrawItem]()
        for each in self.members:
            if each.visible:
                own = sky if is_sky(each) else wetness
                part = _part(each, to_world, time_s, selection=selection, wetness=own, readout_s=readout_s)
                parts += [] if part is None else [part]
        return parts

    def part(
        self,
        member: Layer | Actor,
        time_s: float = 0.0,
        *,
        selection: bool = False,
        wetness: float = 0.0,
        readout_s: float = 0.0,
    ) -> DrawItem | None:
        """Item of a member at a time; None while it is absent. See `parts`."""
        to_world = self.scene_to_world
        return _part(member, to_world, time_s, selection=selection, wetness=wetness, readout_s=readout_s)

    def ego_to_world(self, time_s: float) -> Float64[np.ndarray, "4 4"] | None:
        """Pose of the ego vehicle in meters, without scale; None if the scene has none at that time."""
        pose = self.ego.pose(time_s) if self.ego is not None else None
        if pose is None:
            return None
        matrix = self.scene_to_world @ pose
        matrix[:3, :3] /= self.metres_per_unit
        return matrix

    def lamps_at(self, time_s: float, lamps: Sequence[Lamp] | None = None) -> LitLamps:
        """Lamps in the world at a time, by default the scene's own; those of hidden or absent vehicles are off."""
        actors = {actor.id: actor for actor in self.actors if actor.visible}
        placed: list[tuple[Lamp, Float64[np.ndarray, "4 4"]]] = []
        for lamp in self.lamps if lamps is None else lamps:
            if lamp.mount == "ego":
                mount = self.ego_to_world(time_s)
            elif lamp.mount == "scene":
                mount = self.scene_to_world
            else:
                pose = actors[lamp.mount].pose_at(time_s) if lamp.mount in actors else None
                mount = None if pose is None else self.scene_to_world @ pose
            if mount is not None:
                placed.append((lamp, mount))
        return lit_lamps(placed)


def _part(
    member: Layer | Actor,
    scene_to_world: Float64[np.ndarray, "4 4"],
    time_s: float,
    *,
    selection: bool,
    wetness: float,
    readout_s: float,
) -> DrawItem | None:
    pose = member.pose_at(time_s)
    if pose is None:
        return None
    ends: tuple[Float64[np.ndarray, "4 4"], Float64[np.ndarray, "4 4"]] | None = None
    if readout_s > 0 and isinstance(member, Actor):
        first, last = (member.pose_at(time_s + side * readout_s / 2) for side in (-1, 1))
        ends = scene_to_world @ (pose if first is None else first), scene_to_world @ (pose if last is None else last)
    return DrawItem(
        member.gaussians,
        scene_to_world @ pose,
        left_out=member.marks.left_out,
        selected=member.marks.selected if selection else None,
        opacity=member.opacity,
        colors=None if member.grading == UNCHANGED else member.grading.matrix,
        wet_sh=member.wet_sh,
        wetness=0.0 if member.wet_sh is None else 1.0 if wetness > _AS_WET_AS_SOAKED else wetness,
        tree=member.tree if member.tree is not None and member.tree.fits(member.gaussians) else None,
        to_world_ends=ends,
    )


_AS_WET_AS_SOAKED = 1 - 2**-11
"""Wetness above which a member is fully wet: an eighth of a gray level at most, and one set of colors to evaluate."""


def is_sky(member: Layer | Actor) -> bool:
    """Return whether a member is a layer of the sky."""
    return isinstance(member, Layer) and member.kind == "sky"


def ahead_of(scene: Scene) -> Float64[np.ndarray, "3"]:
    """Level unit vector of the world along which a scene without a drive is first looked at.

    Captures look along their +z if up is -y (COLMAP's axes), along +x if up is +z.
    """
    ahead = scene.scene_to_world[:3, 0 if scene.up == (0.0, 0.0, 1.0) else 2] * np.array([1.0, 1.0, 0.0])
    return ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-6 else np.array([1.0, 0.0, 0.0])


@lru_cache(maxsize=64)
def rotation_to_z_up(up: tuple[float, float, float]) -> Float64[np.ndarray, "3 3"]:
    """Rotation that maps `up` to +z: the smallest, except nearly upside down; exact if `up` is an axis."""
    u = np.asarray(up, np.float64)
    u = u / np.linalg.norm(u)
    if u[2] < -0.999:  # the division below would lose all digits: rotate by half a turn about x first
        half_turn = np.diag([1.0, -1.0, -1.0])
        x, y, z = (half_turn @ u).tolist()
        rotation = rotation_to_z_up((x, y, z)) @ half_turn
    else:
        v = np.cross(u, [0.0, 0.0, 1.0])
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        rotation = np.eye(3) + cross + cross @ cross / (1 + u[2])
    rotation.flags.writeable = False  # the cached array is shared
    return rotation


def _slerp(start: Float64[np.ndarray, "4"], end: Float64[np.ndarray, "4"], part: float) -> Float64[np.ndarray, "4"]:
    """Spherical linear interpolation of unit quaternions along the shorter arc (Shoemake, 1985)."""
    cosine = float(start @ end)
    if cosine < 0:
        end, cosine = -end, -cosine
    if cosine > 0.9995:  # nearly equal: the sine below would be near 0
        mixed = (1 - part) * start + part * end
    else:
        angle = np.arccos(cosine)
        mixed = (np.sin((1 - part) * angle) * start + np.sin(part * angle) * end) / np.sin(angle)
    return mixed / np.sqrt(mixed @ mixed)


def grade_sh(sh: Float32[np.ndarray, "n k 3"], matrix: Float64[np.ndarray, "3 4"]) -> Float32[np.ndarray, "n k 3"]:
    """Harmonics of colors after an affine map; colors are sums of harmonics + 0.5, as in 3DGS."""
    changed = sh.astype(np.float64) @ matrix[:, :3].T
    changed[:, 0] += (matrix @ np.array([0.5, 0.5, 0.5, 1.0]) - 0.5) / _FIRST
    return changed.astype(np.float32)


_FIRST = 0.28209479177387814  # the first harmonic, 1/(2 sqrt(pi))


def take_gaussians(
    member: Layer | Actor, indices: Int64[np.ndarray, " m"]
) -> tuple[Gaussians, Float32[np.ndarray, "m k 3"] | None]:
    """Pick Gaussians of a member by index, with their wet colors."""
    return member.gaussians.take(indices), None if member.wet_sh is None else member.wet_sh[indices]


def _check_wet_colors(key: str, gaussians: Gaussians, wet_sh: Float32[np.ndarray, "_ _ 3"] | None) -> None:
    if not isinstance(gaussians, Gaussians):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise TypeError(f"{key}: gaussians of type {type(gaussians).__name__}, expected Gaussians")
    if wet_sh is not None and np.shape(wet_sh) != gaussians.sh.shape:
        raise ValueError(
            f"{key}: wet colors have shape {np.shape(wet_sh)}, expected {gaussians.sh.shape} as the clear ones"
        )
