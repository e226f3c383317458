"""Small scenes as tensors, for the tests of differentiable rendering."""

import numpy as np
import torch

from gsrain_engine.render.autodiff.differentiable import render_gaussians
from gsrain_engine.scene.camera import Camera, look_at
from render.cpu.raster_scenes import random_gaussians, small_camera

NAMES = ("means", "scales", "quaternions", "opacities", "colors", "world_to_camera")


def camera(width: int = 40, height: int = 30) -> Camera:
    """Look along +z from beside the origin, turned in every axis."""
    pose = look_at(np.array([0.1, 0.05, -0.2]), np.array([0.2, 0.1, 5.0]), np.array([0.1, -1, 0]))
    base = small_camera(width, height)
    return Camera(width, height, base.fx, base.fy, base.cx, base.cy, pose)


def tensors(count: int, seed: int = 0, degree: int = 3, dtype: torch.dtype = torch.float64) -> dict[str, torch.Tensor]:
    """Gaussians and a pose that want gradients; the quaternions are not unit ones."""
    g = random_gaussians(count, seed, degree)
    arrays = (g.means, g.scales, 1.7 * g.quaternions, g.opacities, g.sh, camera().world_to_camera)
    values = zip(NAMES, arrays, strict=True)
    return {name: torch.from_numpy(each.astype(np.float64)).to(dtype).requires_grad_() for name, each in values}


def display(values: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The same Gaussians with display colors, some of them negative."""
    return {**values, "colors": (values["colors"][:, 0] + 0.3).detach().requires_grad_()}


def with_values(values: dict[str, torch.Tensor], **others: torch.Tensor) -> dict[str, torch.Tensor]:
    """The same Gaussians but for some tensors."""
    changed = {name: others.get(name, each).detach().clone().requires_grad_() for name, each in values.items()}
    assert others.keys() <= values.keys()
    return changed


def rendered(values: dict[str, torch.Tensor], view: Camera | None = None) -> tuple[torch.Tensor, ...]:
    """Color, alpha and depth from the fast kernels."""
    r = render_gaussians(*(values[name] for name in NAMES[:5]), view or camera(), world_to_camera=values[NAMES[5]])
    return r.color, r.alpha, r.depth


def gradients(outputs: tuple[torch.Tensor, ...], values: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Gradients of a loss that weighs every number of the picture at random."""
    r = np.random.default_rng(1)
    loss = sum((each.double() * torch.from_numpy(r.normal(size=tuple(each.shape)))).sum() for each in outputs)
    found = torch.autograd.grad(loss, list(values.values()))
    return dict(zip(values, found, strict=True))
