"""Stand-in for gsplat's `rasterization` and `spherical_harmonics`, differentiable, by torch, and for its Adam."""

import torch

from gsrain_engine.scene.camera import Camera
from oracles.dense_gradients import ALPHA_CUT, alphas_of, display_colors, in_image, sh_basis, weights_of


def rasterization(
    means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane=0.01, far_plane=1e10, eps2d=0.3,
    sh_degree=None, packed=True, render_mode="RGB",
):  # fmt: skip
    """One camera, colors of any number of channels, accumulated depth: what we use of gsplat 1.5."""
    n = len(means)
    assert n > 0
    assert means.shape == scales.shape == (n, 3)
    assert quats.shape == (n, 4)
    assert opacities.shape == (n,)
    assert colors.shape[0] == n
    assert colors.shape[1:] == ((sh_degree + 1) ** 2, 3) if sh_degree is not None else colors.ndim == 2
    assert viewmats.shape == (1, 4, 4)
    assert Ks.shape == (1, 3, 3)
    assert {each.dtype for each in (means, quats, scales, opacities, colors, viewmats, Ks)} == {torch.float32}
    culled = ~(opacities >= ALPHA_CUT)[:, None]  # before anything is read of them
    means, scales, opacities = (torch.where(culled, 0, each) for each in (means, scales, opacities[:, None]))
    quats, opacities = torch.where(culled, torch.eye(1, 4), quats), opacities[:, 0]
    colors = torch.where(culled.reshape(-1, *[1] * (colors.ndim - 1)), 0, colors)
    assert all(torch.isfinite(each).all() for each in (means, quats, scales, opacities, colors))
    assert (near_plane, far_plane, eps2d) == (0.2, 1e10, 0.3)
    (fx, _, cx), (_, fy, cy), _ = Ks[0].tolist()
    camera = Camera(width, height, fx, fy, cx, cy)
    pose = viewmats[0]
    before_camera = means @ pose[:3, :3].T + pose[:3, 3]
    seen = before_camera[:, 2] > near_plane
    before_camera = torch.where(seen[:, None], before_camera, torch.ones_like(before_camera))
    means2d, covariances = in_image(before_camera, scales, quats, pose, camera)
    means2d = means2d[None] + 0  # a tensor of its own between projection and picture, as in gsplat
    near = seen & may_reach(means2d[0].detach(), covariances.detach(), opacities.detach(), camera)
    order = torch.argsort(before_camera[:, 2].detach(), stable=True)
    order = order[near[order]] if near.any() else order[:1]
    alphas = alphas_of(means2d[0, order], covariances[order], opacities[order], camera) * seen[order, None, None]
    channels = display_colors(means, colors, pose)
    if render_mode == "RGB+D":
        channels = torch.cat([channels, before_camera[:, 2:]], dim=1)
    weights = weights_of(alphas)
    image = torch.einsum("nhw,nc->hwc", weights, channels[order])
    drawn = torch.zeros(n, dtype=torch.bool).index_put((order,), (alphas > 0).any(dim=(1, 2)))
    inverse = torch.linalg.inv(covariances)
    found = {
        "means2d": means2d,
        "radii": torch.where(drawn, 5, 0).int()[None, :, None].expand(-1, -1, 2),
        "conics": torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], dim=1)[None]
        * drawn[None, :, None],
    }
    return image[None], weights.sum(dim=0)[None, ..., None], found


def spherical_harmonics(degrees_to_use, dirs, coeffs, masks=None):
    """Colors (n, 3) of harmonics in directions of any length, without 3DGS's 0.5; not a number where masked."""
    assert coeffs.shape == (len(dirs), (degrees_to_use + 1) ** 2, 3)
    assert masks.shape == dirs.shape[:1] and masks.dtype == torch.bool and masks.is_contiguous()
    coeffs = torch.where(masks[:, None, None], coeffs, 0)
    dirs = torch.where(masks[:, None], dirs, torch.ones(3)) if degrees_to_use else torch.ones_like(dirs)
    basis = sh_basis(dirs / dirs.norm(dim=1, keepdim=True))[:, : coeffs.shape[1]]
    return torch.where(masks[:, None], torch.einsum("nk,nkc->nc", basis, coeffs), torch.nan)


def may_reach(centers, covariances, opacities, camera):
    """Mask of Gaussians that may be above the least alpha at some pixel, by the boxes of their ellipses."""
    reach = torch.sqrt(2 * torch.log(torch.clamp(opacities / ALPHA_CUT, min=1))) + 0.1
    half = reach[:, None] * torch.sqrt(torch.diagonal(covariances, dim1=1, dim2=2))
    size = torch.tensor([camera.width, camera.height])
    return ((centers + half >= 0) & (centers - half <= size)).all(dim=1)


def adam(param, param_grad, exp_avg, exp_avg_sq, valid, lr, b1, b2, eps):
    """Adam of some rows without bias corrections: `gsplat.cuda._wrapper.adam` of gsplat 1.5."""
    assert {each.dtype for each in (param, param_grad, exp_avg, exp_avg_sq)} == {torch.float32}
    assert all(each.is_contiguous() for each in (param, param_grad, exp_avg, exp_avg_sq, valid))
    assert valid.shape == param.shape[:1] and valid.dtype == torch.bool
    rows = valid.reshape(-1, *[1] * (param.ndim - 1))
    first, second = b1 * exp_avg + (1 - b1) * param_grad, b2 * exp_avg_sq + (1 - b2) * param_grad * param_grad
    moved = param - lr * first / (torch.sqrt(second) + eps)
    for target, values in ((param, moved), (exp_avg, first), (exp_avg_sq, second)):
        target.copy_(torch.where(rows, values, target))
