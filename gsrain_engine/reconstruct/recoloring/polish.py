"""After least squares: a few steps for what the eye sees, absolute differences and structure (torch)."""

from collections.abc import Generator
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float32

from ..parameters.adam_kernel import FIRST_DECAY, SECOND_DECAY, adam_step
from ..training.losses import d_ssim, l1
from .problem import ColorProblem, ProblemView, Solution
from .solver import Step, add_seen, colors_seen

torch: Any = import_module("torch")

D_SSIM_SHARE = 0.2
"""Of the loss, as in 3DGS (Kerbl et al. 2023, eq. 7)."""

RATE, DIRECTIONAL_RATE = 2.5e-3, 2.5e-3 / 20
"""Of degree 0, and of what is above (3DGS)."""


def polish(
    problem: ColorProblem, solution: Solution, steps: int, sh_degree: int = 3, seed: int = 0
) -> Generator[Step, None, Float32[np.ndarray, "n k 3"]]:
    """Go on from a solution by Adam, a view a step, with the stored weights: nothing is rasterized anew.

    Unlike least squares it knows that renderers cut colours below 0. Trust in views and their exposures stay.

    Yields:
        The loss, and the change from the prior so far.

    Returns:
        The harmonics.
    """
    sh = solution.sh.copy()
    n, k = sh.shape[:2]
    moments = np.zeros((2, n, 3 * k), np.float32)
    gradient = np.zeros_like(sh)
    chosen = np.flatnonzero(solution.trust > 0.1)
    order, turns = np.random.default_rng(seed), np.zeros(0, np.int64)
    for step in range(1, steps + 1):
        if not len(turns):
            turns = order.permutation(chosen)
        index, turns = int(turns[0]), turns[1:]
        gradient[:] = 0
        loss = _descend(problem.views[index], solution, index, sh, gradient)
        gradient[:, (sh_degree + 1) ** 2 :] = 0
        shares = 1 - FIRST_DECAY**step, 1 - SECOND_DECAY**step
        four = (sh.reshape(n, -1), gradient.reshape(n, -1), *moments)
        for own, rate in ((slice(0, 3), RATE), (slice(3, 3 * k), DIRECTIONAL_RATE)):
            values, slope, first, second = (each[:, own] for each in four)
            adam_step(values, slope, first, second, np.zeros(0, np.bool_), rate, shares[0], shares[1])
        yield Step(loss, sh - problem.prior)
    return sh


def _descend(
    view: ProblemView, solution: Solution, index: int, sh: Float32[np.ndarray, "n k 3"],
    gradient: Float32[np.ndarray, "n k 3"],
) -> float:  # fmt: skip
    """Add one view's gradient by the harmonics; return its loss."""
    seen = view.seen
    colors = np.float32(0.5) + colors_seen(sh, view.indices, view.basis)
    image = torch.from_numpy(seen.weights.blend(np.maximum(colors, np.float32(0)))).requires_grad_()
    wanted = torch.from_numpy(solution.affines[index].undone(seen.target.image) * seen.alpha[..., None])
    mask = torch.from_numpy(seen.counted)
    loss = (1 - D_SSIM_SHARE) * l1(image, wanted, mask) + D_SSIM_SHARE * d_ssim(image, wanted, mask)
    loss.backward()
    gathered = seen.weights.accumulate(np.ascontiguousarray(image.grad.numpy()))
    add_seen(gradient, view.indices, view.basis, np.where(colors > 0, gathered, np.float32(0)))
    return float(loss.detach())
