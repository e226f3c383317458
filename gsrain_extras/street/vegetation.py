"""Trees, street furniture, and the sky dome."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.labels import Label

from .ground import longer_by_m
from .layout import BUS_LENGTH_M, CROSSING_LENGTH_M, CURB_HEIGHT_M, StreetLayout, Tree
from .mesh import Quads, box, patch, tube
from .signals import build_masts
from .signs import bus_stop_sign, crossing_sign, sign_on_pole, speed_limit, stop_sign

_BARK = (0.115, 0.09, 0.065)
_LEAF = np.array([0.085, 0.17, 0.03])
_TWIGS, _LEAVES_A_TWIG = 58, 29
_LEAF_SPREAD = 0.44


def build_trees(layout: StreetLayout, sun: Float64[np.ndarray, "3"]) -> Quads:
    """Build every tree; `sun` points to the sun, for the shade of leaves by their own crown."""
    return Quads.joined(_tree(tree, sun) for tree in layout.trees)


def crown_middle(tree: Tree) -> tuple[float, float]:
    """Height of the middle of a crown, and half of the crown's height, in meters."""
    return CURB_HEIGHT_M + 0.5 * (tree.crown_base + tree.height), 0.5 * (tree.height - tree.crown_base)


def crown_lobes(tree: Tree) -> Float64[np.ndarray, "m 4"]:
    """Balls (x, y, z, radius) in meters whose union is the crown's outline."""
    rng = np.random.default_rng(tree.seed)
    base, top, r = CURB_HEIGHT_M + tree.crown_base, CURB_HEIGHT_M + tree.height, tree.radius
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
    foot = np.array([tree.x, tree.y, CURB_HEIGHT_M - 0.02])
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
    """Scatter leaves around twigs near the lobes' surfaces; the sky is visible through gaps between twigs."""
    shares = lobes[:, 3] ** 2 / np.sum(lobes[:, 3] ** 2)
    of_lobe = rng.choice(len(lobes), size=_TWIGS, p=shares)
    outward = rng.normal(size=(_TWIGS, 3)) + np.array([0, 0, 0.25])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    reach = lobes[of_lobe, 3] * rng.uniform(0.62, 1.02, _TWIGS)
    twigs = lobes[of_lobe, :3] + reach[:, None] * outward
    each = round(_LEAVES_A_TWIG / tree.detail**2)
    n = _TWIGS * each
    twig = np.repeat(np.arange(_TWIGS), each)
    center = twigs[twig] + rng.normal(size=(n, 3)) * [0.23, 0.23, 0.17]
    center[:, 2] = np.maximum(center[:, 2], CURB_HEIGHT_M + tree.crown_base - 0.35)
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
    length = tree.detail * rng.uniform(0.075, 0.125, n)[:, None]
    width = length * rng.uniform(0.55, 0.8, n)[:, None]
    corners = np.stack(
        [center - length * first, center - width * second, center + length * first, center + width * second], axis=1
    )
    lit = np.exp(-1.15 * _depth_inside(center, lobes, sun))
    open_sky = np.exp(-0.8 * _depth_inside(center, lobes, np.array([0.0, 0.0, 1.0])))
    tint = rng.uniform(0.72, 1.28, n) * np.repeat(rng.uniform(0.85, 1.15, _TWIGS), each)
    yellow = rng.uniform(0.0, 1.0, n)[:, None] ** 2 * np.array([0.045, 0.03, 0.0])
    # The diagonals of these quads are the leaf's axes, so cell widths are 0.71 of them.
    return Quads.of(
        corners, (_LEAF + yellow) * tint[:, None], Label.VEGETATION, normals=normals, sun_access=lit,
        sky_access=0.25 + 0.75 * open_sky, opacity=0.98, spread=_LEAF_SPREAD,
    )  # fmt: skip


def _depth_inside(
    points: Float64[np.ndarray, "n 3"], lobes: Float64[np.ndarray, "m 4"], direction: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, " n"]:
    """Meters of crown between each point and the outside along a direction; each overlapping lobe counts."""
    away = points[:, None] - lobes[None, :, :3]
    along = away @ direction
    inside = along**2 - (np.sum(away**2, axis=2) - lobes[:, 3] ** 2)
    root = np.sqrt(np.maximum(inside, 0))
    path = np.clip(-along + root, 0, None) - np.clip(-along - root, 0, None)
    return 0.55 * np.where(inside > 0, path, 0).sum(axis=1)


# Street furniture

_IRON = (0.045, 0.055, 0.052)


def build_furniture(layout: StreetLayout) -> Quads:
    p = layout.parameters
    parts = [build_masts(layout), *(build_lantern(x, y) for x, y in layout.lamps)]
    sign_y = p.curb_y_m + 0.32
    for c in layout.crossings:
        for side, x in ((-1, c - 0.6), (1, c + CROSSING_LENGTH_M + 0.6)):
            y = side * sign_y
            x += 3.4 * side if c in layout.signals else 0.0  # the mast of its light is next to it
            parts.append(sign_on_pole(x, y, 2.62, 0.62, crossing_sign, side))
        for side in (-1, 1):
            for k in range(3):
                parts.append(_bollard(c + 0.3 + 1.2 * k, side * (p.curb_y_m + 0.4)))
    rng = np.random.default_rng([p.seed, 5])
    for x in np.arange(p.start_x_m + 14.0, p.end_x_m - 8, 27.0):
        side = 1 if rng.random() < 0.5 else -1
        parts.append(_bin(float(x), side * (p.curb_y_m + 0.55)))
    for x in np.arange(p.start_x_m + 25.0, p.end_x_m - 8, 48.0):
        parts.append(sign_on_pole(x, -sign_y, 2.45, 0.6, speed_limit("30"), -1, "round"))
    for x, side in ((p.end_x_m - 2.4, -1), (p.start_x_m + 2.4, 1)):
        parts.append(sign_on_pole(x, side * sign_y, 2.35, 0.76, stop_sign, side, "octagon"))
    for bus in layout.buses:
        x = bus.x - 0.5 * BUS_LENGTH_M - 0.9
        parts.append(sign_on_pole(x, sign_y, 2.50, 0.45, bus_stop_sign, 1, "round"))
    return Quads.joined(parts)


def _pole(
    x: float, y: float, height: float, radius: float, albedo: tuple[float, float, float], sides: int = 7
) -> Quads:
    z = np.concatenate([[0.0, 0.06, 0.14], np.arange(0.3, height - 0.1, 0.32), [height]])
    path = np.stack([np.full_like(z, x), np.full_like(z, y), CURB_HEIGHT_M + z], axis=1)
    swell = 1 + 0.9 * np.exp(-((z / 0.7) ** 4)) if radius > 0.05 else np.ones_like(z)
    return tube(path, radius * swell * (1 - 0.25 * z / height), albedo, Label.POLE, sides=sides, gloss=0.06)


LANTERN_LIGHT = np.array([30.0, 21.0, 11.5])
"""Light of a lantern's glass by night, linear; 1 is a camera's white."""


def lantern_position(x: float, y: float) -> tuple[float, float, float]:
    """Middle of the head of the lantern with its foot at (x, y): above the edge of the road, in meters."""
    return x, y - 1.75 * float(np.sign(y)), CURB_HEIGHT_M + 6.55


def build_lantern(x: float, y: float) -> Quads:
    """Build a lantern on a curved arm over the road, 6.5 m high, with its foot on the curb at (x, y)."""
    inward = -float(np.sign(y))
    turn = np.linspace(0, 0.5 * np.pi, 7)
    arm_y, arm_z = y + inward * 1.5 * (1 - np.cos(turn)), CURB_HEIGHT_M + 5.8 + 0.75 * np.sin(turn)
    arm = np.stack([np.full_like(turn, x), arm_y, arm_z], axis=1)
    _, head_y, head_z = lantern_position(x, y)
    curve = tube(arm, np.linspace(0.05, 0.04, 7), _IRON, Label.POLE, sides=6, gloss=0.06)
    head = box((x, head_y, head_z + 0.02), (0.24, 0.62, 0.1), _IRON, Label.POLE, coarse=0.16)
    glass = box((x, head_y, head_z - 0.06), (0.18, 0.5, 0.05), (0.6, 0.6, 0.55), Label.POLE, coarse=0.16,
                faces="xXyYz", emission=LANTERN_LIGHT)  # fmt: skip
    return Quads.joined([_pole(x, y, 5.82, 0.075, _IRON), curve, head, glass])


def _bollard(x: float, y: float) -> Quads:
    z = np.array([0.0, 0.1, 0.3, 0.5, 0.68, 0.78, 0.86, 0.92, 0.96])
    radii = np.array([0.085, 0.07, 0.062, 0.06, 0.06, 0.06, 0.068, 0.055, 0.005])
    path = np.stack([np.full_like(z, x), np.full_like(z, y), CURB_HEIGHT_M + z], axis=1)
    body = tube(path, radii, _IRON, Label.FURNITURE, sides=8, gloss=0.05)
    band = (body.centers[:, 2] - CURB_HEIGHT_M > 0.68) & (body.centers[:, 2] - CURB_HEIGHT_M < 0.78)
    albedo = np.where(band[:, None], 0.6, body.albedo)
    return Quads.of(body.corners, albedo, Label.FURNITURE, spread=body.spread, gloss=0.05)


def _bin(x: float, y: float) -> Quads:
    z = np.array([0.05, 0.12, 0.3, 0.5, 0.7, 0.82, 0.9, 0.97, 1.0])
    radii = np.array([0.2, 0.22, 0.23, 0.235, 0.24, 0.25, 0.25, 0.18, 0.01])
    path = np.stack([np.full_like(z, x), np.full_like(z, y), CURB_HEIGHT_M + z], axis=1)
    body = tube(path, radii, (0.035, 0.085, 0.05), Label.FURNITURE, sides=14, gloss=0.05)
    towards_road = (body.centers[:, 1] - y) * np.sign(y) < 0
    slot = towards_road & (np.abs(body.centers[:, 2] - CURB_HEIGHT_M - 0.76) < 0.06)
    return body.tinted(np.where(slot, 0.25, 1.0)[:, None])


# Sky
# A dome with a blue-to-pale gradient and soft clouds.

RADIUS_M = 900.0
SKY_SPREAD = 0.8
"""Wider than elsewhere, to blend neighboring cells of sky."""
_SKY_SHIFT = 0.8  # upwards, in cells: higher ones are nearer along the view and cover lower ones


def build_sky(layout: StreetLayout) -> Quads:
    """Build the dome around the middle of the street, from just below the horizon to the zenith."""
    p = layout.parameters
    azimuth = np.radians(np.linspace(0, 360, 361))
    elevation = np.radians(np.concatenate([np.arange(-8, 32, 0.8), np.linspace(33, 56, 16), np.linspace(60, 90, 8)]))
    level = np.cos(elevation)
    x, y = level * np.cos(azimuth)[:, None], level * np.sin(azimuth)[:, None]
    points = (RADIUS_M + longer_by_m(layout)) * np.stack(np.broadcast_arrays(x, y, np.sin(elevation)), axis=2)
    dome = patch(points[::-1], 1.0, Label.SKY, closed=True)
    middle = (0.5 * (p.start_x_m + p.end_x_m), 0.0, 0.0)
    sky = Quads.of(dome.corners, 1.0, Label.SKY, normals=dome.normals, opacity=0.995, spread=SKY_SPREAD)
    return replace(sky, shift=np.full_like(sky.shift, [0, _SKY_SHIFT])).placed(middle)
