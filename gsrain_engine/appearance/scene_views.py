"""Clear views of a scene, rendered on the CPU, and the cameras to take them from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import overload

import numpy as np
from jaxtyping import Bool, Float, Float64

from ..datasets.capture import Capture
from ..datasets.geometry import scaled_camera
from ..datasets.undistort import undistort_frame
from ..render.cpu.compositing import color_operator, expected
from ..scene.camera import Camera, look_at
from ..scene.objects import is_vehicle
from ..scene.scene import Actor, DrawItem, Layer, Scene
from .base import ClearView, Image, Plane
from .normals import normals_from_depth, view_rays
from .view_choice import ViewChoice

Classes = Bool[np.ndarray, " n"]
_SOLID = 0.3  # smallest share of non-sky in a pixel with depth
_THERE = (0.1, 0.3)  # alpha below which a pixel shows nothing of the scene, and from which it shows only the scene
_SHADOW_M = 0.08  # height over the road below which a vehicle's Gaussians are its shadow
_OPEN_SKY = np.array([0.72, 0.80, 0.90], np.float32)
"""Display color of the sky in scenes without one; only for viewing, drops use another one."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedCamera:
    """Camera and time of a view; actors are drawn at that time."""

    name: str
    camera: Camera
    """World frame (meters, z up)."""
    time_s: float = 0.0
    sensor: str = ""
    """Camera name within a rig; empty for a single camera."""

    def at_width(self, width_px: int | None) -> "PlacedCamera":
        """Return the same view at a width, with the nearest whole height; None changes nothing."""
        if width_px is None or width_px == self.camera.width:
            return self
        height = max(round(self.camera.height * width_px / self.camera.width), 1)
        return replace(self, camera=scaled_camera(self.camera, width_px, height))


def scene_views(scene: Scene, placed: Sequence[PlacedCamera], width_px: int | None = None) -> Sequence[ClearView]:
    """Views of a scene from cameras in the world, rendered on access; the most recent ones are cached.

    Colors are clear and without grading, which is applied after the colors are solved for. If the scene has no sky of
    its own, empty pixels above the horizon become sky.
    """
    at_width = [each.at_width(width_px) for each in placed]
    return CachedViews(len(at_width), lambda i: scene_view(scene, at_width[i]))


def scene_view(scene: Scene, placed: PlacedCamera) -> ClearView:
    camera = placed.camera
    items, is_sky, is_vehicle = _visible_items(scene, placed.time_s)
    view = color_operator(items, camera)
    own, colors = view.splats.indices, view.splats.colors
    sky, vehicle = is_sky[own].astype(np.float32), is_vehicle[own].astype(np.float32)
    painted = view.blend(np.concatenate([colors[:, :3], ((1 - sky) * colors[:, 3])[:, None]], axis=1))
    kinds = view.blend(np.stack([1 - sky, sky, vehicle], axis=1))
    solid, alpha = np.ascontiguousarray(kinds[..., 0]), kinds[..., 0] + kinds[..., 1]
    depth = expected(np.ascontiguousarray(painted[..., 3]), solid)
    depth[solid <= _SOLID * alpha] = 0
    image = np.stack([expected(np.ascontiguousarray(painted[..., c]), alpha) for c in range(3)], axis=-1)
    sky_share, vehicles = (expected(np.ascontiguousarray(kinds[..., k]), alpha) for k in (1, 2))
    if not is_sky.any():
        image, sky_share, depth = _under_open_sky(image, alpha, depth, camera)
    return ClearView(
        placed.name, camera, placed.time_s, np.clip(image, 0, 1), depth, normals_from_depth(depth, camera),
        np.clip(sky_share, 0, 1), np.clip(vehicles, 0, 1), placed.sensor,
    )  # fmt: skip


def _visible_items(scene: Scene, time_s: float) -> tuple[list[DrawItem], Classes, Classes]:
    """Visible parts at a time, and masks of their Gaussians in the sky and on bodies of vehicles."""
    items: list[DrawItem] = []
    sky, vehicle = [np.zeros(0, np.bool_)], [np.zeros(0, np.bool_)]
    for member in scene.members:
        item = scene.part(member, time_s) if member.visible else None
        if item is not None:
            items.append(item._replace(colors=None))
            sky.append(np.full(len(member.gaussians), isinstance(member, Layer) and member.kind == "sky"))
            body = np.zeros(len(member.gaussians), np.bool_)
            if isinstance(member, Actor) and is_vehicle(member.class_name):
                body = member.gaussians.means[:, 2] * scene.metres_per_unit > _SHADOW_M
            vehicle.append(body)
    return items, np.concatenate(sky), np.concatenate(vehicle)


def _under_open_sky(image: Image, alpha: Plane, depth: Plane, camera: Camera) -> tuple[Image, Plane, Plane]:
    """Fill empty pixels above the horizon with sky; below it, they stay empty.

    A partly covered pixel becomes fully covered: colors are solved for from it, and the scene may have no sky there.
    """
    low, high = _THERE
    t = np.clip((alpha - low) / (high - low), 0, 1)
    there = t * t * (3 - 2 * t)
    sky = np.where(view_rays(camera)[..., 2] > 0, 1 - there, 0).astype(np.float32)
    filled = image * there[..., None] + _OPEN_SKY * sky[..., None]
    return filled, sky, np.where(there > 0.5, depth, np.float32(0))


# View choice: from the recording, along a path, or around the scene

DEFAULT_COUNT = 24
"""Default number of views: enough for a street of 100 m."""
DEFAULT_PIXELS = 480 * 320
"""Default number of pixels of a quick preview, for any aspect ratio."""
OWN_WIDTH_PX = 960
"""Largest default width of images in commands; narrower images keep their width."""
_PLAIN_PX = (960, 640)  # width and height of views that have no images of their own


def chosen_cameras(
    scene: Scene, choice: ViewChoice, capture: Capture | None = None, own_width_px: int | None = None
) -> list[PlacedCamera]:
    """Place cameras in a scene as chosen; names are unique. Raises ValueError if the scene has no such views.

    `capture` is the recording of the scene; its world has the scene's own units and axes. Without a chosen width,
    images have their cameras' width, up to `own_width_px`; None makes them small instead (`ViewChoice.width_px`).
    """
    source, count = choice.source, choice.count or DEFAULT_COUNT
    has_rig = scene.ego is not None and scene.ego.valid.any() and any(scene.rigs.values())
    if source == "recorded" or (source == "auto" and capture is not None):
        placed = _recorded(scene, choice, capture)
    elif source == "rig" or (source == "auto" and has_rig):
        placed = views_along_drive(scene, count, choice.sensors)
    elif source == "path" or (source == "auto" and scene.path is not None):
        placed = _on_the_path(scene, count)
    else:
        placed = views_around_center(scene, count)
    if choice.width_px is None and own_width_px is not None:
        return [each.at_width(min(own_width_px, each.camera.width)) for each in placed]
    return [each.at_width(choice.width_px or _default_width(each)) for each in placed]


def chosen_views(capture: Capture, choice: ViewChoice) -> Capture:
    """Return a capture with only the chosen views; raises ValueError if it has no such camera.

    If several cameras are chosen and the recording lists all of them at each moment, whole moments are chosen.
    """
    views = [view for view in capture if not choice.sensors or view.sensor in choice.sensors]
    if not views:
        there = ", ".join(filter(None, capture.sensors)) or "one without a name"
        raise ValueError(f"{capture.name}: has no camera {', '.join(choice.sensors)}, only {there}")
    at_once = len(choice.sensors)
    moments = [views[i : i + at_once] for i in range(0, len(views), at_once)] if at_once else []
    if (
        choice.count is not None
        and choice.count >= at_once > 1
        and all({view.sensor for view in each} == set(choice.sensors) for each in moments)
    ):
        indices = evenly_spaced_indices(len(moments), choice.count // at_once)
        return replace(capture, views=tuple(view for i in indices for view in moments[i]))
    return replace(capture, views=tuple(views[i] for i in evenly_spaced_indices(len(views), choice.count)))


def _recorded(scene: Scene, choice: ViewChoice, capture: Capture | None) -> list[PlacedCamera]:
    if capture is None:
        raise ValueError(f"recorded views of scene {scene.name!r}: its capture is needed, which nobody has named")
    if not capture.has_poses:
        raise ValueError(f"{capture.name}: has pictures, but not where their cameras stood")
    to_world = scene.scene_to_world
    return [
        PlacedCamera(view.name, undistort_frame(view).camera.moved(to_world), view.time_s, view.sensor)
        for view in chosen_views(capture, choice)
    ]


def _on_the_path(scene: Scene, count: int) -> list[PlacedCamera]:
    path = scene.path
    if path is None:
        raise ValueError(f"scene {scene.name!r} has no camera path")
    # Evenly spaced times; a loop's end is left out, since it repeats the start.
    times: list[float] = np.linspace(path.start_s, path.end_s, count, endpoint=not path.loop).tolist()
    return [
        PlacedCamera(f"path_{i:03d}", path.camera(t, *_PLAIN_PX).moved(scene.scene_to_world), t)
        for i, t in enumerate(times if path.duration_s else [path.start_s])
    ]


def evenly_spaced_indices(there: int, count: int | None) -> Sequence[int]:
    """Evenly spaced indices, `count` out of `there`; all if `count` is None or larger."""
    if count is None or count >= there:
        return range(there)
    return np.floor((np.arange(count) + 0.5) * there / count).astype(int).tolist()


def _default_width(placed: PlacedCamera) -> int:
    """Width at which an image has `DEFAULT_PIXELS` pixels; at most its own."""
    width, height = placed.camera.width, placed.camera.height
    return min(width, max(1, round(width * np.sqrt(DEFAULT_PIXELS / (width * height)))))


# Views of the ego vehicle's rig. World frame (meters, z up).


def views_along_drive(scene: Scene, count: int, sensors: Sequence[str] = ()) -> list[PlacedCamera]:
    """Spread views evenly over the driven distance; every second one looks forward, the other cameras take turns.

    Of `count` views, those at times without an ego vehicle are skipped. `sensors` are the cameras to use, empty for
    all. Raises ValueError if there is no rig or ego trajectory, or no such camera.
    """
    rig = next((cameras for cameras in scene.rigs.values() if cameras), ())
    if scene.ego is None or not scene.ego.valid.any() or not rig:
        raise ValueError(f"scene {scene.name!r} has no ego vehicle with a camera rig")
    chosen = [each for each in rig if not sensors or each.name in sensors]
    if not chosen:
        names = ", ".join(each.name for each in rig)
        raise ValueError(f"scene {scene.name!r}: its rig has no camera {', '.join(sensors)}, only {names}")
    ordered = sorted(chosen, key=lambda each: -each.camera_to_ego[0, 2])  # forward is +x of the ego frame
    front, others = ordered[0], ordered[1:] or ordered
    placed: list[PlacedCamera] = []
    for i, time_s in enumerate(_evenly_driven(scene.ego.times, scene.ego.positions, count)):
        mounted = front if i % 2 == 0 else others[i // 2 % len(others)]
        if (ego_to_world := scene.ego_to_world(time_s)) is not None:
            camera = mounted.camera(ego_to_world).pinhole  # depth, normals and warps are those of pinholes
            placed.append(PlacedCamera(f"{mounted.name}_{i:03d}", camera, time_s, mounted.name))
    return placed


def _evenly_driven(times: Float64[np.ndarray, " t"], positions: Float64[np.ndarray, "t 3"], count: int) -> list[float]:
    """Times at equal shares of the driven distance; of the duration if the vehicle doesn't move."""
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    if driven[-1] <= 0:
        driven = times - times[0]
    return np.interp((np.arange(count) + 0.5) / count * driven[-1], driven, times).tolist()


# Views around a scene of Gaussians alone. World frame (meters, z up).

EYE_HEIGHT_M = 1.6
_RING = 2.2  # radius of the ring of cameras, in half diagonals of the scene


def views_around_center(scene: Scene, count: int) -> list[PlacedCamera]:
    """Alternate between looking outwards from the center (suits a street) and inwards from a ring (suits an object)."""
    middle, reach = _robust_extent(scene)
    placed: list[PlacedCamera] = []
    for i in range(count):
        angle = 2 * np.pi * i / count
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        ring = middle + _RING * reach * outward + np.array([0, 0, 0.3 * reach])
        eye, target = (middle, middle + outward) if i % 2 else (ring, middle)
        pose = look_at(eye, target, np.array([0.0, 0.0, 1.0]))
        placed.append(PlacedCamera(f"around_{i:03d}", Camera.from_fov(*_PLAIN_PX, 60.0, pose)))
    return placed


def _robust_extent(scene: Scene) -> tuple[Float[np.ndarray, "3"], float]:
    """Center and half diagonal of the box around the 5 % to 95 % quantiles of visible Gaussians, without the sky.

    In meters; the center is at eye height if the ground is known.
    """
    layers = [layer for layer in scene.layers if layer.visible and layer.kind != "sky"]
    parts = [part for layer in layers if (part := scene.part(layer)) is not None]
    places = [part.remaining.means @ part.to_world[:3, :3].T + part.to_world[:3, 3] for part in parts]
    points = np.concatenate([np.zeros((0, 3)), *places])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return np.array([0.0, 0.0, EYE_HEIGHT_M]), 1.0
    low, high = np.quantile(points, [0.05, 0.95], axis=0)
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low) / 2)
    if scene.ground_m is not None:
        middle[2] = scene.ground_m + EYE_HEIGHT_M
    return middle, max(reach, 1e-3)


# View cache: neighbors are accessed repeatedly.

CACHED_VIEWS = 6
"""Number of views kept in memory, at 36 bytes per pixel."""


class CachedViews(Sequence[ClearView]):
    """Sequence of views, each made by a function of its index; the most recently used ones are cached."""

    def __init__(self, count: int, make: Callable[[int], ClearView], max_cached: int = CACHED_VIEWS) -> None:
        self._count, self._view_at = count, lru_cache(max_cached)(make)

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> ClearView: ...
    @overload
    def __getitem__(self, index: slice) -> "CachedViews": ...
    def __getitem__(self, index: int | slice) -> "ClearView | CachedViews":
        if isinstance(index, slice):
            chosen = range(self._count)[index]
            return CachedViews(len(chosen), lambda i: self[chosen[i]], 0)  # `self` caches already
        return self._view_at(range(self._count)[index])
