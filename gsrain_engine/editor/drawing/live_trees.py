"""Level-of-detail trees of the scene on the screen, built in the background, and cuts of them for live pictures."""

import logging
import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32

from ...render.level_of_detail import LodSubset
from ...scene.camera import Camera
from ...scene.flags import BitMask
from ...scene.gaussians import Gaussians, IdentityKey
from ...scene.lod_tree import LodTree, average_below, build_lod_tree, cut_lod_tree
from ...scene.scene import Actor, DrawItem, Layer, Scene
from ...threads import half_of_cores, lower_thread_priority

logger = logging.getLogger("gsrain")
_SMALL = 4096  # number of Gaussians of a member below which all are drawn
_MISSING = 1 / 10  # share of the Gaussians that may lack a tree in a picture of cuts
_MIRROR_ERROR = 3.0  # factor on the error of a cut in mirror images
_Role = Literal["left out", "selected"]
_Harmonics = Float32[np.ndarray, "n k 3"]


class _Pending(NamedTuple):
    """Gaussians whose tree is to be built, with their wet colors."""

    gaussians: Gaussians
    wet_sh: _Harmonics | None


class _Built(NamedTuple):
    """A finished tree with its wet colors; None if it could not be built."""

    pending: _Pending
    tree: LodTree | None
    wet_sh: _Harmonics | None


class LiveTrees:
    """Trees of the members of the scenes on the screen, built one after another on a thread of their own.

    A tree belongs to one set of Gaussians. An edit that changes those makes another set, without a tree until it is
    built; a change of poses, gradings, wet colors, selections or hidden Gaussians leaves the tree as it is. Used by one
    thread.
    """

    def __init__(self) -> None:
        self._trees: dict[IdentityKey, LodTree] = {}
        self._wet: dict[IdentityKey, tuple[_Harmonics, _Harmonics]] = {}
        """Wet colors of Gaussians, and of the nodes of their tree."""
        self._masks: dict[tuple[IdentityKey, _Role], tuple[BitMask, Bool[np.ndarray, " m"]]] = {}
        self._seen, self._failed = set[IdentityKey](), set[IdentityKey]()
        self._queue, self._finished = deque[_Pending](), deque[_Built]()
        self._building: IdentityKey | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        """Guards the queue, what is being built and what is finished."""

    def follow(self, scenes: Iterable[Scene], *, at_once: bool = False) -> None:
        """Take finished trees, drop those of Gaussians that are no longer there, and begin to build missing ones.

        Once per picture. Gaussians have to be there in two pictures, unless `at_once`: those of a drag are not.
        """
        scenes = list(scenes)
        there = {IdentityKey(each.gaussians) for scene in scenes for each in scene.members}
        large = {IdentityKey(each.gaussians): each for scene in scenes for each in _large_members(scene)}
        with self._lock:
            while self._finished:
                self._take(self._finished.popleft())
            for known in (self._trees, self._wet):
                for key in known.keys() - there:
                    del known[key]
            self._failed &= there
            self._masks = {of: mask for of, mask in self._masks.items() if of[0] in there}
            lacking = [
                _Pending(each.gaussians, each.wet_sh)
                for key, each in large.items()
                if not (self._has_tree(each) or key in self._failed or key == self._building)
                and (at_once or key in self._seen)
            ]
            self._seen = set(large)
            self._queue.clear()
            self._queue.extend(sorted(lacking, key=lambda each: -len(each.gaussians)))
            if lacking and self._thread is None:
                self._thread = threading.Thread(target=self._build, name="level of detail", daemon=True)
                self._thread.start()

    def wait(self) -> None:
        """Wait until nothing is being built; `follow` takes the trees."""
        if (thread := self._thread) is not None:
            thread.join()

    def of(self, part: DrawItem) -> LodTree | None:
        """Tree of a part's Gaussians; None if there is none yet."""
        return part.tree or self._trees.get(IdentityKey(part.gaussians))

    def cover(self, scenes: Iterable[Scene]) -> bool:
        """Return whether almost all Gaussians of some scenes have a tree, so that pictures can be cuts."""
        members = [each for scene in scenes for each in _large_members(scene)]
        lacking = sum(len(each.gaussians) for each in members if not self._has_tree(each))
        return len(members) > 0 and lacking <= _MISSING * sum(len(each.gaussians) for each in members)

    def merged_wet_sh(self, tree: LodTree, wet_sh: _Harmonics) -> Float32[np.ndarray, "m k 3"]:
        """Wet colors of a tree's nodes."""
        key = IdentityKey(tree.gaussians)
        if key not in self._wet or self._wet[key][0] is not wet_sh:
            self._wet[key] = wet_sh, average_below(tree, wet_sh)
        return self._wet[key][1]

    def majority(self, tree: LodTree, mask: BitMask, role: _Role) -> Bool[np.ndarray, " m"]:
        """Flags of a tree's nodes with more than half of their weight in a mask of its Gaussians."""
        key = IdentityKey(tree.gaussians), role
        if key not in self._masks or self._masks[key][0] is not mask:
            shares = average_below(tree, np.repeat(mask.flags.astype(np.float32), 3).reshape(-1, 1, 3))
            self._masks[key] = mask, shares[:, 0, 0] > 0.5
        return self._masks[key][1]

    @property
    def nbytes(self) -> int:
        """Memory of the trees and of their wet colors."""
        return sum(each.nbytes for each in self._trees.values()) + sum(each.nbytes for _, each in self._wet.values())

    def _has_tree(self, member: Layer | Actor) -> bool:
        own = member.tree is not None and member.tree.fits(member.gaussians)
        return own or IdentityKey(member.gaussians) in self._trees

    def _take(self, built: _Built) -> None:
        (gaussians, wet_sh), tree, merged = built
        key = IdentityKey(gaussians)
        if tree is None:
            self._failed.add(key)
            return
        self._trees[key] = tree
        if wet_sh is not None and merged is not None:
            self._wet[key] = wet_sh, merged

    def _build(self) -> None:
        """Build the trees of the queue, on the thread."""
        lower_thread_priority()
        with half_of_cores():
            while (pending := self._next()) is not None:
                built = _built(pending)
                with self._lock:
                    self._finished.append(built)
                    self._building = None
                del pending, built

    def _next(self) -> _Pending | None:
        with self._lock:
            if not self._queue:
                self._thread = None
                return None
            pending = self._queue.popleft()
            self._building = IdentityKey(pending.gaussians)
            return pending


def _built(pending: _Pending) -> _Built:
    gaussians, wet_sh = pending
    try:
        tree = build_lod_tree(gaussians)
        return _Built(pending, tree, None if wet_sh is None else average_below(tree, wet_sh))
    except Exception:  # pictures go on with fewer Gaussians instead
        logger.exception("Details can't be merged for pictures in motion; they show fewer Gaussians instead")
        return _Built(pending, None, None)


def _large_members(scene: Scene) -> list[Layer | Actor]:
    return [each for each in scene.members if each.visible and len(each.gaussians) >= _SMALL]


@dataclass(frozen=True, slots=True, eq=False)
class LiveCut:
    """Draws the coarsest nodes with errors under a number of pixels, for pictures that must be fast rather than exact.

    Parts of few Gaussians are drawn in full, and those without a tree are left to `others`. A node is hidden or tinted
    if most of it is.
    """

    error_px: float
    trees: LiveTrees
    others: LodSubset

    @property
    def reflected(self) -> "LiveCut":
        """Cut for mirror images, which water blurs."""
        return replace(self, error_px=_MIRROR_ERROR * self.error_px)

    def items(self, part: DrawItem, camera: Camera) -> list[DrawItem]:
        """Items for the Gaussians of a part's cut, and for its nodes."""
        if len(part.gaussians) < _SMALL:
            return [part]
        tree = self.trees.of(part)
        if tree is None or not camera.is_pinhole:
            return [*self.others.items(part, camera)]
        leaves, nodes = cut_lod_tree(tree, camera, part.to_world, self.error_px, in_order=False)
        if part.left_out:
            leaves = leaves[~part.left_out.flags[leaves]]
            nodes = nodes[~self.trees.majority(tree, part.left_out, "left out")[nodes]]
        selected = part.selected and BitMask.of(self.trees.majority(tree, part.selected, "selected"))
        wet_sh = self.trees.merged_wet_sh(tree, part.wet_sh) if part.is_wet and part.wet_sh is not None else None
        own = part._replace(members=leaves, left_out=None, tree=None)
        return [own, own._replace(gaussians=tree.nodes, members=nodes, wet_sh=wet_sh, selected=selected)]
