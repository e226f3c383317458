"""CycleGAN-Turbo (Parmar et al. 2024): one step of SD-Turbo between two autoencoders' halves, in both directions."""

import copy
from importlib import import_module
from typing import Any, Literal

from .architecture import TurboArchitecture
from .lora import LoraRanks, add_adapters
from .one_step import OneStep
from .skip_autoencoder import add_guide_channel, add_skips, decoded, encoded

torch: Any = import_module("torch")

Tensor = Any
Direction = Literal["a2b", "b2a"]
"""a is clear and b rainy, in weights that make views rainy."""

CAPTIONS = ("driving in heavy rain", "driving in the day")
"""For a2b and b2a, as the published weights were trained with."""

Guide = Literal["", "normals", "mask"]
"""What the fourth channel was trained with: nothing yet, up-ness of surfaces, or WeatherEdit's mask of classes."""


class CycleGanTurbo(torch.nn.Module):
    """One UNet for both directions, told apart by their captions, and an autoencoder for each."""

    def __init__(self, architecture: TurboArchitecture, unet: Any, vae: Any, vae_b2a: Any) -> None:
        super().__init__()
        self.architecture = architecture
        self.step = OneStep.of(architecture)
        self.unet = unet
        self.vae = vae
        self.vae_b2a = vae_b2a
        self.guide: Guide = ""
        self.delta: Any = None
        """What has been merged into the weights (`delta.TurboDelta`), kept to be saved again; None for nothing."""
        self.texts: tuple[str, str] = CAPTIONS
        """What the captions say."""
        self.seed: int | None = None
        """Of the random weights below what is trained; None for SD-Turbo's own."""

    @property
    def takes_guides(self) -> bool:
        """Whether the encoders have a fourth channel."""
        return self.vae.config.in_channels == 4

    @property
    def adapted(self) -> bool:
        """Whether peft adapters are there, to be trained; else additions are part of the weights."""
        return hasattr(self.unet, "peft_config")

    @property
    def captions(self) -> dict[str, Tensor]:
        """What tells the UNet the direction: (1, tokens, features) each."""
        return {"a2b": self.caption_a2b, "b2a": self.caption_b2a}

    def set_captions(self, a2b: Tensor, b2a: Tensor) -> None:
        """Set what the text encoder makes of the two captions; raises ValueError for other shapes."""
        self.check_captions(a2b, b2a)
        like = self.unet.conv_out.bias
        for name, caption in (("a2b", a2b), ("b2a", b2a)):
            value = caption.detach().to(like.device, like.dtype).clone()
            self.register_buffer(f"caption_{name}", value, persistent=False)

    def check_captions(self, a2b: Tensor, b2a: Tensor) -> None:
        """Raise ValueError where `set_captions` would."""
        wanted = self.architecture.caption_shape
        for name, caption in (("a2b", a2b), ("b2a", b2a)):
            if tuple(caption.shape) != wanted:
                raise ValueError(f"caption {name} is {tuple(caption.shape)}; this UNet takes {wanted}")

    def translate(self, pictures: Tensor, guides: Tensor | None = None, direction: Direction = "a2b") -> Tensor:
        """Pictures (b, 3, h, w) in [-1, 1] in the other domain; the same input gives the same output.

        Args:
            pictures: In [-1, 1]; h and w multiples of `architecture.side_multiple`.
            guides: (b, 1, h, w) in [-1, 1], the fourth channel; None gives zeros where the encoders have one.
            direction: "a2b" as a rule: from clear to rainy.

        Raises ValueError for other sizes, and for guides that the encoders can't take.
        """
        if torch.is_grad_enabled():
            latents, skips = self.encode(pictures, guides, direction)
            return self.decode(self.denoise(latents, direction), skips, direction)
        # One by one: the autoencoder needs most of the memory, and pictures meet only in the UNet.
        halves = [self.encode(*each, direction) for each in _singles(pictures, guides)]
        clean = self.denoise(torch.cat([latents for latents, _ in halves]), direction)
        made = [self.decode(clean[i : i + 1], skips, direction) for i, (_, skips) in enumerate(halves)]
        return torch.cat(made)

    def encode(
        self, pictures: Tensor, guides: Tensor | None = None, direction: Direction = "a2b"
    ) -> tuple[Tensor, list[Tensor]]:
        """Scaled latents (b, 4, h / 8, w / 8) and the encoder's activations for the skips; arguments of `translate`."""
        multiple = self.architecture.side_multiple
        if pictures.shape[-1] % multiple or pictures.shape[-2] % multiple:
            raise ValueError(f"sides must be multiples of {multiple} px, not {tuple(pictures.shape[-2:])}")
        if guides is not None and not self.takes_guides:
            raise ValueError("these encoders have no fourth channel for guides")
        if self.takes_guides:
            fourth = torch.zeros_like(pictures[:, :1]) if guides is None else guides.to(pictures.dtype)
            pictures = torch.cat([pictures, fourth], dim=1)
        return encoded(self.autoencoder(direction), pictures)

    def denoise(self, latents: Tensor, direction: Direction = "a2b") -> Tensor:
        """The UNet's one step: latents of the same shape, in the other domain."""
        steps = torch.full((len(latents),), self.step.timestep, device=latents.device, dtype=torch.long)
        caption = self.captions[direction].expand(len(latents), -1, -1)
        noise = self.unet(latents, steps, encoder_hidden_states=caption).sample
        return self.step.clean(latents, noise)

    def decode(self, latents: Tensor, skips: list[Tensor], direction: Direction = "a2b") -> Tensor:
        """Pictures (b, 3, h, w) in [-1, 1]."""
        return decoded(self.autoencoder(direction), latents, skips)

    def autoencoder(self, direction: Direction) -> Any:
        return self.vae if direction == "a2b" else self.vae_b2a


def build(
    architecture: TurboArchitecture, normals: bool = True, lora: LoraRanks | None = None, seed: int = 0
) -> CycleGanTurbo:
    """Build with random weights and random captions of this seed: for tests and for measuring, not for pictures.

    Args:
        architecture: `tiny()`, or the real one (866 M and twice 84 M numbers).
        normals: Whether the encoders get a fourth channel, which changes nothing before it is trained.
        lora: Adds peft adapters to be trained; None for use.
        seed: The same seed gives the same weights, with and without the channel and the adapters.
    """
    diffusers: Any = import_module("diffusers")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        unet = diffusers.UNet2DConditionModel(**architecture.unet)
        vae = diffusers.AutoencoderKL(**architecture.vae)
        captions = torch.randn(2, *architecture.caption_shape)
        model = assembled(architecture, unet, vae, captions, normals=normals, lora=lora)
    model.seed = seed
    return model


def assembled(
    architecture: TurboArchitecture,
    unet: Any,
    vae: Any,
    captions: Tensor,
    *,
    normals: bool,
    lora: LoraRanks | None = None,
) -> CycleGanTurbo:
    """Make the model of SD-Turbo's parts; they become its own.

    Everything is frozen but the additions, where there are some.
    """
    add_skips(vae)
    if normals:
        add_guide_channel(vae)
    unet.requires_grad_(False)
    vae.requires_grad_(False)
    if lora is not None:
        add_adapters(unet, vae, lora)
    model = CycleGanTurbo(architecture, unet, vae, copy.deepcopy(vae))
    model.set_captions(captions[0], captions[1])
    return model.eval()


def _singles(pictures: Tensor, guides: Tensor | None) -> list[tuple[Tensor, Tensor | None]]:
    parts: list[Tensor | None] = [None] * len(pictures) if guides is None else list(guides.split(1))
    return list(zip(pictures.split(1), parts, strict=True))
