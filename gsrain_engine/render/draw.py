"""Drawing a scene with rain for a camera and time, shared by window and command line."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from ..rain.frame import RainCamera, RainFrame, SkyLight
from ..rain.shelter_map import shelter_map_of
from ..rain.simulation import RainSimulation
from ..rain.wetness import flooded_share
from ..scene.camera import Camera
from ..scene.gaussians import Gaussians, IdentityKey, scene_cache
from ..scene.ground_water import WetGround, ground_heights
from ..scene.lens_faces import wide_face
from ..scene.lod_occlusion import OcclusionMap
from ..scene.lod_order import lod_growth, lod_sample, thinned
from ..scene.lod_tree import MIN_GAUSSIANS, PIXEL, LodTree, cut_lod_tree, merged_harmonics, occlusion_by_trees
from ..scene.scene import DrawItem, Scene, is_single_object
from ..water.films import WaterDepth, WaterFilms
from ..water.leveled_ground import leveled_view
from ..water.mirror import LensMirror
from ..water.splashes import Splashes
from ..water.spray import spray_gaussians, spray_of
from .bands import PictureBands
from .camera_response import PictureOptics
from .cpu.renderer import CpuRenderer
from .export_settings import Lod
from .lamp_reflections import lamp_reflections
from .mirror import (
    FAST_SHARE,
    SHARE,
    MirrorReuse,
    draw_mirror,
    has_mirror,
    mirror_view,
    reflecting_items,
    ring_waves,
    standing_water,
)
from .renderer import PendingImage, Renderer, RenderMode
from .still_scene import StillScene


@dataclass(frozen=True, slots=True, eq=False)
class RenderView:
    """Camera, time and motion for which a scene is drawn. World frame, meters."""

    camera: Camera
    time_s: float = 0.0
    velocity_m_s: Float64[np.ndarray, "3"] | None = None
    """Velocity of the camera; None is that of its rolling shutter, or at rest."""
    focal_px: float | None = None
    """Focal length of the output image if a smaller one is drawn; None uses the camera's."""
    exposure_share: float = 1.0
    """Fraction of the shutter time, for one of several sub-frames that share it."""


def has_spray(scene: Scene, rainfall: RainSimulation | None, time_s: float) -> bool:
    """Return whether spray floats in a scene at a time."""
    return rainfall is not None and len(spray_of(scene, rainfall, time_s)) > 0


_STEP_S = 0.005  # half the time step of the velocity estimate


def ego_view(scene: Scene, camera: Camera, time_s: float) -> RenderView:
    """View of a camera that is fixed to the scene's ego vehicle, if the vehicle is present; else it is at rest."""
    now, before, after = (scene.ego_to_world(time_s + step) for step in (0.0, -_STEP_S, _STEP_S))
    velocity_m_s = np.zeros(3)
    if now is not None and before is not None and after is not None:
        mounted = np.linalg.inv(now) @ np.append(camera.position, 1.0)
        velocity_m_s = ((after - before) @ mounted)[:3] / (2 * _STEP_S)
    return RenderView(camera, time_s, velocity_m_s)


def draw_view(
    renderer: Renderer,
    scene: Scene,
    rainfall: RainSimulation | None,
    sky: SkyLight,
    shot: RenderView,
    *,
    with_depth: bool = False,
    look: RenderMode = "splats",
    thinning: "Thinning | None" = None,
    reflected: "Thinning | None" = None,
    selection: bool = False,
    falls: bool = True,
    only_medium: bool = False,
    reuse: MirrorReuse | None = None,
    still: StillScene | None = None,
    bands: PictureBands | None = None,
) -> None:
    """Draw a scene with its rain into the renderer's image; render modes other than "splats" omit the rain.

    Wet colors follow the rain's wetness and fog, and the sky its share of clouds, also if nothing `falls`; without
    `rainfall` the scene is clear and dry. `only_medium` leaves out single drops, splashes and mirror; the medium takes
    the place of streaks. With the rain's `mirror`, water on the ground reflects the scene. `thinning` leaves out some
    of each part's Gaussians, `reflected` others in mirrors; `selection` tints selected ones; `reuse` draws fewer
    mirrors, and `still` what stands still only once, by a renderer that can; `bands` of the renderer draw and read the
    picture instead. Spray counts in depth: where `has_spray`, draw the scene's own depth without rain.
    """
    rain, wetness, soaked, overcast = None, 0.0, 0.0, 0.0
    lamps = scene.lamps if rainfall is None else rainfall.lamps_of(scene, shot.time_s)
    lit_lamps = scene.lamps_at(shot.time_s, lamps) if rainfall is not None and lamps else None
    if rainfall is not None:
        wetness, overcast = rainfall.wetness_at(shot.time_s), rainfall.overcast_at(shot.time_s)
        soaked = rainfall.soaked_share_at(shot.time_s)
        if falls and look == "splats" and not rainfall.state_at(shot.time_s).is_clear:
            rain = rainfall.frame(shot.time_s, rain_camera(scene, rainfall, shot), sky, lit_lamps)
            rain = replace(rain, rain=msgspec.structs.replace(rain.rain, streaks=False)) if only_medium else rain
    face = None if shot.camera.lens is None else wide_face(shot.camera)
    level, has_water, standing, depth = None, False, (0.0, 0.0), WaterDepth(0.0, 0.0)
    if rainfall is not None and rainfall.rain.mirror and look == "splats" and not only_medium:
        depth = WaterFilms.of(rainfall, scene.water).at(shot.time_s)
        standing = standing_water(rainfall.frozen_at(shot.time_s).rain, depth, wetness)
        level = mirror_view(scene, shot.camera.pinhole if face is None else face.of(shot.camera))
        has_water = has_mirror(scene, level, wetness, standing)
    readout_s = 0.0 if shot.camera.rolling is None else shot.camera.rolling.readout_s
    items = scene.parts(shot.time_s, selection=selection, wetness=soaked, overcast=overcast, readout_s=readout_s)
    is_plain = look == "splats" and not lamps and shot.camera.lens is None and shot.camera.rolling is None
    if not (isinstance(renderer, CpuRenderer) and is_plain) or (rain and not rain.is_linear):
        still = None
    behind, before = list[DrawItem](), items
    if still is not None:
        behind, before = still.split(scene, items, shot.camera, shot.time_s)
    parts = list(subset_items(before, thinning, shot.camera))
    if lamps and scene.ground_m is not None and look == "splats":
        fixed = scene.lamps_at(shot.time_s, [lamp for lamp in lamps if lamp.mount == "scene"])
        moving = scene.lamps_at(shot.time_s, [lamp for lamp in lamps if lamp.mount != "scene"])
        reflections = lamp_reflections(fixed, moving, shot.camera, scene.ground_m, wetness, mirrors=not has_water)
        parts += [] if reflections is None else [reflections]
    mirror = None
    if rainfall is not None and level is not None and has_water:
        parts = reflecting_items(parts, scene)
        waves = ring_waves(scene, rainfall, level, shot.time_s, shot.focal_px) if falls else None
        water = wetness, flooded_share(depth.film_mm), sky.drops
        if reflected is None:  # the ground is left out, and hides nothing
            reflected = replace(thinning, occlusion=False) if isinstance(thinning, LodCut) else thinning
        below = partial(subset_items, items, reflected)
        reflect = partial(
            draw_mirror, renderer, scene, below, rain, level, *water, lit_lamps, standing, waves,
            SHARE if still is None else FAST_SHARE,
        )  # fmt: skip
        if still is not None:
            mirror = still.mirror(level, before, (*water, standing), reflect, waves)
        else:
            plane = reflect() if reuse is None else reuse.mirror(scene, level, reflect)
            mirror = plane if face is None else LensMirror(plane, face)
    if rain is not None and rainfall is not None:
        if not only_medium and has_splashes(scene, rainfall, wetness):
            rain = replace(rain, splashes=draw_splashes(scene, rainfall, rain))
        spray = spray_of(scene, rainfall, shot.time_s)
        parts += [DrawItem(spray_gaussians(spray, rain), np.eye(4))] if len(spray) else []
    if still is not None and isinstance(renderer, CpuRenderer) and not isinstance(mirror, LensMirror):

        def behind_parts() -> Sequence[DrawItem]:
            chosen = subset_items(behind, thinning, shot.camera)
            return chosen if mirror is None else reflecting_items(chosen, scene)

        still.draw(renderer, behind, behind_parts, parts, shot.camera, rain, mirror)
    else:
        (bands or renderer).draw(parts, shot.camera, rain, with_depth=with_depth, look=look, mirror=mirror)


def has_splashes(scene: Scene, rainfall: RainSimulation, wetness: float) -> bool:
    """Return whether drops that land are drawn: on wet ground of a known height, where a scene has wet colors."""
    is_known = scene.ground_m is not None or (scene.water is not None and scene.water.heights_m is not None)
    return rainfall.rain.splashes and wetness > 0 and is_known and scene.has_rainy_light


def draw_splashes(scene: Scene, rainfall: RainSimulation, rain: RainFrame) -> Gaussians | None:
    """Splashes on a scene's ground in front of a camera; None without any."""
    heights = wet_ground(scene, leveled_view(rain.view.camera, scene.water, scene.ground_m or 0.0).ground_m)
    found = Splashes(rainfall, rain, WaterFilms.of(rainfall, scene.water), heights).gaussians()
    return found if len(found) else None


def wet_ground(scene: Scene, ground_m: float) -> WetGround:
    """Ground on which a scene's drops splash; its height is `ground_m` outside of the map of water."""
    layers = [layer for layer in scene.layers if layer.visible and layer.wet_sh is not None]
    poses = [np.ascontiguousarray(scene.scene_to_world @ layer.to_scene) for layer in layers]
    surfaces = [(layer.gaussians, pose) for layer, pose in zip(layers, poses, strict=True)]
    return ground_heights(surfaces, ground_m, scene.water)


def read_picture(renderer: Renderer, optics: PictureOptics | None) -> UInt8[np.ndarray, "h w 3"]:
    """Read the drawn frame back as display color, as the camera stores it."""
    pixels = renderer.read_uint8()
    return pixels if optics is None else optics.picture(pixels)


def request_picture(renderer: Renderer, optics: PictureOptics | None) -> PendingImage:
    """Start to read the drawn frame back as `read_picture` does, so that the next one can be drawn meanwhile."""
    pending = renderer.request_uint8()
    return pending if optics is None else lambda: optics.picture(pending())


def rain_camera(scene: Scene, rainfall: RainSimulation, shot: RenderView) -> RainCamera:
    """Camera and surroundings of the rain for a view."""
    mounted, camera, velocity = _ego_anchor(scene, rainfall, shot), shot.camera, shot.velocity_m_s
    if velocity is None:
        velocity = np.zeros(3)
        if camera.rolling is not None:
            velocity = camera.world_to_camera[:3, :3].T @ camera.rolling.velocity_m_s
    return RainCamera(
        shot.camera,
        _leveled_at(shot.camera) if mounted is None else mounted,
        velocity,
        shot.focal_px,
        shelter_map_of(scene) if rainfall.rain.roofs else None,
        shot.exposure_share,
        scene.ground_m if mounted is None else None,
        _floor_m(scene, shot.camera),
    )


def _floor_m(scene: Scene, camera: Camera) -> float | None:
    """Height of the ground below a camera, if it is known; none below a single object, since it ends soon."""
    if is_single_object(scene):
        return None
    if scene.water is None or scene.water.heights_m is None:
        return scene.ground_m
    return float(scene.water.height_at(camera.position[None, :2])[0])


def rain_anchor(scene: Scene, rainfall: RainSimulation, shot: RenderView) -> Float64[np.ndarray, "4 4"]:
    """Frame of the rain regions.

    For a camera on the ego vehicle it is the vehicle's frame, leveled, so that all cameras of a rig show the same
    drops. Any other camera carries the regions along: they are at its position and turn with its heading.
    """
    mounted = _ego_anchor(scene, rainfall, shot)
    return _leveled_at(shot.camera) if mounted is None else mounted


def _leveled_at(camera: Camera) -> Float64[np.ndarray, "4 4"]:
    return leveled_frame(camera.world_to_camera[2, :3], camera.position)


def _ego_anchor(scene: Scene, rainfall: RainSimulation, shot: RenderView) -> Float64[np.ndarray, "4 4"] | None:
    """Leveled frame of the ego vehicle if the camera is mounted on it; else None."""
    ego = scene.ego_to_world(shot.time_s)
    if ego is None:
        return None
    level = leveled_frame(ego[:3, 0], ego[:3, 3])
    local = level[:3, :3].T @ (shot.camera.position - level[:3, 3])
    region = rainfall.rain.streak_region
    return level if np.all(local >= region.minimum_m) and np.all(local <= region.maximum_m) else None


def leveled_frame(forward: Float64[np.ndarray, "3"], origin: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Frame of the rain's regions: x along a heading, z up, without tilt."""
    length = float(np.hypot(forward[0], forward[1]))
    x, y = (forward[0] / length, forward[1] / length) if length > 1e-6 else (1.0, 0.0)
    frame = np.eye(4)
    frame[:2, :2] = [[x, -y], [y, x]]
    frame[:3, 3] = origin
    return frame


# Level of detail


@runtime_checkable
class Thinning(Protocol):
    """Replacement of parts by fewer Gaussians."""

    def items(self, part: DrawItem, camera: Camera) -> Sequence[DrawItem]:
        """Items that are drawn for a part."""
        ...


def subset_items(parts: Sequence[DrawItem], thinning: Thinning | None, camera: Camera) -> Sequence[DrawItem]:
    if thinning is None:
        return parts
    if isinstance(thinning, LodCut):
        thinning = thinning.without_hidden(parts, camera)
    if isinstance(thinning, LodSample):
        return thinning.join(parts, camera)
    return [item for part in parts for item in thinning.items(part, camera)]


@dataclass(frozen=True, slots=True)
class LodCut:
    """Draws, for each part with a tree, the coarsest nodes with errors under a number of pixels.

    Parts with marked Gaussians and those without a tree are left to `others`, or drawn in full.
    """

    pixel: float = PIXEL
    others: "LodSubset | None" = None
    occlusion: bool = True
    """Leave out what is hidden behind other parts, unless some of these are left out later."""
    hidden: OcclusionMap | None = field(default=None, compare=False)
    """Occlusion map of one camera, for its images only."""

    def without_hidden(self, parts: Sequence[DrawItem], camera: Camera) -> "LodCut":
        """Cut of parts for a camera without what is hidden behind opaque ones."""
        if not self.occlusion:
            return self
        trees = [
            (tree, each.to_world)
            for each in parts
            if each.opacity >= 1 and (tree := _tree_of(each, camera)) is not None
        ]
        return replace(self, hidden=occlusion_by_trees(trees, camera))

    def items(self, part: DrawItem, camera: Camera) -> Sequence[DrawItem]:
        """Items for the Gaussians of a part's cut, and for its nodes."""
        tree = _tree_of(part, camera)
        if tree is None:
            return [part] if self.others is None else self.others.items(part, camera)
        found = cut_lod_tree(tree, camera, part.to_world, self.pixel, hidden=self.hidden)
        wet_sh = merged_harmonics(tree, part.wet_sh) if part.is_wet and part.wet_sh is not None else None
        own = part._replace(members=found.leaves, tree=None)
        return [own, own._replace(gaussians=tree.nodes, members=found.nodes, wet_sh=wet_sh)]


def _tree_of(part: DrawItem, camera: Camera) -> LodTree | None:
    """Tree by which a part is cut for a camera, if it is."""
    return None if not camera.is_pinhole or part.left_out or part.selected is not None else part.tree


def lod_cut(scene: Scene, lod: Lod | None) -> LodCut | None:
    """Cut with which images of a scene are drawn, None for all Gaussians; see `ExportSettings.lod`."""
    is_cut = scene.gaussian_count >= MIN_GAUSSIANS if lod is None else lod == "pixel"
    return LodCut() if is_cut else None


@dataclass(slots=True)
class LodSubset:
    """Draws the most important share of each part's Gaussians, enlarged to cover as much as all of them.

    Gaussians must be in their drawing order. Growths are cached by set of Gaussians. Masks are ignored: if they leave
    out many important Gaussians, the rest is drawn slightly too large.
    """

    share: float
    _growths: dict[tuple[int, int], tuple[Gaussians, float]] = field(
        default_factory=dict[tuple[int, int], "tuple[Gaussians, float]"]  # a reference keeps the identity unique
    )

    def items(self, part: DrawItem, camera: Camera) -> Sequence[DrawItem]:
        """Limit a part to its most important Gaussians."""
        limit = math.ceil(self.share * len(part.gaussians))
        return [part._replace(limit=limit, growth=self.growth(part.gaussians))]

    def growth(self, gaussians: Gaussians) -> float:
        """Scale factor of the remaining Gaussians; cached for all colors of the same Gaussians."""
        key = _shape(gaussians)
        if key not in self._growths:
            self._growths[key] = gaussians, lod_growth(gaussians, self.share)
        return self._growths[key][1]

    def forget_all_but(self, used: Iterable[Gaussians]) -> None:
        keys = {_shape(each) for each in used}
        self._growths = {key: known for key, known in self._growths.items() if key in keys}


@dataclass(frozen=True, slots=True)
class LodSample:
    """Draws a weighted sample of each part's Gaussians, which may be in any order, enlarged to cover as much as all.

    Of those in the sample that cover less than `least_px2` pixels of a pinhole image, fewer are drawn, enlarged in
    turn (`thinned`). Their Gaussians are new ones in each image, which `cpu` does not mind.
    """

    share: float
    least_px2: float = 0.0

    def items(self, part: DrawItem, camera: Camera) -> Sequence[DrawItem]:
        """Replace a part by its sample."""
        return self.join([part], camera)

    def join(self, parts: Sequence[DrawItem], camera: Camera) -> Sequence[DrawItem]:
        """Replace parts by their samples, joined where they differ in nothing but their Gaussians.

        Of few Gaussians, each item costs more than these.
        """
        groups: dict[object, list[DrawItem]] = {}
        for number, part in enumerate(parts):
            is_plain = part.left_out is part.selected is part.colors is part.to_world_ends is None
            look = part.gaussians.antialiased, part.wet_sh is None, part.wetness, part.opacity
            groups.setdefault((part.to_world.tobytes(), look) if is_plain else number, []).append(part)
        samples = [self._sample(group) for group in groups.values()]
        return [self._thinned(item, camera) for item in samples] if self.least_px2 > 0 else samples

    def _sample(self, parts: Sequence[DrawItem]) -> DrawItem:
        first, sets = parts[0], tuple(IdentityKey(part.gaussians) for part in parts)
        wet_colors = tuple(None if part.wet_sh is None else IdentityKey(part.wet_sh) for part in parts)
        gaussians, wet_sh = _joined_samples(sets, wet_colors, self.share)
        item = first._replace(gaussians=gaussians, wet_sh=wet_sh, tree=None)
        if first.left_out is first.selected is None:
            return item
        rows, _ = _sampled(first.gaussians, self.share)  # a part with marks is by itself
        left_out, selected = ((mask and mask.take(rows)) for mask in (first.left_out, first.selected))
        return item._replace(left_out=left_out, selected=selected)

    def _thinned(self, item: DrawItem, camera: Camera) -> DrawItem:
        c, g = camera, item.gaussians
        intrinsics = c.fx, c.fy, c.cx, c.cy, c.width, c.height
        members, scales = thinned(g, c.world_to_camera @ item.to_world, intrinsics, self.least_px2)
        if item.left_out is not None:
            members = members[~item.left_out.flags[members]]
        return item._replace(gaussians=replace(g, scales=scales), members=members, left_out=None)


_GROWN = 0.85
"""Part of the growth of a sample: with all of it, its areas add up to those of all Gaussians. These overlap more, so
that it would hide more than they do. Found by the view behind drops on glass."""

_HARMONICS = 4
"""Coefficients of the colors of a sample: of degree 1. The others change drops in pictures of the street by less than
one gray level (57 to 75 dB), and are most of what there is to read of a Gaussian."""


@scene_cache(maxsize=64)
def _sampled(gaussians: Gaussians, share: float) -> tuple[Int64[np.ndarray, " m"], Gaussians]:
    mask, growth = lod_sample(gaussians, share)
    rows = np.flatnonzero(mask)
    sample = gaussians.take(rows)
    scales = sample.scales * np.float32(1 + _GROWN * (growth - 1))
    return rows, replace(sample, scales=scales, sh=np.ascontiguousarray(sample.sh[:, :_HARMONICS]))


@scene_cache(maxsize=64)
def _joined_samples(
    sets: tuple[IdentityKey, ...], wet_colors: tuple[IdentityKey | None, ...], share: float
) -> tuple[Gaussians, Float32[np.ndarray, "m k 3"] | None]:
    """Samples of sets of Gaussians, one after the other, and their wet colors, if all have them."""
    samples = [_sampled(each.of, share) for each in sets]  # pyright: ignore[reportArgumentType]
    wet: list[Gaussians] = []
    for (rows, sample), colors in zip(samples, wet_colors, strict=True):
        if colors is not None:
            wet_sh: np.ndarray = colors.of  # pyright: ignore[reportAssignmentType]
            wet.append(replace(sample, sh=wet_sh[rows, :_HARMONICS]))
    return Gaussians.concatenate([sample for _, sample in samples]), Gaussians.concatenate(wet).sh if wet else None


def _shape(gaussians: Gaussians) -> tuple[int, int]:
    """Identity of the arrays that growth depends on."""
    return id(gaussians.scales), id(gaussians.opacities)
