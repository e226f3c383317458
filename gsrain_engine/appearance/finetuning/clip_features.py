"""What discriminators look at: features of a frozen CLIP vision model (Kumari et al. 2022, Radford et al. 2021)."""

from importlib import import_module
from pathlib import Path
from typing import Any

from .clip_place import find_clip

torch: Any = import_module("torch")
transformers: Any = import_module("transformers")

Tensor = Any

_MEAN = (0.48145466, 0.4578275, 0.40821073)
_DEVIATION = (0.26862954, 0.26130258, 0.27577711)


class ClipFeatures(torch.nn.Module):
    """Features of two depths and of the whole picture; its numbers stay, gradients go into the pictures."""

    def __init__(self, vision: Any) -> None:
        """Take a `CLIPVisionModelWithProjection`; of 12 blocks the 4th and the 8th are tapped, of others the thirds."""
        super().__init__()
        self.vision = vision.eval().requires_grad_(False)
        config = vision.config
        blocks = config.num_hidden_layers
        self.taps = (max(blocks // 3, 1), max(2 * blocks // 3, 1))
        """Blocks after which features are taken."""
        self.map_channels, self.whole_channels = config.hidden_size, config.projection_dim
        self._side_px: int = config.image_size
        self.register_buffer("mean", torch.tensor(_MEAN).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("deviation", torch.tensor(_DEVIATION).view(1, 3, 1, 1), persistent=False)

    @classmethod
    def read(cls, folder: Path | None) -> "ClipFeatures":
        """Load a folder that a person has (None: wherever `clip_places` says).

        Raises FileNotFoundError, with how to get it, where there is none, ValueError where weights are missing in it.
        """
        place = find_clip(folder)
        vision, told = _loaded(place)
        # A whole CLIP has a text model too, which nobody misses; but a number that is missing here would be random.
        lacking = sorted({*told["missing_keys"], *(name for name, *_ in told["mismatched_keys"])})
        if lacking:
            raise ValueError(f"{place}: {len(lacking)} weights of CLIP's vision model are missing, first {lacking[0]}")
        return cls(vision)

    @classmethod
    def tiny(cls) -> "ClipFeatures":
        """Make a stand-in of the same classes with random weights, from torch's present random state."""
        config = transformers.CLIPVisionConfig(
            hidden_size=16, intermediate_size=32, projection_dim=16, num_hidden_layers=3, num_attention_heads=2,
            image_size=32, patch_size=8,
        )  # fmt: skip
        return cls(transformers.CLIPVisionModelWithProjection(config))

    def train(self, mode: bool = True) -> "ClipFeatures":
        """Stay as it is: the model is frozen."""
        return self

    def forward(self, pictures: Tensor) -> list[Tensor]:
        """See pictures (b, 3, h, w) of values -1..1: two maps (b, c, rows, columns) and one vector (b, d)."""
        shown = area_resized(pictures * 0.5 + 0.5, self._side_px)
        seen = self.vision(pixel_values=(shown - self.mean) / self.deviation, output_hidden_states=True)
        return [*(_as_map(seen.hidden_states[tap]) for tap in self.taps), seen.image_embeds]


def area_resized(pictures: Tensor, side_px: int) -> Tensor:
    """Resize (b, c, h, w) to a square by means over areas: torch's "area", as two products of matrices.

    Torch's own has a gradient on CUDA that adds up in a different order every time.
    """
    rows, columns = (_area_weights(side, side_px).to(pictures) for side in pictures.shape[-2:])
    return rows @ pictures @ columns.T


def _area_weights(of: int, to: int) -> Tensor:
    """Shares (to, of) of old pixels in new ones."""
    weights = torch.zeros(to, of)
    for i in range(to):
        first, end = i * of // to, -(-(i + 1) * of // to)
        weights[i, first:end] = 1 / (end - first)
    return weights


def _loaded(place: Path) -> tuple[Any, Any]:
    """The vision model of a folder, and what was found; without the report on the text model that it would log."""
    log = transformers.logging
    said, shown = log.get_verbosity(), log.is_progress_bar_enabled()
    log.set_verbosity_error()
    log.disable_progress_bar()
    try:
        return transformers.CLIPVisionModelWithProjection.from_pretrained(
            place, local_files_only=True, output_loading_info=True, ignore_mismatched_sizes=True, dtype=torch.float32
        )
    finally:
        log.set_verbosity(said)
        if shown:
            log.enable_progress_bar()


def _as_map(tokens: Tensor) -> Tensor:
    """Tokens (b, 1 + n, c) without the class token, as the square that they cover."""
    count, tokens_in_all, channels = tokens.shape
    side = round((tokens_in_all - 1) ** 0.5)
    return tokens[:, 1:].transpose(1, 2).reshape(count, channels, side, side)
