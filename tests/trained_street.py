"""A scene with a car and values as trainings keep them, for stand-ins of their files; pictures to compare them by."""

import numpy as np
import torch

from gsrain_engine.evaluation.image_metrics import psnr
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.scene import Actor, Layer, PoseTrack, Scene
from rasterized import rasterize
from small_scene import patch
from tests.scene.formats.sample_files import sample_gaussians

RATE, FRAMES, PRESENT = 10.0, 6, slice(1, 5)
LENGTH, WIDTH, HEIGHT = 4.0, 1.8, 1.5
CAR = "RigidNodes_1"


def street() -> Scene:
    """Road and wall with harmonics, and a car that drives and turns in frames 1 to 4; z up, meters."""
    road = patch((0, -6, 0), np.array([40.0, 0, 0]), np.array([0, 12.0, 0]), 20, (0.35, 0.33, 0.30))
    rough = sample_gaussians(300)
    rough = Gaussians(rough.means + np.float32([20, 0, 6]), *rough.arrays[1:])
    road = Gaussians(*road.arrays[:4], np.concatenate([road.sh, np.zeros((len(road), 15, 3), np.float32)], axis=1))
    body = sample_gaussians(200, seed=3)
    means = np.random.default_rng(3).uniform(-0.5, 0.5, (200, 3)) * (LENGTH, WIDTH, HEIGHT) + (0, 0, HEIGHT / 2)
    body = Gaussians(means.astype(np.float32), np.minimum(body.scales, np.float32(0.2)), *body.arrays[2:])
    times = np.arange(FRAMES)[PRESENT] / RATE
    half = 0.05 * np.arange(len(times))
    turns = np.stack([np.cos(half), np.zeros(4), np.zeros(4), np.sin(half)], axis=1)
    valid = np.array([True, True, True, False])
    track = PoseTrack(times, np.stack([8 + 10 * times, -1 + times, 0 * times], axis=1), turns, valid)
    layers = (Layer("background", Gaussians.concatenate([road, rough])),)
    return Scene("street", layers, (Actor(CAR, "car", (LENGTH, WIDTH, HEIGHT), body, track),))


def raw(gaussians: Gaussians) -> dict[str, torch.Tensor]:
    """Parameters before activation, by gsplat's names; quaternions of any length."""
    opacities = torch.as_tensor(gaussians.opacities).double().clamp(1e-7, 1 - 1e-7)
    sh = torch.as_tensor(gaussians.sh)
    return {
        "means": torch.as_tensor(gaussians.means),
        "scales": torch.as_tensor(gaussians.scales).log(),
        "quats": 3 * torch.as_tensor(gaussians.quaternions),
        "opacities": torch.logit(opacities).float(),
        "sh0": sh[:, :1],
        "shN": sh[:, 1:],
    }


def at_center(actor: Actor) -> Gaussians:
    """Gaussians of an actor in a frame whose origin is the center of its box."""
    down = np.float32([0, 0, actor.size_lwh[2] / 2])
    return Gaussians(actor.gaussians.means - down, *actor.gaussians.arrays[1:])


def centers(actor: Actor, frames: int = FRAMES) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Centers of the box and quaternions in all frames, and in which of them the actor is present."""
    positions, turns = torch.zeros(frames, 3), torch.zeros(frames, 4)
    turns[:, 0] = 1
    present = torch.zeros(frames, dtype=torch.bool)
    rows = torch.as_tensor(np.rint(actor.track.times * RATE).astype(np.int64))
    up = np.array([0, 0, actor.size_lwh[2] / 2])  # turns are about z
    positions[rows] = torch.as_tensor(actor.track.positions + up).float()
    turns[rows] = torch.as_tensor(actor.track.quaternions_wxyz).float()
    present[rows] = True
    return positions, turns, present


# Skies


FACES = torch.tensor(
    [[0.9, 0.1, 0.1], [0.1, 0.9, 0.1], [0.1, 0.1, 0.9], [0.9, 0.9, 0.1], [0.1, 0.9, 0.9], [0.9, 0.1, 0.9]]
)
"""Colors of the faces +x, -x, +y, -y, +z, -z of a cubemap."""


def cubemap(size: int = 8) -> torch.Tensor:
    return FACES[:, None, None].repeat(1, size, size, 1)


# Pictures

UP = np.array([0.0, 0, 1])


def assert_same_picture(
    found: Scene, expected: Scene, times: tuple[float, ...] = (0.0,), least_db: float = 50.0
) -> None:
    """Assert that scenes look the same in the world, but for the sky."""
    camera = Camera.from_fov(240, 160, 60.0, look_at(np.array([0.0, -3, 4]), np.array([12.0, 0, 1]), UP))
    for time_s in times:
        pictures = []
        for scene in (found, expected):
            layers = {f"layers/{each.name}": {"visible": each.kind != "sky"} for each in scene.layers}
            for key, fields in layers.items():
                scene = scene.with_member(key, **fields)
            rgba = rasterize(scene.parts(time_s), camera).rgba
            pictures.append(np.clip(rgba[..., :3], 0, 1))
        assert pictures[1].std() > 0.02
        assert psnr(*pictures) >= least_db


def colors_towards(scene: Scene, *directions: tuple[float, float, float]) -> np.ndarray:
    """Display colors of the sky's Gaussians nearest to directions of the scene."""
    (sky,) = (each for each in scene.layers if each.kind == "sky")
    center = sky.gaussians.means.mean(axis=0)
    away = sky.gaussians.means - center
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    nearest = (away @ np.array(directions, np.float32).T).argmax(axis=0)
    return sky.gaussians.sh[nearest, 0] * SH_C0 + 0.5


def without_car(scene: Scene) -> Scene:
    return scene.with_member(f"actors/{CAR}", visible=False)
