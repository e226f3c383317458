"""Discriminators on CLIP features at three levels (vision-aided GAN, Kumari et al. 2022), with augmentation."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from .settings import find_clip

torch: Any = import_module("torch")
_normalized: Any = import_module("torch.nn.utils.parametrizations").spectral_norm
Tensor = Any
_SLOPE = 0.2

# Features of a frozen CLIP vision model (Kumari et al. 2022, Radford et al. 2021)


class ClipFeatures(torch.nn.Module):
    """CLIP features of two depths and of the whole image; frozen, but gradients reach the images."""

    def __init__(self, vision: Any) -> None:
        """Take a `CLIPVisionModelWithProjection`; taps at one and two thirds of its blocks, 4 and 8 of 12."""
        super().__init__()
        self.vision = vision.eval().requires_grad_(False)
        config = vision.config
        blocks = config.num_hidden_layers
        self.taps = (max(blocks // 3, 1), max(2 * blocks // 3, 1))
        self.map_channels, self.whole_channels = config.hidden_size, config.projection_dim
        self._side_px: int = config.image_size
        self.register_buffer("mean", torch.tensor(_MEAN).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("deviation", torch.tensor(_DEVIATION).view(1, 3, 1, 1), persistent=False)

    @classmethod
    def read(cls, folder: Path | None) -> "ClipFeatures":
        """Load the model from a folder, or if None, from that of `find_clip`.

        Raises FileNotFoundError with download instructions if there is none, ValueError if weights are missing.
        """
        place = find_clip(folder)
        vision, loading = _loaded(place)
        # The text model of a full CLIP is not needed; a vision weight missing here would be random.
        missing = sorted({*loading["missing_keys"], *(name for name, *_ in loading["mismatched_keys"])})
        if missing:
            raise ValueError(f"{place}: {len(missing)} weights of CLIP's vision model are missing, first {missing[0]}")
        return cls(vision)

    @classmethod
    def tiny(cls) -> "ClipFeatures":
        """Make a model of the same classes with few random weights, from torch's current random state."""
        config = transformers.CLIPVisionConfig(
            hidden_size=16, intermediate_size=32, projection_dim=16, num_hidden_layers=3, num_attention_heads=2,
            image_size=32, patch_size=8,
        )  # fmt: skip
        return cls(transformers.CLIPVisionModelWithProjection(config))

    def train(self, mode: bool = True) -> "ClipFeatures":
        """Do nothing: the model is frozen."""
        return self

    def forward(self, pictures: Tensor) -> list[Tensor]:
        """Return two maps (b, c, rows, columns) and one vector (b, d) of images (b, 3, h, w) in -1..1."""
        resized = area_resized(pictures * 0.5 + 0.5, self._side_px)
        features = self.vision(pixel_values=(resized - self.mean) / self.deviation, output_hidden_states=True)
        return [*(_as_map(features.hidden_states[tap]) for tap in self.taps), features.image_embeds]


class Discriminator(torch.nn.Module):
    """Trainable heads with spectral norm (Miyato et al. 2018) on frozen features, which discriminators may share."""

    def __init__(self, features: ClipFeatures, augmentations: Sequence[str], channels: int = 256) -> None:
        super().__init__()
        self.shared_features = (features,)  # the tuple keeps the features out of this module's parameters and state
        self._augmentations = tuple(augmentations)
        self.maps = torch.nn.ModuleList(_MapHead(features.map_channels, channels) for _ in features.taps)
        self.whole = torch.nn.Sequential(
            _normalized(torch.nn.Linear(features.whole_channels, channels)),
            torch.nn.LeakyReLU(_SLOPE),
            _normalized(torch.nn.Linear(channels, 1)),
        )

    def forward(self, pictures: Tensor, generator: Any) -> list[Tensor]:
        """Logits of "real" for images (b, 3, h, w) in -1..1, one tensor per level; augments with `generator`."""
        *maps, whole = self.shared_features[0](augment_images(pictures, self._augmentations, generator))
        return [*(head(each) for head, each in zip(self.maps, maps, strict=True)), self.whole(whole)]


class _MapHead(torch.nn.Module):
    """Logits over a map, at every second position: convolution, anti-aliasing blur, convolution."""

    def __init__(self, channels_in: int, channels: int) -> None:
        super().__init__()
        self.first = _normalized(torch.nn.Conv2d(channels_in, channels, 3, padding=1))
        self.last = _normalized(torch.nn.Conv2d(channels, 1, 1, stride=2))
        line = torch.tensor([0.25, 0.5, 0.25])
        self.register_buffer("blur", torch.outer(line, line).expand(channels, 1, 3, 3).clone(), persistent=False)

    def forward(self, features: Tensor) -> Tensor:
        flow = torch.nn.functional.leaky_relu(self.first(features), _SLOPE)
        return self.last(torch.nn.functional.conv2d(flow, self.blur, padding=1, groups=len(self.blur)))


transformers: Any = import_module("transformers")
_MEAN = (0.48145466, 0.4578275, 0.40821073)
_DEVIATION = (0.26862954, 0.26130258, 0.27577711)


def area_resized(pictures: Tensor, side_px: int) -> Tensor:
    """Resize (b, c, h, w) to a square by area means: torch's "area", as two matrix products.

    The gradient of torch's own is not deterministic on CUDA.
    """
    rows, columns = (_area_weights(side, side_px).to(pictures) for side in pictures.shape[-2:])
    return rows @ pictures @ columns.T


def _area_weights(of: int, to: int) -> Tensor:
    """Weights (to, of) of old pixels in new ones."""
    weights = torch.zeros(to, of)
    for i in range(to):
        first, end = i * of // to, -(-(i + 1) * of // to)
        weights[i, first:end] = 1 / (end - first)
    return weights


def _loaded(place: Path) -> tuple[Any, Any]:
    """Load the vision model of a folder and its loading info, without the log messages on the unused text model."""
    log = transformers.logging
    verbosity, has_bar = log.get_verbosity(), log.is_progress_bar_enabled()
    log.set_verbosity_error()
    log.disable_progress_bar()
    try:
        return transformers.CLIPVisionModelWithProjection.from_pretrained(
            place, local_files_only=True, output_loading_info=True, ignore_mismatched_sizes=True, dtype=torch.float32
        )
    finally:
        log.set_verbosity(verbosity)
        if has_bar:
            log.enable_progress_bar()


def _as_map(tokens: Tensor) -> Tensor:
    """Reshape tokens (b, 1 + n, c), without the class token, into a square map."""
    count, tokens_in_all, channels = tokens.shape
    side = round((tokens_in_all - 1) ** 0.5)
    return tokens[:, 1:].transpose(1, 2).reshape(count, channels, side, side)


# Differentiable augmentation (Zhao et al. 2020), in plain torch

_SHIFT = 1 / 8  # largest translation, as a share of the side
_HOLE = 1 / 2  # side of the hole, as a share of the image's side


def augment_images(pictures: Tensor, kinds: Sequence[str], generator: Any) -> Tensor:
    """Augment images (b, 3, h, w) in -1..1, each one differently; gradients pass through.

    `kinds` are "color", "translation" and "cutout", applied in this order. `generator` is torch's, on the CPU, so that
    a seed gives the same draws on every device. Uncovered borders and holes are 0, the middle gray.
    """
    for kind, augment in _KINDS.items():
        if kind in kinds:
            pictures = augment(pictures, generator)
    return pictures


def _color(pictures: Tensor, generator: Any) -> Tensor:
    """Change brightness by up to half the range, saturation by 0 to 2, contrast by 0.5 to 1.5."""
    draws = torch.rand(3, len(pictures), 1, 1, 1, generator=generator).to(pictures)
    pictures = pictures + (draws[0] - 0.5)
    grey = pictures.mean(1, keepdim=True)
    pictures = grey + (pictures - grey) * (2 * draws[1])
    middle = pictures.mean((1, 2, 3), keepdim=True)
    return middle + (pictures - middle) * (draws[2] + 0.5)


def _translation(pictures: Tensor, generator: Any) -> Tensor:
    count, _, height, width = pictures.shape
    most = [int(side * _SHIFT + 0.5) for side in (height, width)]
    down, right = (torch.randint(-by, by + 1, (count,), generator=generator).tolist() for by in most)
    padded = torch.nn.functional.pad(pictures, (most[1], most[1], most[0], most[0]))
    cuts = [
        each[:, most[0] - dy : most[0] - dy + height, most[1] - dx : most[1] - dx + width]
        for each, dy, dx in zip(padded, down, right, strict=True)
    ]
    return torch.stack(cuts)


def _cutout(pictures: Tensor, generator: Any) -> Tensor:
    """Cut a hole centered anywhere in the image; at the border it is smaller."""
    count, _, height, width = pictures.shape
    kept = torch.ones(count, 1, height, width)
    sides = [int(side * _HOLE + 0.5) for side in (height, width)]
    middles = [torch.randint(0, side + 1, (count,), generator=generator).tolist() for side in (height, width)]
    for i, (y, x) in enumerate(zip(*middles, strict=True)):
        top, left = y - sides[0] // 2, x - sides[1] // 2
        kept[i, :, max(top, 0) : max(top + sides[0], 0), max(left, 0) : max(left + sides[1], 0)] = 0
    return pictures * kept.to(pictures)


_KINDS: dict[str, Any] = {"color": _color, "translation": _translation, "cutout": _cutout}
