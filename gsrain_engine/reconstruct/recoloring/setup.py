"""Sets a recolouring up: looks at the scene from every view, maps its clear colours, and lists the unknowns."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from .color_change import ColorChange, fit_color_change
from .ground_height import ground_height_m
from .problem import ColorProblem, ProblemView
from .robust import spread, view_trust
from .scene_members import Member, scene_members
from .settings import RecolorSettings
from .views import SeenView, TargetView, seen_view, surface_shares

_VIEWS_DONE = 0.6
"""Share of the set-up that looking takes, measured on the built-in street."""
_SPACING_PX = 3
"""Every third pixel each way is enough for a map of twelve numbers a surface."""


@dataclass(frozen=True, slots=True, eq=False)
class SetUp:
    """A problem, and what else its solution needs to become a scene's colours."""

    problem: ColorProblem
    members: tuple[Member, ...]
    prior: dict[str, Float32[np.ndarray, "_ _ 3"]]
    """Mapped clear harmonics by the keys of members."""

    def colors(self, sh: Float32[np.ndarray, "n k 3"]) -> dict[str, Float32[np.ndarray, "_ _ 3"]]:
        """Harmonics of every member: solved ones where a view sees the Gaussian, else the mapped clear ones."""
        result: dict[str, Float32[np.ndarray, "_ _ 3"]] = {}
        for member in self.members:
            first, last = np.searchsorted(self.problem.rows, [member.rows.start, member.rows.stop])
            own = self.prior[member.key].copy()
            own[self.problem.rows[first:last] - member.first] = sh[first:last, : own.shape[1]]
            result[member.key] = own
        return result


def set_up(
    scene: Scene, targets: Sequence[TargetView], held_out: Sequence[TargetView], settings: RecolorSettings
) -> Generator[Progress, None, SetUp]:
    """Set up the recolouring of a scene to pictures; the progress is that of the set-up alone.

    Raises:
        ValueError: When there is no picture, or none shows anything of the scene.
    """
    if not targets:
        raise ValueError("recolouring needs at least one picture to recolour to")
    members, ground_m = scene_members(scene), ground_height_m(scene)
    views: list[SeenView] = []
    room = settings.memory_mb * 1e6
    for i, target in enumerate([*targets, *held_out]):
        yield Progress(_VIEWS_DONE * i / (len(targets) + len(held_out)), f"Looking at view {target.name}")
        views.append(seen_view(scene, members, target, ground_m, room))
        room -= views[-1].weights.nbytes
    used_mb = settings.memory_mb - room / 1e6
    yield Progress(_VIEWS_DONE, f"Mapping colours; weights of {len(views)} views take {used_mb:,.0f} MB")
    setup = set_up_seen(scene, members, views, len(targets), settings)
    yield Progress(1.0, "Set up")
    return setup


def set_up_seen(
    scene: Scene, members: Sequence[Member], views: Sequence[SeenView], taught: int, settings: RecolorSettings
) -> SetUp:
    """Set up for views that have been looked at; those after the first so many have no say.

    Raises:
        ValueError: When none of those that have a say shows anything of the scene.
    """
    if not any(len(view.splats) and view.counted.any() for view in views[:taught]):
        raise ValueError(f"none of the {taught} cameras sees anything of the scene {scene.name!r}")
    change = _color_change(views[:taught], robust=settings.robust)
    prior: dict[str, Float32[np.ndarray, "_ _ 3"]] = {}
    shares = surface_shares(scene, members, views[:taught], ground_height_m(scene))
    for member, own in zip(members, shares, strict=True):
        prior[member.key] = change.of_sh(member.gaussians.sh, own)
    return SetUp(_problem(members, prior, views, taught), tuple(members), prior)


def _color_change(views: Sequence[SeenView], *, robust: bool) -> ColorChange:
    """Fit the maps of colour to all views; once more with less say for those that the first ones fail."""
    some = [slice(None, None, _SPACING_PX)] * 2
    clear = [view.clear[*some].reshape(-1, 3) for view in views]
    wanted = [view.target.image[*some].reshape(-1, 3) for view in views]
    shares = [(view.surfaces * view.counted[..., None])[*some].reshape(-1, 3) for view in views]
    change = fit_color_change(clear, wanted, shares)
    if not robust or len(views) < 3:
        return change
    errors = [(change.of_colors(x, w) - y)[None] for x, y, w in zip(clear, wanted, shares, strict=True)]
    trust = view_trust([spread(error, (w.sum(axis=1) > 0)[None]) for error, w in zip(errors, shares, strict=True)])
    return fit_color_change(clear, wanted, [np.float32(t) * w for t, w in zip(trust, shares, strict=True)])


def _problem(
    members: Sequence[Member], prior: dict[str, Float32[np.ndarray, "_ _ 3"]], views: Sequence[SeenView], taught: int
) -> ColorProblem:
    k = max(member.gaussians.sh.shape[1] for member in members)
    is_seen = np.zeros(sum(len(member.gaussians) for member in members), np.bool_)
    for view in views:
        is_seen[view.rows] = True
    rows, numbers = np.flatnonzero(is_seen), np.cumsum(is_seen) - 1
    start = np.zeros((len(rows), k, 3), np.float32)
    for member in members:
        first, last = np.searchsorted(rows, [member.rows.start, member.rows.stop])
        own = prior[member.key]
        start[first:last, : own.shape[1]] = own[rows[first:last] - member.first]
    listed = tuple(ProblemView(view, numbers[view.rows], view.basis(k)) for view in views)
    return ColorProblem(rows, listed[:taught], listed[taught:], start, _one_view(listed[:taught], len(rows)))


def _one_view(views: Sequence[ProblemView], count: int) -> Float32[np.ndarray, " n"]:
    """Mean evidence of each Gaussian in one view, sum e^2 / sum e with e the sum of its squared weights in a view."""
    evidence = np.zeros((2, count), np.float32)
    for view in views:
        own = view.seen.weights.squared_sums(view.seen.counted.astype(np.float32))
        evidence[0, view.indices] += own
        evidence[1, view.indices] += own * own
    return evidence[1] / np.maximum(evidence[0], np.float32(1e-6))
