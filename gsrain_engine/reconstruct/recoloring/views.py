"""Views that a scene is recoloured to: what each shows of the scene now, and what it ought to show."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int64

from gsrain_engine.appearance.normals.from_depth import normals_from_depth
from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.prepared import prepared
from gsrain_engine.raster.projection import view_directions
from gsrain_engine.raster.spherical_harmonics import harmonics
from gsrain_engine.raster.view_weights import expected, view_weights
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene

from .ground_share import ground_share
from .scene_members import Member, VisibleMembers, visible_members, world_heights
from .weights import StoredWeights, WalkedWeights, weights_of

_UNSEEN_WEIGHT_PX = 0.5
"""A Gaussian seen with less than this in all counts as ground or not by its height rather than by the views."""
_GROUND_HEIGHT_M = 0.3
_SOLID = 0.3
"""Share of a pixel that must not be sky for its depth to be told."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetView:
    """A picture that the scene ought to look like."""

    name: str
    camera: Camera
    """In the world (metres, z up)."""
    time_s: float
    image: Float32[np.ndarray, "h w 3"]
    """Display colour."""
    mask: Bool[np.ndarray, "h w"] | None = None
    """Which pixels count; None means all."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenView:
    """One view of the scene: what it is made of, and how it looks when clear."""

    target: TargetView
    visible: VisibleMembers
    weights: StoredWeights | WalkedWeights
    splats: Int64[np.ndarray, " m"]
    """Index of each splat that has weight, counted through the visible parts."""
    clear: Float32[np.ndarray, "h w 3"]
    """Display colour, over what is there."""
    alpha: Float32[np.ndarray, "h w"]
    depth: Float32[np.ndarray, "h w"]
    """Metres along the view axis; 0 where nothing but sky is."""
    surfaces: Float32[np.ndarray, "h w 3"]
    """Shares of sky, ground and other, weighted by alpha."""

    @property
    def rows(self) -> Int64[np.ndarray, " m"]:
        """Row of each splat among the Gaussians of all members."""
        return self.visible.rows[self.splats]

    @property
    def counted(self) -> Bool[np.ndarray, "h w"]:
        """Which pixels say anything about the scene."""
        there = self.alpha > _SOLID
        return there if self.target.mask is None else there & self.target.mask

    def basis(self, k: int) -> Float32[np.ndarray, "m k"]:
        """First k harmonics that each splat is seen through; 0 beyond those that its member has."""
        basis = harmonics(view_directions(self.visible.parts, self.target.camera, self.splats), k)
        own = np.concatenate([np.full(len(m.gaussians), m.gaussians.sh.shape[1]) for m in self.visible.members])
        basis[np.arange(k) >= own[self.splats][:, None]] = 0
        return basis


def target_views(scene: Scene, capture: Capture, width_px: int) -> Iterator[TargetView]:
    """Read a capture's pictures, straightened and at most so many pixels wide, one by one.

    Its cameras are in the scene's own units and axes. Raises `CaptureError` for a picture that can't be read.
    """
    for view in capture:
        ready = prepared(view, min(width_px, view.camera.width))
        image = ready.image.astype(np.float32) / np.float32(255)
        yield TargetView(view.name, ready.camera.moved(scene.scene_to_world), view.time_s, image, ready.mask)


def seen_view(
    scene: Scene, members: list[Member], target: TargetView, ground_m: float, most_bytes: float = np.inf
) -> SeenView:
    """Look at the scene as it is from where a picture was taken; weights are stored if they fit into `most_bytes`."""
    visible = visible_members(scene, members, target.time_s)
    view = view_weights(visible.parts, target.camera)
    weights = weights_of(view, most_bytes)
    splats = view.splats.indices[weights.rows]
    colors = view.splats.colors[weights.rows]
    is_sky = visible.is_sky[splats].astype(np.float32)
    premultiplied = weights.blend(np.ascontiguousarray(colors[:, :3]))
    geometry = weights.blend(np.stack([1 - is_sky, is_sky, (1 - is_sky) * colors[:, 3]], axis=1))
    solid, alpha = geometry[..., 0], geometry[..., 0] + geometry[..., 1]
    clear = np.stack([expected(np.ascontiguousarray(premultiplied[..., c]), alpha) for c in range(3)], axis=-1)
    depth = expected(np.ascontiguousarray(geometry[..., 2]), np.ascontiguousarray(solid))
    depth[solid <= _SOLID * alpha] = 0
    sky = expected(np.ascontiguousarray(geometry[..., 1]), alpha)
    ground = ground_share(depth, upness(depth, target.camera), target.camera, ground_m) * (1 - sky)
    surfaces = alpha[..., None] * np.stack([sky, ground, 1 - sky - ground], axis=-1)
    return SeenView(target, visible, weights, splats, clear, alpha, depth, surfaces)


def upness(depth: Float32[np.ndarray, "h w"], camera: Camera) -> Float32[np.ndarray, "h w"]:
    """World-up component of surface normals that depth tells."""
    return np.ascontiguousarray(normals_from_depth(depth, camera)[..., 2])


def surface_shares(
    scene: Scene, members: Sequence[Member], views: Sequence[SeenView], ground_m: float
) -> list[Float32[np.ndarray, "_ 3"]]:
    """What kind of surface each Gaussian is: as the views show it, and by its height where they hardly do."""
    seen = np.zeros((sum(len(member.gaussians) for member in members), 3), np.float32)
    for view in views:
        seen[view.rows] += view.weights.accumulate(view.surfaces)
    shares: list[Float32[np.ndarray, "_ 3"]] = []
    for member in members:
        guess = np.zeros((len(member.gaussians), 3), np.float32)
        if member.is_sky:
            guess[:, 0] = 1
        else:
            level = ground_m if member.key.startswith("layers/") else -np.inf
            is_low = np.abs(world_heights(scene, member) - level) < _GROUND_HEIGHT_M
            guess[:, 1], guess[:, 2] = is_low, ~is_low
        mixed = (_UNSEEN_WEIGHT_PX * guess + seen[member.rows]) if not member.is_sky else guess
        shares.append(mixed / mixed.sum(axis=1, keepdims=True))
    return shares
