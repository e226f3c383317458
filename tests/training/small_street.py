"""A street of a few thousand Gaussians: road, walls, sky, a car, an ego track and a rig."""

import numpy as np

from gsrain_engine.scene.gaussians import Gaussians, sh_from_color
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, RigCamera, Scene

# Camera axes (x right, y down, z forward) in the ego frame (x forward, y left, z up).
FORWARD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
LEFT = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def flat_patch(
    corner: tuple[float, float, float], along: tuple[float, float, float], across: tuple[float, float, float],
    color: tuple[float, float, float], spacing: float, degree: int = 0,
) -> Gaussians:  # fmt: skip
    """Cover a parallelogram with opaque round Gaussians in slightly varying colors."""
    corner, along, across = (np.asarray(each, float) for each in (corner, along, across))
    rows, columns = (max(1, int(np.linalg.norm(each) / spacing)) for each in (along, across))
    a, b = (each.ravel() for each in np.meshgrid(np.arange(rows) / rows, np.arange(columns) / columns))
    means = corner + a[:, None] * along + b[:, None] * across
    count = len(means)
    colors = np.clip(np.asarray(color) + np.random.default_rng(0).normal(0, 0.03, (count, 1)), 0, 1)
    sh = np.zeros((count, (degree + 1) ** 2, 3), np.float32)
    sh[:, :1] = sh_from_color(colors.astype(np.float32))
    return Gaussians(
        means.astype(np.float32), np.full((count, 3), 0.6 * spacing, np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)), np.full(count, 0.95, np.float32), sh,
    )  # fmt: skip


def still_track(*positions: tuple[float, float, float]) -> PoseTrack:
    count = len(positions)
    return PoseTrack(
        np.arange(count, dtype=float), np.array(positions, float), np.tile([1.0, 0, 0, 0], (count, 1)),
        np.ones(count, bool),
    )  # fmt: skip


def small_street(degree: int = 1) -> Scene:
    road = flat_patch((-5, -5, 0), (45, 0, 0), (0, 10, 0), (0.55, 0.52, 0.5), 0.35, degree)
    walls = [flat_patch((-5, y, 0.5), (45, 0, 0), (0, 0, 6), (0.75, 0.6, 0.45), 0.5, degree) for y in (-5, 5)]
    sky = flat_patch((60, -80, -5), (0, 160, 0), (0, 0, 60), (0.4, 0.6, 0.95), 3.0)
    unseen = flat_patch((-60, -5, 0), (10, 0, 0), (0, 10, 0), (0.55, 0.52, 0.5), 1.0, degree)
    car = flat_patch((-0.2, -0.9, 0.2), (0, 1.8, 0), (0, 0, 1.4), (0.8, 0.1, 0.1), 0.15)
    rig = tuple(
        RigCamera(name, 96, 64, 60, 60, 48, 32, pose, 0.004) for name, pose in (("front", FORWARD), ("left", LEFT))
    )
    return Scene(
        "small street",
        (
            Layer("street", Gaussians.concatenate([road, *walls, unseen])),
            Layer("sky", sky, kind="sky"),
            Layer("hidden", unseen, visible=False),
        ),
        (Actor("car 1", "car", (4.0, 1.8, 1.5), car, still_track((14, 1, 0))),),
        ground_m=0.0,
        rigs={"test": rig},
        ego=still_track((0, 0, 1.5), (6, 0, 1.5)),
    )
