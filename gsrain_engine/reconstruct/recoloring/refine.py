"""After colours: all parameters of a recoloured scene move a little towards the pictures (torch)."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from gsrain_engine.raster.differentiable import Rendered, render_gaussians
from gsrain_engine.raster.projection import view_directions
from gsrain_engine.raster.spherical_harmonics import harmonics
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.members import Part
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.rotations import quaternions_from_matrices

from ..parameters.splat_parameters import SplatParameters
from ..training.losses import d_ssim, l1
from .polish import D_SSIM_SHARE
from .problem import ProblemView, Solution

torch: Any = import_module("torch")

Tensor = Any

RATES = {
    "means": 1.6e-5, "log_scales": 1e-3, "quaternions": 2e-4, "opacity_logits": 5e-3, "sh_dc": 2.5e-3,
    "sh_rest": 2.5e-3 / 20,
}  # fmt: skip
"""A tenth to a fifth of 3DGS's for the geometry, which is right already; that of means times the scene's size."""


@dataclass(frozen=True, slots=True, eq=False)
class _Moving:
    """One visible part with its trainable Gaussians."""

    part: Part
    parameters: SplatParameters

    def activated(self, view: ProblemView) -> tuple[Tensor, ...]:
        """Means, scales, quaternions, opacities and colours in the world, without what is left out."""
        own, kept = self.parameters, self._kept()
        scale = float(np.cbrt(np.linalg.det(self.part.to_world[:3, :3])))
        turn = quaternions_from_matrices(self.part.to_world[:3, :3] / scale)
        matrix = torch.as_tensor(self.part.to_world, dtype=torch.float32)
        means = own.tensors["means"] @ matrix[:3, :3].T + matrix[:3, 3]
        quaternions = own.tensors["quaternions"] @ _product(turn).T
        return tuple(
            each[kept]
            for each in (
                means, own.scales * scale, quaternions, own.opacities * self.part.opacity, self._colors(view)
            )
        )  # fmt: skip

    def _kept(self) -> Tensor:
        if not self.part.left_out:
            return slice(None)
        return torch.from_numpy((~self.part.left_out).indices.astype(np.int64))

    def _colors(self, view: ProblemView) -> Tensor:
        """Display colours; directions count as fixed, a step turns them by next to nothing."""
        means = self.parameters.tensors["means"].detach().numpy()
        g = self.part.gaussians
        now = self.part._replace(gaussians=Gaussians(means, g.scales, g.quaternions, g.opacities, g.sh))
        directions = view_directions([now], view.seen.target.camera, np.arange(len(means)))
        basis = torch.from_numpy(harmonics(directions, g.sh.shape[1]))
        return 0.5 + torch.einsum("nk,nkc->nc", basis, self.parameters.sh)


def refine(
    members: dict[str, Gaussians], views: Sequence[ProblemView], solution: Solution, steps: int, size_m: float,
    seed: int = 0,
) -> Generator[Progress, None, dict[str, Gaussians]]:  # fmt: skip
    """Train all parameters of members (recoloured Gaussians by key) on the views, one a step.

    No Gaussian is added or taken away, so that clear colours keep their owners. `size_m` is how large the scene is.
    """
    trained = {key: SplatParameters.from_gaussians(each, each.sh_degree) for key, each in members.items()}
    chosen = np.flatnonzero(solution.trust > 0.1)
    order, turns = np.random.default_rng(seed), np.zeros(0, np.int64)
    rates = RATES | {"means": RATES["means"] * size_m}
    for step in range(steps):
        yield Progress(step / steps, f"Refining, step {step + 1} of {steps}")
        if not len(turns):
            turns = order.permutation(chosen)
        index, turns = int(turns[0]), turns[1:]
        view = views[index]
        visible = view.seen.visible
        parts = [_Moving(p, trained[m.key]) for m, p in zip(visible.members, visible.parts, strict=True)]
        rendered = _rendered(parts, view)
        wanted = torch.from_numpy(solution.affines[index].undone(view.seen.target.image))
        wanted = wanted * rendered.alpha.detach()[..., None]
        mask = torch.from_numpy(view.seen.counted)
        loss = (1 - D_SSIM_SHARE) * l1(rendered.color, wanted, mask)
        (loss + D_SSIM_SHARE * d_ssim(rendered.color, wanted, mask)).backward()
        for moving in parts:
            moving.parameters.step(rates)
            moving.parameters.zero_grad()
    return {key: each.to_gaussians() for key, each in trained.items()}


def _rendered(parts: Sequence[_Moving], view: ProblemView) -> Rendered:
    pieces = zip(*(each.activated(view) for each in parts), strict=True)
    means, scales, quaternions, opacities, colors = (torch.cat(each) for each in pieces)
    return render_gaussians(means, scales, quaternions, opacities, colors, view.seen.target.camera)


def _product(turn: np.ndarray) -> Tensor:
    w, x, y, z = turn.tolist()
    return torch.tensor([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
