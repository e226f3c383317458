"""Mirror: what wet ground reflects of the scene, and the items that reflect."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import msgspec
import numpy as np
from jaxtyping import Bool

from ...rain.frame import RainFrame
from ...scene.camera import Camera
from ...scene.flags import BitMask
from ...scene.gaussians import Gaussians, IdentityKey, scene_cache
from ...scene.geometry import srgb_to_linear
from ...scene.ground_water import GroundMembership, ground_membership, matte_wet_sh
from ...scene.lamps import LitLamps
from ...scene.lens_faces import wide_face
from ...scene.lod_order import lod_sample
from ...scene.scene import DrawItem, Scene
from ...water.films import flooded_share
from ...water.leveled_ground import LeveledView, leveled_item, leveled_lamps
from ...water.mirror import LensMirror, Mirror, make_mirror, mirrored_camera
from ...water.rings import RingWaves
from ..frame_input import FrameInput
from ..level_of_detail import LodCut, subset_items
from ..renderer import Color, Renderer
from .base import Factor, FrameParts

SHARE, FAST_SHARE = 0.2, 0.12
"""Shares of the Gaussians of a member in the mirror image, which has an eighth of the picture's resolution: of pictures
that are exact, and of fast ones."""
_COARSER = 2.0
"""Error of the cut of a large scene in the mirror image, relative to the picture's, which is not blurred by waves."""
_FEW = 20_000  # Gaussians of a member that is reflected whole


class MirrorPass:
    """Mirror image of the scene in films and standing water, in scenes with a map of that water."""

    name = "mirror"
    factor = Factor(name, "mirror", {"mirror": False}, {"mirror": True}, needs_wet_ground=True)

    def active(self, frame: FrameInput) -> bool:
        return frame.reflecting_ground is not None

    def add(self, frame: FrameInput, parts: FrameParts) -> None:
        ground, quality, scene, camera = frame.reflecting_ground, frame.quality, frame.scene, frame.view.camera
        assert ground is not None
        parts.items = reflecting_items(parts.items, scene)
        fewer = quality.reflected or quality.thinning
        if quality.reflected is None and isinstance(fewer, LodCut):  # the ground is left out, and hides nothing
            fewer = replace(fewer, pixel=_COARSER * fewer.pixel, occlusion=False)
        water = frame.wetness, flooded_share(ground.depth.film_mm), frame.light.drops
        share = SHARE if parts.still is None else FAST_SHARE
        reflect = partial(
            draw_mirror, parts.renderer, scene, partial(subset_items, parts.whole, fewer), frame.falling, ground.view,
            *water, frame.lit_lamps, ground.standing, parts.waves, share,
        )  # fmt: skip
        if parts.still is not None:
            state = *water, ground.standing
            parts.mirror = parts.still.mirror(ground.view, parts.moving, state, reflect, parts.waves)
            return
        plane = reflect() if quality.reuse is None else quality.reuse.mirror(scene, ground.view, reflect)
        parts.mirror = plane if camera.lens is None else LensMirror(plane, wide_face(camera))


def reflecting_items(items: Sequence[DrawItem], scene: Scene) -> list[DrawItem]:
    """Items with the film on their Gaussians, and without reflections in their wet colors."""
    assert scene.water is not None
    of_capture, reflecting = scene.water.heights_m is not None, list[DrawItem]()
    for item in items:
        film, wet_sh = _member_of(item, scene).film, item.wet_sh
        if film is not None:
            matte = None if wet_sh is None else matte_wet_sh(wet_sh, film, item.to_world, of_capture=of_capture)
            item = item._replace(film=film, wet_sh=matte)
        reflecting.append(item)
    return reflecting


def reflected_item(item: DrawItem, scene: Scene, share: float = SHARE) -> DrawItem:
    """Item as mirrors show it: without the ground, and a share of the Gaussians of a large one, enlarged."""
    return _without_ground(item, _member_of(item, scene), share)


def _member_of(item: DrawItem, scene: Scene) -> GroundMembership:
    assert scene.water is not None
    fixed = _is_fixed(item, scene)
    return ground_membership(item.gaussians, item.to_world, scene.ground_m or 0.0, scene.water, is_fixed=fixed)


def _is_fixed(item: DrawItem, scene: Scene) -> bool:
    """Return whether an item belongs to a layer, by its pose; on level ground all do, as it makes no difference."""
    if scene.water is None or scene.water.heights_m is None:
        return True
    return any(np.array_equal(item.to_world, scene.scene_to_world @ layer.to_scene) for layer in scene.layers)


def draw_mirror(
    renderer: Renderer,
    scene: Scene,
    items_for: Callable[[Camera], Sequence[DrawItem]],
    rain: RainFrame | None,
    view: LeveledView,
    wetness: float,
    flooded: float,
    sky: Color,
    lamps: LitLamps | None,
    standing: tuple[float, float] | None = None,
    waves: RingWaves | None = None,
    share: float = SHARE,
) -> Mirror:
    """Draw the mirror image of a `mirror_view` by the renderer, over the color of the sky, and blur it.

    `items_for` returns the scene for the mirrored camera, and `share` of the Gaussians of its large members are drawn.
    Drops of the rain are left out, and its medium is that of the whole way from the reflected object over the ground to
    the eye.
    """
    assert scene.water is not None
    below = mirrored_camera(view.camera, view.ground_m)
    medium = None
    if rain is not None:
        far = rain.rain.haze if rain.rain.haze == "medium" else "none"
        settings = msgspec.structs.replace(rain.rain, streaks=False, haze=far)
        anchor = rain.view.anchor_to_world if view.to_level is None else view.to_level @ rain.view.anchor_to_world
        rain = replace(rain, rain=settings, view=replace(rain.view, camera=below, anchor_to_world=anchor, floor_m=None))
        medium = rain.medium
    # Wet colors of what reflects, too, though it is left out: the same arrays as for the picture itself.
    items = [
        leveled_item(reflected_item(item, scene, share), view, scene.water, is_fixed=_is_fixed(item, scene))
        for item in reflecting_items(items_for(below), scene)
    ]
    renderer.draw(items, below, rain if medium is not None else None, with_depth=True)
    frame = renderer.read()
    assert frame.depth is not None
    image = srgb_to_linear(np.maximum(frame.over(sky), 0)).astype(np.float32)
    extinction_per_m = 0.0 if medium is None else medium.extinction_per_m
    return make_mirror(
        image, frame.depth, view.camera, view.ground_m, wetness, flooded, leveled_lamps(lamps, view), extinction_per_m,
        standing, waves,
    )  # fmt: skip


def _without_ground(item: DrawItem, found: GroundMembership, share: float) -> DrawItem:
    """Leave out an item's Gaussians on the ground or under it, and all but a share of a large one that is in full."""
    if item.members is not None:
        return item._replace(members=item.members[~found.is_low[item.members]])
    share = share if item.limit is None and len(item.gaussians) >= _FEW else 1.0
    left_out, growth = _left_out(item.gaussians, IdentityKey(found.is_low), share)
    if item.left_out is not None:
        left_out = item.left_out if left_out is None else item.left_out | left_out
    return item._replace(left_out=left_out, growth=item.growth * growth)


@scene_cache(maxsize=64)
def _left_out(gaussians: Gaussians, key: IdentityKey, share: float) -> tuple[BitMask | None, float]:
    """Mask of the Gaussians on the ground and of those outside of a sample, and the growth of the others."""
    low: np.ndarray = key.of  # pyright: ignore[reportAssignmentType]
    if share >= 1:
        return (BitMask.of(low) if low.any() else None), 1.0
    sampled, growth = _sample(gaussians, share)
    return BitMask.of(low | ~sampled), growth


@scene_cache(maxsize=64)
def _sample(gaussians: Gaussians, share: float) -> tuple[Bool[np.ndarray, " n"], float]:
    return lod_sample(gaussians, share)
