"""Environment of wet ground: finds the ground in views and renders its mirror image."""

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float64

from ...scene.flags import BitMask, SelectionFlags
from ...scene.geometry import matrices_from_quaternions
from ...scene.scene import Layer, Scene
from ..base import ClearView
from ..normals import view_rays, world_points
from ..scene_views import PlacedCamera, scene_view
from .ground_plane import GroundHeights, GroundPlane, fit_ground_plane, ground_heights
from .masks import VisibleGround, find_visible_ground, smoothstep
from .reflections import PlanarReflection, fill_reflection_holes, mirror_camera, screen_space_reflection


@runtime_checkable
class ReflectionEnvironment(Protocol):
    """Source of ground and reflections for the wet look."""

    def ground(self, view: ClearView) -> VisibleGround | None:
        """Find the ground in a view; None if it shows none."""
        ...

    def mirrored(self, view: ClearView, ground: VisibleGround) -> PlanarReflection:
        """Render the reflection of the environment in the ground's plane."""
        ...


# Scene environment: the scene rendered from below the ground

MIRROR_SCALE = 0.5
"""Resolution of the mirror image relative to the view's; water on a road is never smooth enough for more."""
_SOLID = 0.5  # least opacity of Gaussians used to find the ground
_FLAT, _MIN_FLAT = 0.5, 0.02
"""Largest height-to-width ratio of a flat Gaussian, and least share of flat ones to find the ground by them alone."""
_MAX_SCENE_POINTS = 400_000
_BAND_M = 0.3
_UPON_M = 0.03  # gaussians of any shape up to this height over the ground count as ground
_THICKNESS_M = 0.15  # flat Gaussians up to this height over the ground count as ground
_BANK_M = 0.3  # ground higher than this over the mirror plane is a bank, which the road reflects


class SceneEnvironment:
    """Environment of a scene's views: a mirrored camera renders the scene, also beyond the view's border."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.ground = lru_cache(maxsize=2)(self._ground)

    def _ground(self, view: ClearView) -> VisibleGround | None:
        if self._plane is None or self.heights is None:
            return None
        return find_visible_ground(view, self.heights, self._plane)

    def mirrored(self, view: ClearView, ground: VisibleGround) -> PlanarReflection:
        """Use screen-space reflection where it hits, and elsewhere render the scene for the mirrored camera.

        The rendering leaves out the ground, which would block that camera. Screen-space reflection looks better than
        captured Gaussians from below, where no camera has been.
        """
        camera = mirror_camera(view.camera, ground.plane, MIRROR_SCALE)
        placed = PlacedCamera(f"{view.name} mirrored", camera, view.time_s, view.sensor)
        beyond = fill_reflection_holes(scene_view(self._above(ground.plane), placed), ground.plane)
        hits = screen_space_reflection(view, ground, camera)
        known = hits.found.astype(np.float32)
        return PlanarReflection(beyond, hits.places, known, np.where(hits.found, hits.depth, beyond.depth))

    @cached_property
    def layers(self) -> list["LayerSurfaces"]:
        """Visible layers, without actors and sky."""
        layers = [layer for layer in self._scene.layers if layer.visible and layer.kind != "sky"]
        return [_layer_surfaces(self._scene, layer) for layer in layers]

    @cached_property
    def _points(self) -> Float64[np.ndarray, "n 3"]:
        """World centers of solid, flat Gaussians; of all solid ones if hardly any are flat."""
        solid = np.concatenate([np.zeros((0, 3)), *(each.points[each.solid] for each in self.layers)])
        flat = np.concatenate([np.zeros((0, 3)), *(each.points[each.solid & each.flat] for each in self.layers)])
        points = flat if len(flat) > _MIN_FLAT * len(solid) else solid
        return points[:: max(1, len(points) // _MAX_SCENE_POINTS)]

    @cached_property
    def _plane(self) -> GroundPlane | None:
        """Approximate plane of the ground, from which its heights are fitted."""
        if len(self._points) < 3:
            return None
        if self._scene.ground_m is not None:
            return GroundPlane(np.array([0.0, 0.0, 1.0]), self._scene.ground_m)
        return fit_ground_plane(self._points, _BAND_M)

    @cached_property
    def heights(self) -> GroundHeights | None:
        """Heights of the ground; None without ground."""
        if self._plane is None:
            return None
        found = ground_heights(self._points, self._plane)
        ego, to_world = self._scene.ego, self._scene.scene_to_world
        if ego is None or np.count_nonzero(ego.valid) < 2:
            return found
        return found.with_ruts((ego.positions[ego.valid] @ to_world[:3, :3].T + to_world[:3, 3])[:, :2])

    @cached_property
    def _lying(self) -> list[Bool[np.ndarray, " n"]]:
        """Mask of each layer's Gaussians that lie on the ground."""
        assert self.heights is not None
        over = [each.points[:, 2] - self.heights.sampled(self.heights.fine_m, each.points) for each in self.layers]
        return [
            (above < _UPON_M) | ((above < _THICKNESS_M) & each.flat)
            for above, each in zip(over, self.layers, strict=True)
        ]

    def _above(self, plane: GroundPlane) -> Scene:
        """Return the scene without its ground and without Gaussians below the mirror plane."""
        scene = self._scene
        for each, lying in zip(self.layers, self._lying, strict=True):
            over = plane.heights(each.points)
            ground = BitMask.of((over < _UPON_M) | (lying & (over < _BANK_M)))
            hidden = ground if each.marks.hidden is None else each.marks.hidden | ground
            scene = scene.with_member(each.key, marks=replace(each.marks, hidden=hidden))
        return scene


class LayerSurfaces(NamedTuple):
    """Geometry of a layer's Gaussians."""

    key: str
    marks: SelectionFlags
    points: Float64[np.ndarray, "n 3"]
    """Centers in the world."""
    solid: Bool[np.ndarray, " n"]
    flat: Bool[np.ndarray, " n"]
    """Mask of Gaussians that are wider than high."""


def _layer_surfaces(scene: Scene, layer: Layer) -> LayerSurfaces:
    part = scene.part(layer)
    assert part is not None  # layers exist at all times
    g, to_world = part.gaussians, part.to_world
    points = g.means @ to_world[:3, :3].T + to_world[:3, 3]
    solid = (g.opacities * part.opacity > _SOLID) & np.isfinite(points).all(axis=1)
    if part.left_out is not None:
        solid &= ~part.left_out.flags
    turn = to_world[:3, :3] @ matrices_from_quaternions(g.quaternions.astype(np.float64))
    sizes = np.sum((turn * g.scales[:, None, :]) ** 2, axis=2)
    flat = sizes[:, 2] < _FLAT**2 * sizes[:, :2].max(axis=1)
    return LayerSurfaces(layer.key, layer.marks, points, solid, flat)


# Image environment: the view's own image and depth, for views without a scene

_MIN_UP = 0.7
_FARTHEST_M = 60.0
_MAX_IMAGE_POINTS = 60_000
_IMAGE_BAND_M = 0.1
_UPRIGHT = 0.5
"""Cosine between the image's down and the world's below which no ground is searched: images are upright, so the
world's up is wrong then, and its ground may be a wall."""
_FADE = 0.25  # angle in radians over which objects at the image's border are extended beyond it


class ImageEnvironment:
    """Environment of images with depth: each view reflects its own content, and the sky beyond it.

    The ground is fitted to the view's own depth and evened out, since other views would find different dips.
    """

    def __init__(self) -> None:
        self.ground = lru_cache(maxsize=2)(_ground)

    def mirrored(self, view: ClearView, ground: VisibleGround) -> PlanarReflection:
        """Trace mirrored rays through the view's depth.

        Where rays leave the image, objects at its border are extended a little, so that they don't end abruptly.
        """
        camera = mirror_camera(view.camera, ground.plane, MIRROR_SCALE)
        hits = screen_space_reflection(view, ground, camera)
        size = (camera.height, camera.width)
        sky, nothing = np.ones(size, np.float32), np.zeros(size, np.float32)
        weights = view.sky[..., None] + np.float32(1e-3)
        mean_sky = (np.sum(weights * view.image, axis=(0, 1)) / weights.sum()).astype(np.float32)
        beyond = ClearView(
            f"{view.name} mirrored", camera, view.time_s, np.broadcast_to(mean_sky, (*size, 3)).copy(), nothing,
            np.zeros((*size, 3), np.float32), sky, nothing, view.sensor,
        )  # fmt: skip
        columns, rows = (np.clip(hits.places[..., k].astype(int), 0, view.depth.shape[1 - k] - 1) for k in (0, 1))
        # The object at the border where a ray leaves fades out within an angle of `_FADE`.
        rays, at_edge = view_rays(camera), view_rays(view.camera)[rows, columns]
        cosine = np.sum(rays * at_edge, axis=-1) / (np.linalg.norm(rays, axis=-1) * np.linalg.norm(at_edge, axis=-1))
        near_edge = 1 - smoothstep(0.0, _FADE, np.arccos(np.clip(cosine, -1, 1)))
        extended = np.where(hits.left, 1 - view.sky[rows, columns], 0) * near_edge
        hits = hits.with_hidden_filled()
        known = np.where(hits.found, 1, extended).astype(np.float32)
        depth = np.where(hits.found, hits.depth, np.where(extended > 0.5, view.depth[rows, columns], 0))
        return PlanarReflection(beyond, hits.places, known, depth.astype(np.float32))


def _ground(view: ClearView) -> VisibleGround | None:
    if view.camera.world_to_camera[1, 2] > -_UPRIGHT:
        return None
    level = (view.normals[..., 2] > _MIN_UP) & (view.depth > 0) & (view.depth < _FARTHEST_M) & (view.vehicles < 0.5)
    points = world_points(view.depth, view.camera)[level]
    points = points[points[:, 2] < view.camera.position[2]]
    points = points[:: max(1, len(points) // _MAX_IMAGE_POINTS)]
    start = fit_ground_plane(points, _IMAGE_BAND_M)
    if start is None:
        return None
    found = find_visible_ground(view, ground_heights(points, start), start)
    return None if found is None else replace(found, sunk_m=np.zeros_like(found.sunk_m))
