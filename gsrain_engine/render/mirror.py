"""Mirror of a scene's wet ground: draws what it reflects, and prepares the items that reflect."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import msgspec
import numpy as np
from jaxtyping import Bool

from ..rain.frame import RainFrame
from ..rain.settings import RainSettings
from ..rain.simulation import RainSimulation
from ..scene.camera import Camera
from ..scene.flags import BitMask
from ..scene.gaussians import SH_C0, Gaussians, IdentityKey, scene_cache
from ..scene.geometry import srgb_to_linear
from ..scene.ground_water import GroundMembership, ground_membership, matte_wet_sh
from ..scene.lamps import LitLamps
from ..scene.lod_order import lod_sample
from ..scene.scene import DrawItem, Scene
from ..water.films import WaterDepth, WaterFilms
from ..water.impacts import GroundImpacts
from ..water.leveled_ground import LeveledView, leveled_item, leveled_lamps, leveled_view
from ..water.mirror import Mirror, make_mirror, mirrored_camera, rows_of_ground
from ..water.rings import RingWaves
from .renderer import Color, Renderer

_MIN_HEIGHT_M = 0.05  # of a camera over the ground
SHARE, FAST_SHARE = 0.35, 0.12
"""Shares of the Gaussians of a member in the mirror image, which has an eighth of the picture's resolution: of pictures
that are exact, and of fast ones."""
_FEW = 20_000  # Gaussians of a member that is reflected whole


def mirror_view(scene: Scene, camera: Camera) -> LeveledView:
    """Camera over the level ground that reflects a scene into it."""
    return leveled_view(camera, scene.water, scene.ground_m or 0.0)


def has_mirror(scene: Scene, view: LeveledView, wetness: float, standing: tuple[float, float]) -> bool:
    """Return whether wet ground reflects the scene into a camera: the scene has a map of its water, and it is wet.

    `standing` is the `standing_water` of that time.
    """
    if scene.water is None or (wetness <= 0 and min(standing) <= 0):
        return False
    first, last = rows_of_ground(view.camera)
    return last > first and bool(view.camera.position[2] > view.ground_m + _MIN_HEIGHT_M)


def standing_water(rain: RainSettings, depth: WaterDepth, wetness: float) -> tuple[float, float]:
    """Share of the area of dips that is under water, and how wet it is: as wet as can be, or as is set by hand."""
    return depth.filled, 1.0 if rain.wetness is None else wetness


def ring_waves(
    scene: Scene, rainfall: RainSimulation, view: LeveledView, time_s: float, focal_px: float | None
) -> RingWaves | None:
    """Rings of drops that land before a camera; None where there are none."""
    if not rainfall.rain.splashes or scene.water is None:
        return None
    camera = view.camera
    ahead, focal = camera.world_to_camera[2, :2], focal_px or float(np.sqrt(camera.fx * camera.fy))
    length = float(np.hypot(*ahead))
    heading = ahead / length if length > 1e-6 else np.array([1.0, 0.0])
    depth = WaterFilms.of(rainfall, scene.water).at(time_s)
    impacts = GroundImpacts(rainfall)
    return RingWaves(impacts, time_s, depth, scene.water, camera.position, heading, view.ground_m, focal)


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


class MirrorReuse:
    """Uses a mirror image for several pictures of one view, for pictures that must be fast rather than exact."""

    def __init__(self, pictures: int) -> None:
        """Draw it for one picture of so many."""
        self._pictures, self._left = pictures, 0
        self._key: object = None
        self._mirror: Mirror | None = None

    def mirror(self, scene: Scene, view: LeveledView, draw: Callable[[], Mirror]) -> Mirror:
        """Return the last mirror image, or draw one: at every so many pictures, and for another size or horizon."""
        camera = view.camera
        key = scene.geometry_key, camera.width, camera.height, rows_of_ground(camera)
        if self._mirror is None or self._left <= 0 or key != self._key:
            self._mirror, self._left, self._key = draw(), self._pictures, key
        self._left -= 1
        return self._mirror


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


# Visible shares of films and standing water, drawn as colors


def film_items(items: Sequence[DrawItem]) -> list[DrawItem]:
    """Items whose colors are their shares of films (red) and standing water (green), for renderers without channels."""
    return [
        item._replace(
            gaussians=_film_colored(item.gaussians, IdentityKey(item.film)), wet_sh=None, selected=None, colors=None
        )
        for item in items
    ]


@scene_cache(maxsize=64)
def _film_colored(gaussians: Gaussians, film: IdentityKey) -> Gaussians:
    shares: np.ndarray | None = film.of  # pyright: ignore[reportAssignmentType]
    color = np.zeros((len(gaussians), 1, 3), np.float32)
    if shares is not None:
        color[:, 0, :2] = shares
    return gaussians.with_sh((color - np.float32(0.5)) / np.float32(SH_C0))
