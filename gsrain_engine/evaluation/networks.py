"""The Inception network of FID in plain torch, with the parts named as in the published weights.

It is Szegedy et al. 2016 (Inception v3) as Heusel et al. 2017 took it from TensorFlow's files of 2015-12-05. It differs
from torchvision's in three ways: average pools exclude the padding from the mean (blocks A, C and E), the last block
uses max pooling, and there are 1008 classes.
"""

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

torch: Any = import_module("torch")
Tensor = Any
INCEPTION_FEATURES = 2048
INCEPTION_SIZE_PX = 299
Shape = tuple[int, int, tuple[int, int], int, tuple[int, int]]
"""Channels in and out, size, stride and padding (height, width) of a convolution."""


class _InceptionBlock(NamedTuple):
    convolutions: Mapping[str, Shape]
    branches: tuple[tuple[str, ...], ...]
    """Consecutive convolutions; the last may be two parallel ones joined by +. Outputs are concatenated in order."""
    pool: str
    """First step of the last branch, followed by branch_pool if present."""


class Inception(torch.nn.Module):
    """Features of images (b, 3, 299, 299) of display values 0..255: (b, 2048), the mean over the last block."""

    def __init__(self) -> None:
        super().__init__()
        for name, shape in _STEM.items():
            self.add_module(name, _Convolution(shape))
        for name, block in _BLOCKS.items():
            self.add_module(name, _Mixed(block))

    def forward(self, pictures: Tensor) -> Tensor:
        """Return features of images; TensorFlow's scaling of 2015 is (v - 128) / 128."""
        flow = (pictures - 128) / 128
        for name in _STEM:
            flow = getattr(self, name)(flow)
            if name in _POOLED_AFTER:
                flow = torch.nn.functional.max_pool2d(flow, 3, 2)
        for name in _BLOCKS:
            flow = getattr(self, name)(flow)
        return flow.mean(dim=(2, 3))


class _Convolution(torch.nn.Module):
    def __init__(self, shape: Shape) -> None:
        super().__init__()
        inward, outward, size, stride, padding = shape
        self.conv = torch.nn.Conv2d(inward, outward, size, stride, padding, bias=False)
        self.bn = FrozenNorm(outward)

    def forward(self, flow: Tensor) -> Tensor:
        return self.bn(self.conv(flow)).relu()


class _Mixed(torch.nn.Module):
    def __init__(self, block: _InceptionBlock) -> None:
        super().__init__()
        self._branches, self._pool = block.branches, block.pool
        for name, shape in block.convolutions.items():
            self.add_module(name, _Convolution(shape))

    def forward(self, flow: Tensor) -> Tensor:
        outs = [self._through(branch, flow) for branch in self._branches]
        pooled = _POOLS[self._pool](flow)
        outs.append(self.branch_pool(pooled) if self._pool != "halving" else pooled)
        return torch.cat(outs, 1)

    def _through(self, branch: tuple[str, ...], flow: Tensor) -> Tensor:
        for step in branch:
            flow = torch.cat([getattr(self, name)(flow) for name in step.split("+")], 1)
        return flow


_POOLS: dict[str, Any] = {
    "average": partial(torch.nn.functional.avg_pool2d, kernel_size=3, stride=1, padding=1, count_include_pad=False),
    "maximum": partial(torch.nn.functional.max_pool2d, kernel_size=3, stride=1, padding=1),
    "halving": partial(torch.nn.functional.max_pool2d, kernel_size=3, stride=2),
}


def _shape(inward: int, outward: int, height: int = 1, width: int = 0, stride: int = 1, pad: bool = True) -> Shape:
    width = width or height
    return inward, outward, (height, width), stride, (height // 2, width // 2) if pad and stride == 1 else (0, 0)


_STEM: dict[str, Shape] = {
    "Conv2d_1a_3x3": _shape(3, 32, 3, stride=2),
    "Conv2d_2a_3x3": _shape(32, 32, 3, pad=False),
    "Conv2d_2b_3x3": _shape(32, 64, 3),
    "Conv2d_3b_1x1": _shape(64, 80),
    "Conv2d_4a_3x3": _shape(80, 192, 3, pad=False),
}

_POOLED_AFTER = ("Conv2d_2b_3x3", "Conv2d_4a_3x3")


def _block_a(inward: int, pooled: int) -> _InceptionBlock:
    convolutions = {
        "branch1x1": _shape(inward, 64),
        "branch5x5_1": _shape(inward, 48),
        "branch5x5_2": _shape(48, 64, 5),
        "branch3x3dbl_1": _shape(inward, 64),
        "branch3x3dbl_2": _shape(64, 96, 3),
        "branch3x3dbl_3": _shape(96, 96, 3),
        "branch_pool": _shape(inward, pooled),
    }
    branches = (("branch1x1",), ("branch5x5_1", "branch5x5_2"), ("branch3x3dbl_1", "branch3x3dbl_2", "branch3x3dbl_3"))
    return _InceptionBlock(convolutions, branches, "average")


def _block_b(inward: int) -> _InceptionBlock:
    convolutions = {
        "branch3x3": _shape(inward, 384, 3, stride=2),
        "branch3x3dbl_1": _shape(inward, 64),
        "branch3x3dbl_2": _shape(64, 96, 3),
        "branch3x3dbl_3": _shape(96, 96, 3, stride=2),
    }
    branches = (("branch3x3",), ("branch3x3dbl_1", "branch3x3dbl_2", "branch3x3dbl_3"))
    return _InceptionBlock(convolutions, branches, "halving")


def _block_c(inward: int, inner: int) -> _InceptionBlock:
    convolutions = {
        "branch1x1": _shape(inward, 192),
        "branch7x7_1": _shape(inward, inner),
        "branch7x7_2": _shape(inner, inner, 1, 7),
        "branch7x7_3": _shape(inner, 192, 7, 1),
        "branch7x7dbl_1": _shape(inward, inner),
        "branch7x7dbl_2": _shape(inner, inner, 7, 1),
        "branch7x7dbl_3": _shape(inner, inner, 1, 7),
        "branch7x7dbl_4": _shape(inner, inner, 7, 1),
        "branch7x7dbl_5": _shape(inner, 192, 1, 7),
        "branch_pool": _shape(inward, 192),
    }
    long = tuple(f"branch7x7dbl_{k}" for k in range(1, 6))
    branches = (("branch1x1",), ("branch7x7_1", "branch7x7_2", "branch7x7_3"), long)
    return _InceptionBlock(convolutions, branches, "average")


def _block_d(inward: int) -> _InceptionBlock:
    convolutions = {
        "branch3x3_1": _shape(inward, 192),
        "branch3x3_2": _shape(192, 320, 3, stride=2),
        "branch7x7x3_1": _shape(inward, 192),
        "branch7x7x3_2": _shape(192, 192, 1, 7),
        "branch7x7x3_3": _shape(192, 192, 7, 1),
        "branch7x7x3_4": _shape(192, 192, 3, stride=2),
    }
    branches = (("branch3x3_1", "branch3x3_2"), tuple(f"branch7x7x3_{k}" for k in range(1, 5)))
    return _InceptionBlock(convolutions, branches, "halving")


def _block_e(inward: int, pool: str) -> _InceptionBlock:
    convolutions = {
        "branch1x1": _shape(inward, 320),
        "branch3x3_1": _shape(inward, 384),
        "branch3x3_2a": _shape(384, 384, 1, 3),
        "branch3x3_2b": _shape(384, 384, 3, 1),
        "branch3x3dbl_1": _shape(inward, 448),
        "branch3x3dbl_2": _shape(448, 384, 3),
        "branch3x3dbl_3a": _shape(384, 384, 1, 3),
        "branch3x3dbl_3b": _shape(384, 384, 3, 1),
        "branch_pool": _shape(inward, 192),
    }
    branches = (
        ("branch1x1",),
        ("branch3x3_1", "branch3x3_2a+branch3x3_2b"),
        ("branch3x3dbl_1", "branch3x3dbl_2", "branch3x3dbl_3a+branch3x3dbl_3b"),
    )
    return _InceptionBlock(convolutions, branches, pool)


_BLOCKS: dict[str, _InceptionBlock] = {
    "Mixed_5b": _block_a(192, 32),
    "Mixed_5c": _block_a(256, 64),
    "Mixed_5d": _block_a(288, 64),
    "Mixed_6a": _block_b(288),
    "Mixed_6b": _block_c(768, 128),
    "Mixed_6c": _block_c(768, 160),
    "Mixed_6d": _block_c(768, 160),
    "Mixed_6e": _block_c(768, 192),
    "Mixed_7a": _block_d(768),
    "Mixed_7b": _block_e(1280, "average"),
    "Mixed_7c": _block_e(2048, "maximum"),
}

# Inference-only networks
# Built without initialization and filled with given weights.


class FrozenNorm(torch.nn.Module):
    """Batch normalization with given statistics, with torch's parameter names; epsilon is TensorFlow's, 0.001."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        for name in ("weight", "bias", "running_mean", "running_var"):
            self.register_buffer(name, torch.zeros(channels))

    def forward(self, flow: Tensor) -> Tensor:
        scales = (self.running_mean, self.running_var, self.weight, self.bias)
        return torch.nn.functional.batch_norm(flow, *scales, eps=1e-3)


def build_without_weights(make: Callable[[], Any]) -> Any:
    """Build a network on the meta device: names and shapes without values."""
    with torch.device("meta"):
        return make()


def build_with_weights(make: Callable[[], Any], arrays: Mapping[str, np.ndarray]) -> Any:
    """Build a network from exactly these arrays, by name; raises RuntimeError if names or shapes differ."""
    network = build_without_weights(make)
    network.load_state_dict({name: torch.from_numpy(array.copy()) for name, array in arrays.items()}, assign=True)
    return network.requires_grad_(False).eval()
