"""Tells made pictures from real ones by CLIP's features, at three levels (vision-aided GAN, Kumari et al. 2022)."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from .augment import augmented
from .clip_features import ClipFeatures

torch: Any = import_module("torch")
_normalized: Any = import_module("torch.nn.utils.parametrizations").spectral_norm

Tensor = Any

_SLOPE = 0.2


class Discriminator(torch.nn.Module):
    """Heads over frozen features, of layers with spectral norm (Miyato et al. 2018). Only the heads are its own."""

    def __init__(self, features: ClipFeatures, augmentations: Sequence[str], channels: int = 256) -> None:
        """Several discriminators may look through the same `features`."""
        super().__init__()
        self._seen = (features,)  # in a tuple: no part of this module, its numbers are not saved with it
        self._augmentations = tuple(augmentations)
        self.maps = torch.nn.ModuleList(_MapHead(features.map_channels, channels) for _ in features.taps)
        self.whole = torch.nn.Sequential(
            _normalized(torch.nn.Linear(features.whole_channels, channels)),
            torch.nn.LeakyReLU(_SLOPE),
            _normalized(torch.nn.Linear(channels, 1)),
        )

    def forward(self, pictures: Tensor, generator: Any) -> list[Tensor]:
        """Logits of "real" for pictures (b, 3, h, w) of values -1..1, a tensor a level; augments with `generator`."""
        *maps, whole = self._seen[0](augmented(pictures, self._augmentations, generator))
        return [*(head(each) for head, each in zip(self.maps, maps, strict=True)), self.whole(whole)]


class _MapHead(torch.nn.Module):
    """Logits over a map, one for every second place: convolution, blur against aliasing, convolution."""

    def __init__(self, channels_in: int, channels: int) -> None:
        super().__init__()
        self.first = _normalized(torch.nn.Conv2d(channels_in, channels, 3, padding=1))
        self.last = _normalized(torch.nn.Conv2d(channels, 1, 1, stride=2))
        line = torch.tensor([0.25, 0.5, 0.25])
        self.register_buffer("blur", torch.outer(line, line).expand(channels, 1, 3, 3).clone(), persistent=False)

    def forward(self, features: Tensor) -> Tensor:
        flow = torch.nn.functional.leaky_relu(self.first(features), _SLOPE)
        return self.last(torch.nn.functional.conv2d(flow, self.blur, padding=1, groups=len(self.blur)))
