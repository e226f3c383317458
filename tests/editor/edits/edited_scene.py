"""A scene with everything that edits meet: SH, an actor, a similarity, marks, its own units and axes."""

from dataclasses import replace

import numpy as np

from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Actor, ColorGrading, Layer, PoseTrack, Scene
from gsrain_engine.scene.transforms import flatten_scene


def some_gaussians(seed, count=40, degree=1):
    random, f = np.random.default_rng(seed), np.float32
    quaternions = random.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return Gaussians(
        random.uniform(-2, 2, (count, 3)).astype(f),
        random.uniform(0.05, 0.3, (count, 3)).astype(f),
        quaternions.astype(f),
        random.uniform(0.2, 1, count).astype(f),
        random.normal(0, 0.4, (count, (degree + 1) ** 2, 3)).astype(f),
    )


def turned(degrees, axis=2, scale=1.0, by=(0.0, 0.0, 0.0)):
    """Similarity: a turn about an axis, a scale, a shift."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    matrix[:3, :3] *= scale
    matrix[:3, 3] = by
    return matrix


def driving():
    times = np.linspace(0, 4, 5)
    return PoseTrack(times, np.stack([times, 0 * times, 0 * times], axis=1), np.tile([1.0, 0, 0, 0], (5, 1)),
                 np.ones(5, bool))  # fmt: skip


def edited_scene():
    """Half a metre a unit, y down; two layers of unlike opacity and grading, a sky, a car."""
    ground = Layer("ground", some_gaussians(1), to_scene=turned(20, 1, 1.5, (1.0, 2.0, 3.0)))
    house = Layer("house", some_gaussians(2, 30, 2), opacity=0.5, grading=ColorGrading(exposure_ev=0.5, contrast=1.2))
    sky = Layer("sky", some_gaussians(3, 20), kind="sky")
    car = Actor("car", "car", (4.0, 2.0, 1.5), some_gaussians(4, 25), driving())
    return Scene("edited", (ground, house, sky), (car,), metres_per_unit=0.5, up=(0.0, -1.0, 0.0), ground_m=-1.0)


def with_selection(scene, **first):
    """Select the first few Gaussians of members, by the name of the member."""
    for member in scene.members:
        if member.name in first:
            count = len(member.gaussians)
            mask = BitMask.of(np.arange(count) < first[member.name])
            scene = scene.with_member(member.key, marks=replace(member.marks, selected=mask))
    return scene


def without(scene, *names):
    """Return the scene without members."""
    return replace(
        scene,
        layers=tuple(each for each in scene.layers if each.name not in names),
        actors=tuple(each for each in scene.actors if each.name not in names),
    )


def flattened(scene, time_s=0.0):
    """All visible Gaussians in the world, in an order that does not depend on that of the members."""
    every = flatten_scene(scene, time_s)
    order = np.lexsort(np.round(every.means.T, 3))
    return every.take(order)


def assert_same(first, second, tolerance=2e-5):
    """Gaussians that look the same; q and -q are the same turn."""
    assert len(first) == len(second)
    k = min(first.sh.shape[1], second.sh.shape[1])
    np.testing.assert_allclose(first.means, second.means, atol=tolerance)
    np.testing.assert_allclose(first.scales, second.scales, atol=tolerance)
    np.testing.assert_allclose(np.abs((first.quaternions * second.quaternions).sum(axis=1)), 1, atol=tolerance)
    np.testing.assert_allclose(first.opacities, second.opacities, atol=tolerance)
    np.testing.assert_allclose(first.sh[:, :k], second.sh[:, :k], atol=20 * tolerance)
    assert not first.sh[:, k:].any()
    assert not second.sh[:, k:].any()
