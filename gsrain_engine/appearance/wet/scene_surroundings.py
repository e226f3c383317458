"""Where a wet ground finds what it mirrors: in the scene itself, seen from below the ground."""

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.scene.marks import Marks
from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.members import Layer
from gsrain_engine.scene.rotations import matrices_from_quaternions
from gsrain_engine.scene.scene import Scene

from ..clear_view import ClearView
from ..views.placed_camera import PlacedCamera
from ..views.scene_views import scene_view
from .ground import Ground, ground_of
from .ground_heights import GroundHeights, ground_heights
from .ground_plane import GroundPlane, fitted_plane
from .mirrored import Mirrored, mirror_camera
from .mirrored_gaps import without_gaps
from .seen_again import seen_again

MIRROR_SCALE = 0.5
"""Resolution of the mirror's picture relative to the view's: no water on a road is that smooth."""
_SOLID = 0.5
"""Opacity from which a Gaussian tells where the ground is."""
_FLAT, _LEAST_FLAT = 0.5, 0.02
"""A Gaussian lies that is so many times as high as wide; and share of those that must lie for them alone to tell."""
_MOST_POINTS = 400_000
_BAND_M = 0.3
_UPON_M = 0.03
"""What reaches so little over the ground is ground, whatever its shape."""
_THICKNESS_M = 0.15
"""What lies flat within so much of the ground is ground."""
_BANK_M = 0.3
"""Ground that rises so far over the mirror's plane is a bank, which the road mirrors."""


class SceneSurroundings:
    """The surroundings of a scene's views: a mirrored camera sees what is really there, also beyond the view's edge."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._recent_ground = lru_cache(maxsize=2)(self._ground)

    def ground(self, view: ClearView) -> Ground | None:
        return self._recent_ground(view)

    def _ground(self, view: ClearView) -> Ground | None:
        if self._start is None or self._heights is None:
            return None
        return ground_of(view, self._heights, self._start)

    def mirrored(self, view: ClearView, ground: Ground) -> Mirrored:
        """Show what the view itself has seen where it has, and else render the scene for the mirrored camera.

        That is done without the ground, through which the camera would have to look. What the view has seen looks
        better than captured Gaussians do from below, where no camera ever was.
        """
        camera = mirror_camera(view.camera, ground.plane, MIRROR_SCALE)
        placed = PlacedCamera(f"{view.name} mirrored", camera, view.time_s, view.sensor)
        beyond = without_gaps(scene_view(self._above(ground.plane), placed), ground.plane)
        again = seen_again(view, ground, camera)
        known = again.found.astype(np.float32)
        return Mirrored(beyond, again.places, known, np.where(again.found, again.depth, beyond.depth))

    @cached_property
    def _layers(self) -> list["_Standing"]:
        """What stands still and can be seen, sky apart."""
        return [_standing(self._scene, layer) for layer in self._scene.layers if layer.visible and layer.kind != "sky"]

    @cached_property
    def _points(self) -> Float64[np.ndarray, "n 3"]:
        """Centres of what is solid and lies flat, in the world; of all that is solid where hardly anything lies."""
        solid = np.concatenate([np.zeros((0, 3)), *(each.points[each.solid] for each in self._layers)])
        flat = np.concatenate([np.zeros((0, 3)), *(each.points[each.solid & each.flat] for each in self._layers)])
        points = flat if len(flat) > _LEAST_FLAT * len(solid) else solid
        return points[:: max(1, len(points) // _MOST_POINTS)]

    @cached_property
    def _start(self) -> GroundPlane | None:
        if len(self._points) < 3:
            return None
        if self._scene.ground_m is not None:
            return GroundPlane(np.array([0.0, 0.0, 1.0]), self._scene.ground_m)
        return fitted_plane(self._points, _BAND_M)

    @cached_property
    def _heights(self) -> GroundHeights | None:
        if self._start is None:
            return None
        found = ground_heights(self._points, self._start)
        return found if len(self._way) < 2 else found.with_ruts(self._way)

    @cached_property
    def _lying(self) -> list[Bool[np.ndarray, " n"]]:
        """Which Gaussians of each layer lie on the ground."""
        assert self._heights is not None
        over = [each.points[:, 2] - self._heights.sampled(self._heights.fine_m, each.points) for each in self._layers]
        return [
            (above < _UPON_M) | ((above < _THICKNESS_M) & each.flat)
            for above, each in zip(over, self._layers, strict=True)
        ]

    @property
    def _way(self) -> Float64[np.ndarray, "n 2"]:
        """Where the ego vehicle drives, x and y in the world."""
        ego, to_world = self._scene.ego, self._scene.scene_to_world
        places = np.zeros((0, 3)) if ego is None else ego.positions[ego.valid]
        return (places @ to_world[:3, :3].T + to_world[:3, 3])[:, :2]

    def _above(self, plane: GroundPlane) -> Scene:
        """Return the scene without its ground and without what is under the mirror's plane."""
        scene = self._scene
        for each, lying in zip(self._layers, self._lying, strict=True):
            over = plane.heights(each.points)
            ground = Mask.of((over < _UPON_M) | (lying & (over < _BANK_M)))
            hidden = ground if each.marks.hidden is None else each.marks.hidden | ground
            scene = scene.with_member(each.key, marks=replace(each.marks, hidden=hidden))
        return scene


class _Standing(NamedTuple):
    """What there is to know about the Gaussians of a layer."""

    key: str
    marks: Marks
    points: Float64[np.ndarray, "n 3"]
    """Centres in the world."""
    solid: Bool[np.ndarray, " n"]
    flat: Bool[np.ndarray, " n"]
    """Which are wide rather than high."""


def _standing(scene: Scene, layer: Layer) -> _Standing:
    part = scene.part(layer)
    assert part is not None  # layers are there at any time
    g, to_world = part.gaussians, part.to_world
    points = g.means @ to_world[:3, :3].T + to_world[:3, 3]
    solid = (g.opacities * part.opacity > _SOLID) & np.isfinite(points).all(axis=1)
    if part.left_out is not None:
        solid &= ~part.left_out.flags
    turn = to_world[:3, :3] @ matrices_from_quaternions(g.quaternions.astype(np.float64))
    sizes = np.sum((turn * g.scales[:, None, :]) ** 2, axis=2)
    flat = sizes[:, 2] < _FLAT**2 * sizes[:, :2].max(axis=1)
    return _Standing(layer.key, layer.marks, points, solid, flat)
