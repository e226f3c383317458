"""What a training makes small for one view: color, depth where it was measured, holes and veils."""

from importlib import import_module
from typing import Any, NamedTuple

from .losses import d_ssim, l1
from .model import Picture
from .settings import TrainingSettings
from .views import Level

torch: Any = import_module("torch")

Tensor = Any

_LEAST_ALPHA = 0.05
"""Below this there is too little to have a depth."""


class Truth(NamedTuple):
    """One level of a view as tensors."""

    image: Tensor
    """(h, w, 3) of 0..1."""
    mask: Tensor | None
    """(h, w) bool: what is learned from."""
    hits: Tensor
    """(m,) flat indices of pixels whose depth was measured."""
    depths: Tensor
    """(m,) along the view axis."""
    sky: Tensor | None
    """(h, w) bool."""

    @classmethod
    def of(cls, level: Level, device: str) -> "Truth":
        mask = None if level.mask is None else torch.as_tensor(level.mask, device=device)
        hits, depths = torch.zeros(0, dtype=torch.int64, device=device), torch.zeros(0, device=device)
        if level.depth is not None:
            measured = level.depth > 0 if level.mask is None else (level.depth > 0) & level.mask
            rows = measured.ravel().nonzero()[0]
            hits = torch.as_tensor(rows, device=device)
            depths = torch.as_tensor(level.depth.ravel()[rows], device=device)
        sky = None if level.sky is None else torch.as_tensor(level.sky, device=device)
        return cls(torch.as_tensor(level.image, device=device).to(torch.float32) / 255, mask, hits, depths, sky)


class Loss(NamedTuple):
    """The parts of one step's loss, each with its weight."""

    total: Tensor
    color: Tensor
    depth: Tensor
    cover: Tensor


def view_loss(picture: Picture, shown: Tensor, truth: Truth, settings: TrainingSettings) -> Loss:
    """Compare one render with what was seen.

    Color is (1 - s) L1 + s D-SSIM (Kerbl et al. 2023, eq. 7) of `shown`, the render as its camera would have exposed
    it. Depth is |d - m| / (d + m), d the expected depth and m the measured one: the same for near and far, and bounded,
    since a beam that grazes an edge may be metres off. Cover is how much is missing where something was hit, and how
    much stands before known sky.
    """
    color = (1 - settings.d_ssim) * l1(shown, truth.image, truth.mask)
    if settings.d_ssim:
        color = color + settings.d_ssim * d_ssim(shown, truth.image, truth.mask)
    nothing = color.new_zeros(())
    depth, cover = nothing, nothing
    if len(truth.hits) and (settings.depth or settings.cover):
        alpha = picture.front.alpha.reshape(-1)[truth.hits]
        weighted = picture.front.depth.reshape(-1)[truth.hits]
        mean = weighted / alpha.clamp_min(_LEAST_ALPHA)
        error = (mean - truth.depths).abs() / (mean + truth.depths)
        depth = settings.depth * (error * (alpha.detach() > _LEAST_ALPHA)).mean()
        cover = settings.cover * (1 - alpha).mean()
    if truth.sky is not None and picture.sky is not None and settings.cover:
        sky = truth.sky if truth.mask is None else truth.sky & truth.mask
        cover = cover + settings.cover * (picture.front.alpha * sky).sum() / sky.sum().clamp_min(1)
    return Loss(color + depth + cover, color, depth, cover)
