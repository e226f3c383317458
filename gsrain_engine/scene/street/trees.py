"""Trees: a trunk with branches, and a crown of leaf clusters with light between them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from .grids import tube
from .labels import Label
from .layout import KERB_HEIGHT_M, StreetLayout, Tree
from .quads import EDGE_SPREAD, Quads

_BARK = (0.115, 0.09, 0.065)
_LEAF = np.array([0.085, 0.17, 0.03])
_TWIGS, _LEAVES_A_TWIG = 58, 29


def build_trees(layout: StreetLayout, sun: Float64[np.ndarray, "3"]) -> Quads:
    """Build every tree; `sun` points to the sun and decides which leaves lie in their own crown's shade."""
    return Quads.joined(_tree(tree, sun) for tree in layout.trees)


def crown_lobes(tree: Tree) -> Float64[np.ndarray, "m 4"]:
    """Balls (x, y, z, radius) in metres that together make the crown's outline."""
    rng = np.random.default_rng(tree.seed)
    base, top, r = KERB_HEIGHT_M + tree.crown_base, KERB_HEIGHT_M + tree.height, tree.radius
    middle = np.array([tree.x, tree.y, 0.5 * (base + top) - 0.1])
    lobes = [np.array([*middle, 0.72 * r])]
    turn = rng.uniform(0, 2 * np.pi)
    for k in range(5):
        angle = turn + 2 * np.pi * (k + 0.3 * rng.uniform(-1, 1)) / 5
        away = r * rng.uniform(0.42, 0.56)
        z = base + (top - base) * rng.uniform(0.26, 0.56)
        x, y = tree.x + away * np.cos(angle), tree.y + away * np.sin(angle)
        lobes.append(np.array([x, y, z, r * rng.uniform(0.46, 0.6)]))
    for z, s in ((0.72, 0.55), (0.86, 0.4)):
        shift = 0.22 * r * rng.uniform(-1, 1, 2)
        lobes.append(np.array([tree.x + shift[0], tree.y + shift[1], base + (top - base) * z, r * s]))
    return np.array(lobes)


def _tree(tree: Tree, sun: Float64[np.ndarray, "3"]) -> Quads:
    rng = np.random.default_rng([tree.seed, 1])
    lobes = crown_lobes(tree)
    return Quads.joined([_wood(tree, lobes, rng), _leaves(tree, lobes, sun, rng)])


def _wood(tree: Tree, lobes: Float64[np.ndarray, "m 4"], rng: np.random.Generator) -> Quads:
    foot = np.array([tree.x, tree.y, KERB_HEIGHT_M - 0.02])
    fork = foot + np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.08, 0.08), tree.crown_base + 0.02])
    part = np.concatenate([[0.0, 0.03, 0.08], np.linspace(0.16, 1.0, 9)])
    bend = 0.05 * np.sin(np.pi * part)[:, None] * np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), 0.0])
    trunk = foot + part[:, None] * (fork - foot) + bend
    radii = 0.135 * (1 - 0.32 * part) * (1 + 0.55 * np.exp(-part / 0.05))
    parts = [tube(trunk, radii, _BARK, Label.VEGETATION, sides=8)]
    for lobe in lobes[1:]:
        goal = lobe[:3]
        part = np.linspace(0, 1, 6)[:, None]
        path = fork + part * (goal - fork) + 0.18 * np.sin(np.pi * part) * np.array([0.0, 0.0, 1.0])
        parts.append(tube(path, np.linspace(0.075, 0.025, 6), _BARK, Label.VEGETATION, sides=5, sky_access=0.6))
    wood = Quads.joined(parts)
    spots = rng.uniform(0.7, 1.3, len(wood))
    shade = np.where(wood.centers[:, 2] > fork[2], 0.25, 1.0)
    return replace(wood.tinted(spots[:, None]), sun_access=shade.astype(np.float32))


def _leaves(
    tree: Tree, lobes: Float64[np.ndarray, "m 4"], sun: Float64[np.ndarray, "3"], rng: np.random.Generator
) -> Quads:
    """Scatter leaves around twigs near the lobes' surfaces; gaps between twigs let the sky through."""
    shares = lobes[:, 3] ** 2 / np.sum(lobes[:, 3] ** 2)
    of_lobe = rng.choice(len(lobes), size=_TWIGS, p=shares)
    outward = rng.normal(size=(_TWIGS, 3)) + np.array([0, 0, 0.25])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    reach = lobes[of_lobe, 3] * rng.uniform(0.62, 1.02, _TWIGS)
    twigs = lobes[of_lobe, :3] + reach[:, None] * outward
    n = _TWIGS * _LEAVES_A_TWIG
    twig = np.repeat(np.arange(_TWIGS), _LEAVES_A_TWIG)
    center = twigs[twig] + rng.normal(size=(n, 3)) * [0.23, 0.23, 0.17]
    center[:, 2] = np.maximum(center[:, 2], KERB_HEIGHT_M + tree.crown_base - 0.35)
    lobe = lobes[of_lobe[twig]]
    crown = center - lobe[:, :3]
    crown /= np.maximum(np.linalg.norm(crown, axis=1, keepdims=True), 1e-6)
    normals = crown + 0.45 * rng.normal(size=(n, 3)) + [0, 0, 0.2]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    facing = normals + 0.5 * rng.normal(size=(n, 3))
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    first = np.cross(facing, rng.normal(size=(n, 3)))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(facing, first)
    length = rng.uniform(0.075, 0.125, n)[:, None]
    width = length * rng.uniform(0.55, 0.8, n)[:, None]
    corners = np.stack(
        [center - length * first, center - width * second, center + length * first, center + width * second], axis=1
    )
    lit = np.exp(-1.15 * _depth_inside(center, lobes, sun))
    open_sky = np.exp(-0.8 * _depth_inside(center, lobes, np.array([0.0, 0.0, 1.0])))
    tint = rng.uniform(0.72, 1.28, n) * np.repeat(rng.uniform(0.85, 1.15, _TWIGS), _LEAVES_A_TWIG)
    yellow = rng.uniform(0.0, 1.0, n)[:, None] ** 2 * np.array([0.045, 0.03, 0.0])
    # The diagonals of these quads are the leaf's axes, so cell widths are 0.71 of them.
    return Quads.of(
        corners, (_LEAF + yellow) * tint[:, None], Label.VEGETATION, normals=normals, sun_access=lit,
        sky_access=0.25 + 0.75 * open_sky, opacity=0.98, spread=EDGE_SPREAD,
    )  # fmt: skip


def _depth_inside(
    points: Float64[np.ndarray, "n 3"], lobes: Float64[np.ndarray, "m 4"], direction: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, " n"]:
    """Metres of crown between each point and the outside along a direction; overlaps count once each."""
    away = points[:, None] - lobes[None, :, :3]
    along = away @ direction
    inside = along**2 - (np.sum(away**2, axis=2) - lobes[:, 3] ** 2)
    root = np.sqrt(np.maximum(inside, 0))
    path = np.clip(-along + root, 0, None) - np.clip(-along - root, 0, None)
    return 0.55 * np.where(inside > 0, path, 0).sum(axis=1)
