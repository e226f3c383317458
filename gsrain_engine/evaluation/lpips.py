"""LPIPS (Zhang et al. 2018): perceptual image distance from features of AlexNet or VGG16, in plain torch."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from .image_metrics import Image, Mask
from .lpips_weights import TAPS, LpipsWeights, find_lpips_weights, read_lpips_weights

torch: Any = import_module("torch")
Tensor = Any
MIN_SIZE_PX = 32  # smaller images have no pixel left after the last pooling
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)  # ImageNet's mean and deviation, for values of -1..1
_POOLED_BEFORE: dict[str, tuple[int, ...]] = {"alex": (1, 2), "vgg": (2, 4, 7, 10)}
_POOL: dict[str, tuple[int, int]] = {"alex": (3, 2), "vgg": (2, 2)}  # size and stride


class Lpips(torch.nn.Module):
    """The distance with fixed weights; gradients flow to the images."""

    def __init__(self, weights: LpipsWeights) -> None:
        super().__init__()
        self.network = weights.network
        self._layers = torch.nn.ModuleList()
        for i, (kernel, bias) in enumerate(zip(weights.kernels, weights.biases, strict=True)):
            layer = torch.nn.Conv2d(kernel.shape[1], kernel.shape[0], *geometry(weights.network, i))
            layer.weight.data, layer.bias.data = torch.from_numpy(kernel.copy()), torch.from_numpy(bias.copy())
            self._layers.append(layer)
        for i, head in enumerate(weights.heads):
            self.register_buffer(f"head_{i}", torch.from_numpy(head.copy()).view(-1, 1, 1))
        self.requires_grad_(False)

    def forward(self, rendered: Tensor, truth: Tensor) -> Tensor:
        """Distance of two (h, w, 3) tensors of 0..1, with gradients; raises ValueError for shapes it can't compare."""
        if rendered.shape != truth.shape or min(rendered.shape[:2]) < MIN_SIZE_PX:
            sizes = " and ".join(f"{each.shape[1]}x{each.shape[0]}" for each in (rendered, truth))
            raise ValueError(f"LPIPS takes pictures of one size and at least {MIN_SIZE_PX} px a side, not {sizes}")
        distance = rendered.new_zeros(())
        for i, (a, b) in enumerate(zip(self.features(rendered), self.features(truth), strict=True)):
            head = getattr(self, f"head_{i}")
            distance = distance + (head * (_unit(a) - _unit(b)) ** 2).sum(0).mean()
        return distance

    def distance(self, rendered: Image, truth: Image, mask: Mask | None = None) -> float:
        """Distance of two float images of values 0..1; pixels outside the mask are copied from `truth`."""
        compared = rendered if mask is None else np.where(mask[..., None], rendered, truth)
        images = (np.ascontiguousarray(each, np.float32) for each in (compared, truth))
        with torch.no_grad():
            return float(self(*(torch.as_tensor(each).to(self.head_0.device) for each in images)))

    def features(self, image: Tensor) -> list[Tensor]:
        """Compared feature maps (channels, h, w) of a (h, w, 3) tensor of values 0..1, from fine to coarse."""
        shift, scale = (image.new_tensor(values).view(3, 1, 1) for values in (_SHIFT, _SCALE))
        flow = ((2 * image.permute(2, 0, 1) - 1) - shift) / scale
        size, stride = _POOL[self.network]
        tapped: list[Tensor] = []
        for i, layer in enumerate(self._layers):
            if i in _POOLED_BEFORE[self.network]:
                flow = torch.nn.functional.max_pool2d(flow[None], size, stride)[0]
            flow = layer(flow[None])[0].relu()
            if i in TAPS[self.network]:
                tapped.append(flow)
        return tapped


def geometry(network: str, index: int) -> tuple[int, int, int]:
    """Size, stride and padding of a convolution, in input pixels."""
    if network == "alex" and index < 2:
        return ((11, 4, 2), (5, 1, 2))[index]
    return 3, 1, 1


def _unit(features: Tensor) -> Tensor:
    """Features of unit length at each pixel; the root of zero has no gradient."""
    return features / ((features * features).sum(0, keepdim=True).clamp_min(1e-20).sqrt() + 1e-10)


# LPIPS as a training loss


def lpips_loss(file: Path | None, device: str) -> Callable[[Tensor, Tensor], Tensor] | None:
    """Mean LPIPS (VGG16, as in CycleGAN-Turbo) of two batches (b, 3, h, w) of values -1..1, with gradients.

    `file` holds the weights; None uses those of this machine, and returns None if there are none. Raises
    FileNotFoundError or ValueError if a given file is missing or has other content.
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

    def loss(rendered: Tensor, truth: Tensor) -> Tensor:
        pairs = zip(rendered, truth, strict=True)
        distances = [lpips(*((each * 0.5 + 0.5).permute(1, 2, 0) for each in pair)) for pair in pairs]
        return torch.stack(distances).mean()

    return loss
