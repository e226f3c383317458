"""Level of detail: replacements of a scene's parts by fewer Gaussians."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Int64

from ..scene.camera import Camera
from ..scene.gaussians import Gaussians, IdentityKey, scene_cache
from ..scene.lod_occlusion import OcclusionMap
from ..scene.lod_order import lod_growth, lod_sample, thinned
from ..scene.lod_tree import MIN_GAUSSIANS, PIXEL, LodTree, cut_lod_tree, merged_harmonics, occlusion_by_trees
from ..scene.scene import DrawItem, Scene
from .export_settings import Lod


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
