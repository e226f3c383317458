"""Refinement of a recolored scene with torch: training of all parameters, and photometric steps on colors alone."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from ..fast_math import harmonics
from ..render.autodiff.differentiable import render_gaussians
from ..render.cpu.projection import view_directions
from ..scene.gaussians import Gaussians
from ..scene.geometry import quaternions_from_matrices
from ..scene.progress import Progress
from ..scene.scene import DrawItem
from ..training.losses import d_ssim, l1
from ..training.parameters import FIRST_DECAY, SECOND_DECAY, SplatParameters, adam_step, rotate_quaternions
from .problem import ColorProblem, ProblemView, Solution
from .solver import Harmonics, SolverStep, add_colors_transposed, evaluate_colors

torch: Any = import_module("torch")
Tensor = Any

RATES = {
    "means": 1.6e-5, "log_scales": 1e-3, "quaternions": 2e-4, "opacity_logits": 5e-3, "sh_dc": 2.5e-3,
    "sh_rest": 2.5e-3 / 20,
}  # fmt: skip
"""A tenth to a fifth of the 3DGS rates for the geometry, which is already accurate; means scale with the scene size."""


@dataclass(frozen=True, slots=True, eq=False)
class _TrainedMember:
    """One visible part with its trainable Gaussians."""

    part: DrawItem
    parameters: SplatParameters

    def activated(self, view: ProblemView) -> tuple[Tensor, ...]:
        """Means, scales, quaternions, opacities and colors in the world, without what is left out."""
        own, left_out = self.parameters, self.part.left_out
        rows = torch.from_numpy((~left_out).indices.astype(np.int64)) if left_out else slice(None)
        scale = float(np.cbrt(np.linalg.det(self.part.to_world[:3, :3])))
        matrix = torch.as_tensor(self.part.to_world, dtype=torch.float32)
        turn = quaternions_from_matrices(self.part.to_world[:3, :3] / scale)
        means = own.tensors["means"] @ matrix[:3, :3].T + matrix[:3, 3]
        quaternions = rotate_quaternions(turn, own.tensors["quaternions"])
        opacities = own.opacities * self.part.opacity
        return tuple(each[rows] for each in (means, own.scales * scale, quaternions, opacities, self._colors(view)))

    def _colors(self, view: ProblemView) -> Tensor:
        """Display colors; view directions count as fixed, since a step barely changes them."""
        means = self.parameters.tensors["means"].detach().numpy()
        g = self.part.gaussians
        now = self.part._replace(gaussians=Gaussians(means, g.scales, g.quaternions, g.opacities, g.sh))
        directions = view_directions([now], view.observed.target.camera, np.arange(len(means)))
        basis = torch.from_numpy(harmonics(directions, g.sh.shape[1]))
        return 0.5 + torch.einsum("nk,nkc->nc", basis, self.parameters.sh)


def refine(
    members: dict[str, Gaussians], views: Sequence[ProblemView], solution: Solution, steps: int, size_m: float,
    seed: int = 0,
) -> Generator[Progress, None, dict[str, Gaussians]]:  # fmt: skip
    """Train all parameters of members (recolored Gaussians by key) on the views, one a step, in a scene of `size_m`."""
    trained = {key: SplatParameters.from_gaussians(each, each.sh_degree) for key, each in members.items()}
    order = _trusted_views(solution, seed)
    rates = RATES | {"means": RATES["means"] * size_m}
    for step in range(steps):
        yield Progress(step / steps, f"Refining, step {step + 1} of {steps}")
        index = next(order)
        view = views[index]
        visible = view.observed.visible
        parts = [_TrainedMember(p, trained[m.key]) for m, p in zip(visible.members, visible.parts, strict=True)]
        pieces = zip(*(each.activated(view) for each in parts), strict=True)
        means, scales, quaternions, opacities, colors = (torch.cat(each) for each in pieces)
        camera = view.observed.target.camera
        rendered = render_gaussians(means, scales, quaternions, opacities, colors, camera)
        target = torch.from_numpy(solution.affines[index].undone(view.observed.target.image))
        target = target * rendered.alpha.detach()[..., None]
        mask = torch.from_numpy(view.observed.counted)
        loss = (1 - D_SSIM_SHARE) * l1(rendered.color, target, mask)
        (loss + D_SSIM_SHARE * d_ssim(rendered.color, target, mask)).backward()
        for moving in parts:
            moving.parameters.step(rates)
            moving.parameters.zero_grad()
    return {key: each.to_gaussians() for key, each in trained.items()}


def _trusted_views(solution: Solution, seed: int) -> Iterator[int]:
    """Indices of the views that agree with the others, forever, in a new order each time round."""
    chosen, random = np.flatnonzero(solution.trust > 0.1), np.random.default_rng(seed)
    while len(chosen):
        yield from random.permutation(chosen).tolist()


# Photometric refinement of colors

D_SSIM_SHARE = 0.2  # of the loss, as in 3DGS (Kerbl et al. 2023, eq. 7)
RATE, DIRECTIONAL_RATE = 2.5e-3, 2.5e-3 / 20  # for degree 0, and for higher degrees (3DGS)


def photometric_refine(
    problem: ColorProblem, solution: Solution, steps: int, sh_degree: int = 3, seed: int = 0
) -> Generator[SolverStep, None, Harmonics]:
    """Continue from a solution by Adam, one view per step, with the stored weights and without rasterization.

    Unlike least squares it models the renderers' clipping of colors at 0. Trust and exposures of views are unchanged.
    Yields the loss and the current change from the prior; returns the harmonics.
    """
    sh = solution.sh.copy()
    n, k = sh.shape[:2]
    moments = np.zeros((2, n, 3 * k), np.float32)
    gradient = np.zeros_like(sh)
    order = _trusted_views(solution, seed)
    for step in range(1, steps + 1):
        index = next(order)
        gradient[:] = 0
        loss = _descend(problem.views[index], solution, index, sh, gradient)
        gradient[:, (sh_degree + 1) ** 2 :] = 0
        shares = 1 - FIRST_DECAY**step, 1 - SECOND_DECAY**step
        four = (sh.reshape(n, -1), gradient.reshape(n, -1), *moments)
        for own, rate in ((slice(0, 3), RATE), (slice(3, 3 * k), DIRECTIONAL_RATE)):
            values, slope, first, second = (each[:, own] for each in four)
            adam_step(values, slope, first, second, np.zeros(0, np.bool_), rate, shares[0], shares[1])
        yield SolverStep(loss, sh - problem.prior)
    return sh


def _descend(
    view: ProblemView, solution: Solution, index: int, sh: Harmonics,
    gradient: Harmonics,
) -> float:  # fmt: skip
    """Add one view's gradient with respect to the harmonics; return its loss."""
    observed = view.observed
    colors = np.float32(0.5) + evaluate_colors(sh, view.indices, view.basis)
    image = torch.from_numpy(observed.weights.blend(np.maximum(colors, np.float32(0)))).requires_grad_()
    target = torch.from_numpy(solution.affines[index].undone(observed.target.image) * observed.alpha[..., None])
    mask = torch.from_numpy(observed.counted)
    loss = (1 - D_SSIM_SHARE) * l1(image, target, mask) + D_SSIM_SHARE * d_ssim(image, target, mask)
    loss.backward()
    gathered = observed.weights.accumulate(np.ascontiguousarray(image.grad.numpy()))
    add_colors_transposed(gradient, view.indices, view.basis, np.where(colors > 0, gathered, np.float32(0)))
    return float(loss.detach())
