"""A training of a few Gaussians on two tiny views, with all that a step may use: masks, depth, sky, an actor, maps."""

import numpy as np

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Actor, PoseTrack
from gsrain_engine.training.data import PyramidLevel, TrainingView
from gsrain_engine.training.free_space import FreeSpaceCarving
from gsrain_engine.training.mcmc import MCMCSettings, MCMCStrategy
from gsrain_engine.training.model import SplatModel
from gsrain_engine.training.parameters import SplatParameters
from gsrain_engine.training.schedule import TrainingSchedule
from gsrain_engine.training.settings import TrainingSettings
from gsrain_engine.training.step import Trainer
from gsrain_engine.training.strategy import DefaultStrategy, DefaultStrategySettings, Strategy

from .random_splats import random_splats

WIDTH, HEIGHT, STEPS = 32, 24, 200


def tiny_training(device: str, density: str = "adaptive", background: int = 40) -> Trainer:
    """Make the same training on any device: gaussians in a unit ball, seen from 3 m, before a sky."""
    views, random = [], np.random.default_rng(0)
    for x in (-0.5, 0.5):
        camera = Camera.from_fov(
            WIDTH, HEIGHT, 50.0, look_at(np.array([x, 0, -3.0]), np.zeros(3), np.array([0.0, -1, 0]))
        )
        image = random.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        mask, sky, depth = np.ones((HEIGHT, WIDTH), bool), np.zeros((HEIGHT, WIDTH), bool), np.zeros((HEIGHT, WIDTH))
        mask[:2], sky[:5], depth[10::3, ::3] = False, True, 3.0
        level = PyramidLevel(camera, image, mask, depth.astype(np.float32), sky)
        views.append(TrainingView(f"view {x}", 0.5, None, (level,) * 3))
    sky = random_splats(12, 0, 2)
    sky = Gaussians(5 * sky.means + np.float32([0, 0, 30]), 60 * sky.scales, sky.quaternions, sky.opacities, sky.sh)
    poses = np.tile([0.2, 0.1, 0.0], (2, 1)), np.tile([1.0, 0, 0, 0], (2, 1))
    van = Actor(
        "van", "car", (1.0, 1, 1), random_splats(8, 0, 3), PoseTrack(np.array([0.0, 1.0]), *poses, np.ones(2, bool))
    )
    own = random_splats(background, 1)
    own = Gaussians(own.means, 3 * own.scales, own.quaternions, own.opacities, own.sh)
    model = SplatModel(
        SplatParameters.from_gaussians(own, 1, device), SplatParameters.from_gaussians(sky, 0, device),
        {"van": SplatParameters.from_gaussians(van.gaussians, 0, device)}, {"van": van},
    )  # fmt: skip
    settings = TrainingSettings(steps=STEPS, coarse=0.0, transients=0.1, sh_degree=1)
    schedule = TrainingSchedule(settings, 1.0)
    control: Strategy = MCMCStrategy(
        MCMCSettings(max_count=60, means_rate=lambda step: 1e-3, first_step=0, every=50, noise=1.0)
    )
    if density == "adaptive":
        control = DefaultStrategy(DefaultStrategySettings(extent=1.0, max_count=60, first_step=0, every=50))
    depths = [view.levels[0].depth for view in views]
    trajectory = np.array([view.levels[0].camera.position for view in views])
    free = FreeSpaceCarving.of([view.levels[0].camera for view in views], depths, trajectory, 0.2)
    return Trainer(model, views, schedule, control, device, free)
