"""The job "Make it rainy (preview)": render views, give them a plain wet look, solve the scene's colours for them."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from gsrain_engine.appearance.normals import normals_from_depth
from gsrain_engine.appearance.wet_preview import ground_share, wet_preview
from gsrain_engine.raster.projection import view_directions
from gsrain_engine.raster.rasterizer import expected
from gsrain_engine.raster.spherical_harmonics import harmonics
from gsrain_engine.raster.view_weights import ViewWeights, view_weights
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from .color_change import ColorChange, fit_color_change
from .ground_height import ground_height_m
from .preview_cameras import PreviewCamera
from .recolor import ColorTarget, colors_seen, solve_colors
from .recolored_file import write_recolored
from .scene_members import Member, VisibleMembers, scene_members, visible_members, world_heights

ITERATIONS = 12
_SOLVED = 4
"""Harmonics that are solved for: degree 0 and 1, of which a wet road needs the second. Higher ones keep the prior's."""

_UNSEEN_WEIGHT_PX = 0.5
"""A Gaussian seen with less than this in all counts as ground or not by its height rather than by the views."""
_GROUND_HEIGHT_M = 0.3

_VIEWS_DONE, _PRIOR_DONE, _SETUP_DONE, _SOLVED_DONE = 0.2, 0.32, 0.36, 0.98
"""Shares of the whole job's time, measured on the built-in street."""


@dataclass(frozen=True, slots=True, eq=False)
class _WetView:
    """One view, clear and wet."""

    camera: Camera
    visible: VisibleMembers
    weights: ViewWeights
    color: Float32[np.ndarray, "h w 3"]
    alpha: Float32[np.ndarray, "h w"]
    wet: Float32[np.ndarray, "h w 3"]
    shares: Float32[np.ndarray, "h w 3"]
    """How much of each kind of surface (sky, ground, other), weighted by alpha."""

    @property
    def rows(self) -> Int64[np.ndarray, " m"]:
        """Row of each splat among the Gaussians of all members."""
        return self.visible.rows[self.weights.splats.indices]


def rainy_preview(
    scene: Scene, cameras: Sequence[PreviewCamera], output: Path, strength: float = 1.0
) -> Iterator[Progress]:
    """Write the scene's colours in rain to `output` (read them with `read_recolored`); geometry stays as it is.

    It can be stopped at every step, and then leaves no file. `strength` is that of `wet_preview`.

    Raises:
        ValueError: When there is no camera, or none of them sees anything.
    """
    if not cameras:
        raise ValueError("a preview needs at least one camera")
    members, ground_m = scene_members(scene), ground_height_m(scene)
    count = sum(len(each.gaussians) for each in members)
    views: list[_WetView] = []
    for i, each in enumerate(cameras):
        yield Progress(_VIEWS_DONE * i / len(cameras), f"Rendering view {i + 1} of {len(cameras)}")
        view = _wet_view(scene, members, each, ground_m, strength)
        if len(view.weights.splats):
            views.append(view)
    if not views:
        raise ValueError(f"none of the {len(cameras)} cameras sees anything of the scene {scene.name!r}")

    yield Progress(_VIEWS_DONE, "Estimating how colours change")
    change = _color_change(views)
    prior: dict[str, Float32[np.ndarray, "_ _ 3"]] = {}
    for member, shares in zip(members, _surface_shares(scene, members, views, ground_m), strict=True):
        prior[member.key] = change.of_sh(member.gaussians.sh, shares)
        done = (member.first + len(member.gaussians)) / max(count, 1)
        yield Progress(_VIEWS_DONE + (_PRIOR_DONE - _VIEWS_DONE) * done, "Estimating how colours change")
    targets: list[ColorTarget] = []
    for i, view in enumerate(views):
        done = _PRIOR_DONE + (_SETUP_DONE - _PRIOR_DONE) * i / len(views)
        yield Progress(done, "Comparing with the views")
        targets.append(_target(view, prior))

    solved = yield from _solve(targets, count)
    yield Progress(_SOLVED_DONE, "Writing colours")
    write_recolored(output, {member.key: _with_change(prior[member.key], solved[member.rows]) for member in members})
    yield Progress(1.0, "Done")


def _solve(targets: list[ColorTarget], count: int) -> Generator[Progress, None, Float32[np.ndarray, "n k 3"]]:
    solver = solve_colors(targets, count, ITERATIONS)
    iteration = 0
    while True:
        share = iteration / ITERATIONS
        yield Progress(_SETUP_DONE + (_SOLVED_DONE - _SETUP_DONE) * share, f"Solving colours, step {iteration + 1}")
        try:
            next(solver)
        except StopIteration as finished:
            return finished.value
        iteration = min(iteration + 1, ITERATIONS - 1)


def _wet_view(
    scene: Scene, members: list[Member], preview: PreviewCamera, ground_m: float, strength: float
) -> _WetView:
    camera = preview.camera
    visible = visible_members(scene, members, preview.time_s)
    weights = view_weights(visible.parts, camera)
    splats = weights.splats
    is_sky = visible.is_sky[splats.indices].astype(np.float32)
    colors = weights.blend(splats.colors[:, :3])
    geometry = weights.blend(np.stack([1 - is_sky, is_sky, (1 - is_sky) * splats.colors[:, 3]], axis=1))
    solid, alpha = geometry[..., 0], geometry[..., 0] + geometry[..., 1]
    color = np.stack([expected(np.ascontiguousarray(colors[..., c]), alpha) for c in range(3)], axis=-1)
    depth = np.where(solid > 0.3 * alpha, expected(np.ascontiguousarray(geometry[..., 2]), solid), np.float32(0))
    sky = expected(np.ascontiguousarray(geometry[..., 1]), alpha)
    upness = np.ascontiguousarray(normals_from_depth(depth, camera)[..., 2])
    wet = wet_preview(color, depth, upness, sky, camera, ground_m=ground_m, strength=strength)
    ground = ground_share(depth, upness, camera, ground_m) * (1 - sky)
    shares = alpha[..., None] * np.stack([sky, ground, 1 - sky - ground], axis=-1)
    return _WetView(camera, visible, weights, color, alpha, wet, shares)


def _color_change(views: list[_WetView]) -> ColorChange:
    return fit_color_change(
        [view.color.reshape(-1, 3) for view in views],
        [view.wet.reshape(-1, 3) for view in views],
        [view.shares.reshape(-1, 3) for view in views],
    )


def _surface_shares(
    scene: Scene, members: list[Member], views: list[_WetView], ground_m: float
) -> list[Float32[np.ndarray, "_ 3"]]:
    """What kind of surface each Gaussian is: as the views show it, and by its height where they hardly do."""
    count = sum(len(member.gaussians) for member in members)
    seen = np.zeros((count, 3), np.float32)
    for view in views:
        seen[view.rows] += view.weights.accumulate(view.shares)
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


def _target(view: _WetView, prior: dict[str, Float32[np.ndarray, "_ _ 3"]]) -> ColorTarget:
    """Compare the wet view with what the prior colours give in it."""
    indices = view.weights.splats.indices
    directions = view_directions(view.visible.parts, view.camera, indices)
    basis = harmonics(directions, _SOLVED)
    colors = np.full((len(indices), 3), 0.5, np.float32)
    first = 0
    for member in view.visible.members:
        last = first + len(member.gaussians)
        own = np.flatnonzero((indices >= first) & (indices < last))
        sh = prior[member.key]
        colors[own] += colors_seen(sh, indices[own] - first, harmonics(directions[own], sh.shape[1]))
        basis[own, sh.shape[1] :] = 0
        first = last
    residual = view.wet * view.alpha[..., None] - view.weights.blend(colors)
    return ColorTarget(view.weights, view.rows, basis, residual)


def _with_change(
    prior: Float32[np.ndarray, "n k 3"], change: Float32[np.ndarray, "n solved 3"]
) -> Float32[np.ndarray, "n k 3"]:
    sh = prior.copy()
    shared = min(sh.shape[1], change.shape[1])
    sh[:, :shared] += change[:, :shared]
    return sh
