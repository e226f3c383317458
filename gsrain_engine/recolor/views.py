"""Views for recoloring: target images, observations of the scene, exposure maps, and ground detection."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from ..appearance.normals import normals_from_depth, world_points
from ..datasets.capture import Capture
from ..datasets.undistort import undistort_frame
from ..fast_math import harmonics
from ..render.cpu.compositing import color_operator, expected
from ..render.cpu.projection import view_directions
from ..scene.camera import Camera
from ..scene.scene import Scene
from .result import RecolorMember, VisibleMembers, scene_members, visible_members, world_heights
from .weights import LazyWeights, Picture, Plane, StoredWeights, weights_of

_UNSEEN_WEIGHT_PX = 0.5
"""Total weight in pixels below which a Gaussian's surface kind follows from its height instead of the views."""

_GROUND_HEIGHT_M = 0.3
_SOLID = 0.3  # share of a pixel that must not be sky for its depth to be valid


@dataclass(frozen=True, slots=True, eq=False)
class TargetView:
    """A target image for the scene."""

    name: str
    camera: Camera
    """In the world (meters, z up)."""
    time_s: float
    image: Picture
    """Display color."""
    mask: Bool[np.ndarray, "h w"] | None = None
    """Mask of valid pixels; None means all."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewObservation:
    """One view of the scene: its splats, weights and clear appearance."""

    target: TargetView
    visible: VisibleMembers
    weights: StoredWeights | LazyWeights
    splats: Int64[np.ndarray, " m"]
    """Index of each splat with nonzero weight, consecutive over the visible parts."""
    clear: Picture
    """Display color, divided by alpha."""
    alpha: Plane
    depth: Plane
    """Meters along the view axis; 0 where only sky is visible."""
    surfaces: Picture
    """Shares of sky, ground and other, weighted by alpha."""

    @property
    def rows(self) -> Int64[np.ndarray, " m"]:
        """Row of each splat among the Gaussians of all members."""
        return self.visible.rows[self.splats]

    @property
    def counted(self) -> Bool[np.ndarray, "h w"]:
        """Mask of the pixels that show the scene."""
        there = self.alpha > _SOLID
        return there if self.target.mask is None else there & self.target.mask

    def basis(self, k: int) -> Float32[np.ndarray, "m k"]:
        """First k harmonics in each splat's view direction; 0 above its member's degree."""
        basis = harmonics(view_directions(self.visible.parts, self.target.camera, self.splats), k)
        own = np.concatenate([np.full(len(m.gaussians), m.gaussians.sh.shape[1]) for m in self.visible.members])
        basis[np.arange(k) >= own[self.splats][:, None]] = 0
        return basis


def target_views(scene: Scene, capture: Capture, width_px: int) -> Iterator[TargetView]:
    """Yield a capture's images one by one, undistorted and at most `width_px` wide.

    Its cameras are in the scene's own units and axes. Raises `CaptureError` for an unreadable image.
    """
    for view in capture:
        ready = undistort_frame(view, min(width_px, view.camera.width))
        image = ready.image.astype(np.float32) / np.float32(255)
        yield TargetView(view.name, ready.camera.moved(scene.scene_to_world), view.time_s, image, ready.mask)


def observe_view(
    scene: Scene, members: list[RecolorMember], target: TargetView, ground_m: float, max_bytes: float = np.inf
) -> ViewObservation:
    """Render the current scene from a target's camera; weights are stored if they fit into `max_bytes`."""
    visible = visible_members(scene, members, target.time_s)
    view = color_operator(visible.parts, target.camera)
    weights = weights_of(view, max_bytes)
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
    ground = ground_share(
        depth, np.ascontiguousarray(normals_from_depth(depth, target.camera)[..., 2]), target.camera, ground_m
    ) * (1 - sky)
    surfaces = alpha[..., None] * np.stack([sky, ground, 1 - sky - ground], axis=-1)
    return ViewObservation(target, visible, weights, splats, clear, alpha, depth, surfaces)


def surface_shares(
    scene: Scene, members: Sequence[RecolorMember], views: Sequence[ViewObservation], ground_m: float
) -> list[Float32[np.ndarray, "_ 3"]]:
    """Surface kind of each Gaussian: from the views, or from its height if hardly visible."""
    sums = np.zeros((sum(len(member.gaussians) for member in members), 3), np.float32)
    for view in views:
        sums[view.rows] += view.weights.accumulate(view.surfaces)
    shares: list[Float32[np.ndarray, "_ 3"]] = []
    for member in members:
        guess = np.zeros((len(member.gaussians), 3), np.float32)
        if member.is_sky:
            guess[:, 0] = 1
        else:
            level = ground_m if member.key.startswith("layers/") else -np.inf
            is_low = np.abs(world_heights(scene, member) - level) < _GROUND_HEIGHT_M
            guess[:, 1], guess[:, 2] = is_low, ~is_low
        mixed = (_UNSEEN_WEIGHT_PX * guess + sums[member.rows]) if not member.is_sky else guess
        shares.append(mixed / mixed.sum(axis=1, keepdims=True))
    return shares


# Exposure and white balance
# Affine color map per view, with their median fixed.

PRIOR_WEIGHT = 1e-3  # tikhonov weight toward the identity, in squared color, for images without contrast
SWEEPS = 6  # rounds over all views; each uses the other views' latest maps
_MIN_PX = 1.0  # minimum weight in pixels, in a view and in all others together, of a Gaussian that constrains exposures
_MIDDLE = 0.5
_GAIN_LIMITS = 0.2, 5.0  # bounds that keep a map invertible: a black image has no gain


@dataclass(frozen=True, slots=True, eq=False)
class ViewAffine:
    """Per-channel map in display color: image = gains * (scene color - 1/2) + 1/2 + offsets."""

    gains: Float64[np.ndarray, "3"]
    offsets: Float64[np.ndarray, "3"]

    def undone(self, picture: Float32[np.ndarray, "*p 3"]) -> Float32[np.ndarray, "*p 3"]:
        shift = _MIDDLE - (self.offsets + _MIDDLE) / self.gains
        return picture * (1 / self.gains).astype(np.float32) + shift.astype(np.float32)


NO_CHANGE = ViewAffine(np.ones(3), np.zeros(3))


def view_affines(
    colors: Sequence[Float32[np.ndarray, "_ 3"]],
    evidence: Sequence[Float32[np.ndarray, " _"]],
    indices: Sequence[Int64[np.ndarray, " _"]],
    count: int,
) -> list[ViewAffine]:
    """Estimate the maps by comparing the same Gaussians across views.

    Each view's Gaussians are compared with the mean over all *other* views, weighted by visibility in both: a view
    can't agree with itself, and the colors need not be known. View-dependent color counts as noise. For each view,
    `colors` is the sum of weight * color of each splat over the image, `evidence` the sum of its weights in pixels, and
    `indices` its row among all `count` Gaussians.
    """
    chosen = [np.flatnonzero(each >= _MIN_PX) for each in evidence]
    means = [own[rows] / each[rows, None] for own, each, rows in zip(colors, evidence, chosen, strict=True)]
    amounts = [each[rows] for each, rows in zip(evidence, chosen, strict=True)]
    places = [each[rows] for each, rows in zip(indices, chosen, strict=True)]
    sums, totals = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
    for mean, amount, place in zip(means, amounts, places, strict=True):
        sums[place] += mean * amount[:, None]
        totals[place] += amount
    affines = [NO_CHANGE] * len(means)
    for _ in range(SWEEPS):
        for v, (mean, amount, place) in enumerate(zip(means, amounts, places, strict=True)):
            sums[place] -= affines[v].undone(mean) * amount[:, None]
            others = totals[place] - amount
            both = np.where(others >= _MIN_PX, amount * others / np.maximum(totals[place], _MIN_PX), 0)
            affines[v] = _fitted(sums[place] / np.maximum(others, _MIN_PX)[:, None], mean, both.astype(np.float32))
            sums[place] += affines[v].undone(mean) * amount[:, None]
    # The same change of scene colors is removed from each map, so that the median map is the identity: a darker scene
    # with brighter images would fit equally well. The median is robust against a single image of something else.
    gain = np.median([each.gains for each in affines], axis=0)
    offset = np.median([each.offsets for each in affines], axis=0)
    return [ViewAffine(each.gains / gain, each.offsets - each.gains / gain * offset) for each in affines]


def _fitted(
    scene: Float32[np.ndarray, "p 3"], picture: Float32[np.ndarray, "p 3"], trust: Float32[np.ndarray, " p"]
) -> ViewAffine:
    """Fit the map from scene colors to image colors by weighted ridge regression toward the identity."""
    x, change = scene - np.float32(_MIDDLE), picture - scene
    total = float(trust.sum(dtype=np.float64))
    ridge = PRIOR_WEIGHT * total + 1e-9
    mean, square, shift, product = (
        np.einsum("p,pc->c", trust, each, dtype=np.float64) for each in (x, x * x, change, x * change)
    )
    determinant = (square + ridge) * (total + ridge) - mean**2
    gains = 1 + ((total + ridge) * product - mean * shift) / determinant
    offsets = ((square + ridge) * shift - mean * product) / determinant
    return ViewAffine(np.clip(gains, *_GAIN_LIMITS), offsets)


# Ground height

_LOW_SHARE = 0.05  # quantile: the lowest part of a street is mostly ground, with fewer stray Gaussians below it


def ground_height_m(scene: Scene) -> float:
    """Height of the ground in the world in m: the scene's own, else a low quantile of opaque Gaussians, else 0."""
    if scene.ground_m is not None:
        return scene.ground_m
    heights = [np.zeros(0, np.float32)]
    for member in scene_members(scene):
        if member.key.startswith("layers/") and not member.is_sky:
            heights.append(world_heights(scene, member)[member.gaussians.opacities > 0.5])
    found = np.concatenate(heights)
    found = found[np.isfinite(found)]
    return float(np.quantile(found, _LOW_SHARE)) if len(found) else 0.0


# Ground pixels

_FACING_UP = (0.6, 0.9)  # upward components of normals from which surfaces may be ground, and certainly are
_BAND_M = (0.25, 0.6)  # heights above the ground up to which pixels certainly are ground, and from which they are not


def ground_share(depth: Plane, upness: Plane, camera: Camera, ground_m: float) -> Plane:
    """Share of ground in each pixel, 0 to 1.

    `depth` is along the view axis in meters, 0 where unknown; `upness` is the world-up component of the unit normal,
    -1..1. The camera is in the world (meters, z up), whose ground is at `ground_m`.
    """
    heights = world_points(depth, camera)[..., 2] - ground_m
    share = _rising(*_FACING_UP, upness.astype(np.float64)) * (1 - _rising(*_BAND_M, heights))
    return np.where(depth > 0, share, 0).astype(np.float32)


def _rising(low: float, high: float, x: Float64[np.ndarray, "h w"]) -> Float64[np.ndarray, "h w"]:
    """Rise smoothly from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


# Progress thumbnails

_WIDTH_PX = 320


def thumbnail(picture: Picture) -> UInt8[np.ndarray, "_ _ 3"]:
    """Return an image (display color) downscaled to at most 320 pixels in width."""
    shrink = min(1.0, _WIDTH_PX / picture.shape[1])
    small = cv2.resize(picture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    return np.rint(np.clip(small, 0, 1) * np.float32(255)).astype(np.uint8)
