"""Stand-in for `gsplat.rasterization`, computed by our own kernels on the CPU."""

import numpy as np
import torch

from gsrain_engine.render.cpu.compositing import composite
from gsrain_engine.render.cpu.projection import project
from gsrain_engine.render.cpu.tiles import bin_into_tiles
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem


def rasterization(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmats,
    Ks,
    width,
    height,
    near_plane=0.01,
    far_plane=1e10,
    radius_clip=0.0,
    eps2d=0.3,
    sh_degree=None,
):
    """One camera, colors of any number of channels, packed results: what our renderer uses of gsplat 1.5."""
    n = len(means)
    assert n > 0
    assert means.shape == scales.shape == (n, 3)
    assert quats.shape == (n, 4)
    assert opacities.shape == (n,)
    assert colors.shape[0] == n
    assert viewmats.shape == (1, 4, 4)
    assert Ks.shape == (1, 3, 3)
    assert {each.dtype for each in (means, quats, scales, opacities, colors, viewmats, Ks)} == {torch.float32}
    assert (near_plane, far_plane, radius_clip, eps2d, sh_degree) == (0.2, 1e10, 0.0, 0.3, None)
    numbers = [each.numpy() for each in (means, scales, quats, opacities)]
    gaussians = Gaussians(*numbers, np.zeros((n, 1, 3), np.float32))
    (fx, _, cx), (_, fy, cy), _ = Ks[0].tolist()
    camera = Camera(width, height, fx, fy, cx, cy, viewmats[0].numpy().astype(np.float64))
    splats = project([DrawItem(gaussians, np.eye(4))], camera)
    order = splats.nearest_first()
    tiles = bin_into_tiles(splats.shapes, order, width, height)
    channels = np.zeros((len(splats), -(-colors.shape[1] // 4) * 4), np.float32)
    channels[:, : colors.shape[1]] = colors.numpy()[splats.indices]
    images = []
    alpha = np.zeros((height, width, 1), np.float32)
    for first in range(0, channels.shape[1], 4):
        rgba, fourth = composite(splats.shapes, np.ascontiguousarray(channels[:, first : first + 4]), tiles)
        images += [rgba[..., :3], fourth[..., None]]
        alpha = rgba[..., 3:]
    image = np.concatenate(images, axis=-1)[..., : colors.shape[1]]
    radii = torch.ones((len(order), 2), dtype=torch.int32)
    return torch.from_numpy(image)[None], torch.from_numpy(alpha.copy())[None], {"radii": radii}
