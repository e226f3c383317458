"""Clear views of a scene, drawn on the processor: colour with what is known about each pixel."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32

from gsrain_engine.raster.view_weights import expected, view_weights
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.members import Actor, Layer, Part
from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.vehicle_classes import is_vehicle

from ..clear_view import ClearView
from ..normals.from_depth import normals_from_depth, view_rays
from .kept_views import KeptViews
from .placed_camera import PlacedCamera

_SOLID = 0.3
"""Share of a pixel that must not be sky for its depth to be told."""
_THERE = (0.1, 0.3)
"""Alpha below which a pixel shows nothing of the scene, and from which it shows it whole."""
_SHADOW_M = 0.08
"""What of a vehicle lies so low is its shadow on the road."""
_OPEN_SKY = np.array([0.72, 0.80, 0.90], np.float32)
"""Display colour of the sky where a scene has none: that of its drops is chosen elsewhere, this one is only seen."""


def scene_views(scene: Scene, placed: Sequence[PlacedCamera], width_px: int | None = None) -> Sequence[ClearView]:
    """Views of a scene from cameras in the world, each drawn when it is asked for; the last few are kept.

    Colours are clear, and without grading, which comes on top of the colours that are solved for later. Where nothing
    of the scene is, above the horizon, there is sky if the scene has no sky of its own.
    """
    at_width = [each.at_width(width_px) for each in placed]
    return KeptViews(len(at_width), lambda i: scene_view(scene, at_width[i]))


def scene_view(scene: Scene, placed: PlacedCamera) -> ClearView:
    camera, shown = placed.camera, _shown(scene, placed.time_s)
    view = view_weights(shown.parts, camera)
    own, colors = view.splats.indices, view.splats.colors
    sky, vehicle = shown.is_sky[own].astype(np.float32), shown.is_vehicle[own].astype(np.float32)
    painted = view.blend(np.concatenate([colors[:, :3], ((1 - sky) * colors[:, 3])[:, None]], axis=1))
    kinds = view.blend(np.stack([1 - sky, sky, vehicle], axis=1))
    solid, alpha = np.ascontiguousarray(kinds[..., 0]), kinds[..., 0] + kinds[..., 1]
    depth = expected(np.ascontiguousarray(painted[..., 3]), solid)
    depth[solid <= _SOLID * alpha] = 0
    image = np.stack([expected(np.ascontiguousarray(painted[..., c]), alpha) for c in range(3)], axis=-1)
    sky_share, vehicles = (expected(np.ascontiguousarray(kinds[..., k]), alpha) for k in (1, 2))
    if not shown.has_sky:
        image, sky_share, depth = _under_open_sky(image, alpha, depth, camera)
    return ClearView(
        placed.name, camera, placed.time_s, np.clip(image, 0, 1), depth, normals_from_depth(depth, camera),
        np.clip(sky_share, 0, 1), np.clip(vehicles, 0, 1), placed.sensor,
    )  # fmt: skip


class _Shown(NamedTuple):
    """What can be seen at a time, and what kind of thing each Gaussian of it is."""

    parts: list[Part]
    is_sky: Bool[np.ndarray, " n"]
    is_vehicle: Bool[np.ndarray, " n"]
    has_sky: bool


def _shown(scene: Scene, time_s: float) -> _Shown:
    parts: list[Part] = []
    sky, vehicle = [np.zeros(0, np.bool_)], [np.zeros(0, np.bool_)]
    for member in scene.members:
        part = scene.part(member, time_s) if member.visible else None
        if part is not None:
            parts.append(part._replace(colors=None))
            sky.append(np.full(len(member.gaussians), isinstance(member, Layer) and member.kind == "sky"))
            vehicle.append(_is_body(member, scene.metres_per_unit))
    is_sky = np.concatenate(sky)
    return _Shown(parts, is_sky, np.concatenate(vehicle), bool(is_sky.any()))


def _is_body(member: Layer | Actor, metres_per_unit: float) -> Bool[np.ndarray, " n"]:
    """Which of a member's Gaussians are a vehicle's."""
    if isinstance(member, Layer) or not is_vehicle(member.class_name):
        return np.zeros(len(member.gaussians), np.bool_)
    return np.asarray(member.gaussians.means[:, 2] * metres_per_unit > _SHADOW_M)


def _under_open_sky(
    image: Float32[np.ndarray, "h w 3"],
    alpha: Float32[np.ndarray, "h w"],
    depth: Float32[np.ndarray, "h w"],
    camera: Camera,
) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Put a sky where nothing is above the horizon, and nothing where nothing is below it.

    A pixel that shows the scene in part shows it whole: colours are solved for from what it shows there, which may not
    have the sky in it.
    """
    low, high = _THERE
    t = np.clip((alpha - low) / (high - low), 0, 1)
    there = t * t * (3 - 2 * t)
    rises = view_rays(camera)[..., 2] > 0
    sky = np.where(rises, 1 - there, 0).astype(np.float32)
    shown = image * there[..., None] + _OPEN_SKY * sky[..., None]
    return shown, sky, np.where(there > 0.5, depth, np.float32(0))
