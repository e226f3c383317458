"""LPIPS as a loss of trainings that work on batches of pictures of values -1..1."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from .lpips import Lpips
from .lpips_weights import find_lpips_weights, read_lpips_weights

torch: Any = import_module("torch")

Tensor = Any


def lpips_loss(file: Path | None, device: str) -> Callable[[Tensor, Tensor], Tensor] | None:
    """Mean LPIPS (VGG16, as CycleGAN-Turbo takes it) of two batches (b, 3, h, w) of values -1..1, with gradients.

    `file` holds the weights; None takes those of this machine, and returns None where there are none.
    Raises FileNotFoundError or ValueError where a file is given that isn't there, or holds something else.
    """
    if file is not None:
        weights = read_lpips_weights(file)
        if weights.network != "vgg":
            raise ValueError(f"{file}: holds LPIPS of {weights.network}; the loss is that of VGG16")
    else:
        try:
            weights = find_lpips_weights("vgg")
        except FileNotFoundError:
            return None
    lpips = Lpips(weights).to(device)

    def loss(shown: Tensor, truth: Tensor) -> Tensor:
        pairs = zip(shown, truth, strict=True)
        distances = [lpips(*((each * 0.5 + 0.5).permute(1, 2, 0) for each in pair)) for pair in pairs]
        return torch.stack(distances).mean()

    return loss
