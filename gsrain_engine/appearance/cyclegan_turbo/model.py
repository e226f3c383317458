"""CycleGAN-Turbo (Parmar et al. 2024): architecture, one-step diffusion by SD-Turbo, and autoencoders with skips."""

import copy
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...safe_io.limits import read_file
from ...safe_io.text_files import MAX_BYTES
from ..base import TrainingRecord
from .lora import LoraRanks, add_adapters

torch: Any = import_module("torch")
Tensor = Any
Direction = Literal["a2b", "b2a"]
"""a is clear and b rainy, in weights that make views rainy."""

CAPTIONS = ("driving in heavy rain", "driving in the day")
"""Captions for a2b and b2a, as in the training of the published weights."""

Guide = Literal["", "normals", "mask"]
"""Training of the fourth channel: none, upward normals, or WeatherEdit's mask of classes."""

# Architecture: configurations of SD-Turbo's three networks, and a tiny variant


@dataclass(frozen=True, slots=True)
class TurboArchitecture:
    """Configurations in the format of diffusers and transformers, and the noise schedule."""

    name: str
    """Name in the header of our weights: "sd-turbo" or "tiny"."""
    unet: Mapping[str, Any]
    """Configuration of UNet2DConditionModel."""
    vae: Mapping[str, Any]
    """Configuration of AutoencoderKL, with three channels."""
    text: Mapping[str, Any]
    """Configuration of CLIPTextModel."""
    betas: tuple[float, float] = (0.00085, 0.012)
    """Noise variances at the first and the last of `noise_steps`; their square roots are spaced linearly."""
    noise_steps: int = 1000

    @property
    def side_multiple(self) -> int:
        """Required divisor of image sides, in pixels."""
        return 2 ** (len(self.vae["block_out_channels"]) - 1)

    @property
    def caption_shape(self) -> tuple[int, int, int]:
        """Shape of a caption embedding for the UNet: 1, tokens, features."""
        return 1, self.text["max_position_embeddings"], self.unet["cross_attention_dim"]


class CycleGanTurbo(torch.nn.Module):
    """One UNet for both directions, selected by caption, and one autoencoder per direction."""

    def __init__(self, architecture: TurboArchitecture, unet: Any, vae: Any, vae_b2a: Any) -> None:
        super().__init__()
        self.architecture = architecture
        self.step = OneStep.of(architecture)
        self.unet = unet
        self.vae = vae
        self.vae_b2a = vae_b2a
        self.guide: Guide = ""
        self.delta: Any = None
        """Merged weights (`weights.AdapterWeights`), for saving them again; None without."""
        self.texts: tuple[str, str] = CAPTIONS
        self.seed: int | None = None
        """Seed of the random base weights; None for SD-Turbo's own."""
        self.record: TrainingRecord | None = None
        """Record of the training of the weights, if their file has it."""
        self.base: str = ""
        """`base_fingerprint` of SD-Turbo's weights; empty for random ones."""

    @property
    def takes_guides(self) -> bool:
        """True if the encoders have a fourth channel."""
        return self.vae.config.in_channels == 4

    @property
    def adapted(self) -> bool:
        """True if trainable peft adapters exist; otherwise LoRAs are merged into the weights."""
        return hasattr(self.unet, "peft_config")

    @property
    def captions(self) -> dict[str, Tensor]:
        """Caption embeddings that select the direction: (1, tokens, features) each."""
        return {"a2b": self.caption_a2b, "b2a": self.caption_b2a}

    def set_captions(self, a2b: Tensor, b2a: Tensor) -> None:
        """Set the embeddings of the two captions; raises ValueError for other shapes."""
        self.check_captions(a2b, b2a)
        like = self.unet.conv_out.bias
        for name, caption in (("a2b", a2b), ("b2a", b2a)):
            value = caption.detach().to(like.device, like.dtype).clone()
            self.register_buffer(f"caption_{name}", value, persistent=False)

    def check_captions(self, a2b: Tensor, b2a: Tensor) -> None:
        """Raise ValueError for shapes that don't fit the UNet."""
        expected = self.architecture.caption_shape
        for name, caption in (("a2b", a2b), ("b2a", b2a)):
            if tuple(caption.shape) != expected:
                raise ValueError(f"caption {name} is {tuple(caption.shape)}; this UNet takes {expected}")

    def translate(self, pictures: Tensor, guides: Tensor | None = None, direction: Direction = "a2b") -> Tensor:
        """Return images (b, 3, h, w) in [-1, 1] in the other domain; the result is deterministic.

        h and w are multiples of `architecture.side_multiple`. `guides` (b, 1, h, w) in [-1, 1] are the fourth channel;
        None gives zeros if the encoders have one. Raises ValueError for other sizes, and for guides without a channel.
        """
        latents, skips = self.encode(pictures, guides, direction)
        return decode_latents(self.autoencoder(direction), self.denoise(latents, direction), skips)

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
        return encode_images(self.autoencoder(direction), pictures)

    def denoise(self, latents: Tensor, direction: Direction = "a2b") -> Tensor:
        """Run the UNet's one step: latents of the same shape, in the other domain."""
        steps = torch.full((len(latents),), self.step.timestep, device=latents.device, dtype=torch.long)
        caption = self.captions[direction].expand(len(latents), -1, -1)
        noise = self.unet(latents, steps, encoder_hidden_states=caption).sample
        return self.step.clean(latents, noise)

    def autoencoder(self, direction: Direction) -> Any:
        return self.vae if direction == "a2b" else self.vae_b2a


_SAMPLES = 64


def base_fingerprint(unet: Any, vae: Any) -> str:
    """Hash (16 hex digits) of a base's names, shapes and some 64 evenly spaced values of each tensor, before training.

    Values count as float16, so that half-precision copies of the same weights have the same fingerprint.
    """
    found = hashlib.sha256()
    for name, tensor in (*unet.state_dict().items(), *vae.state_dict().items()):
        flat = tensor.detach().reshape(-1)
        found.update(f"{name} {tuple(tensor.shape)}\n".encode())
        found.update(flat[:: max(1, len(flat) // _SAMPLES)].cpu().half().numpy().tobytes())
    return found.hexdigest()[:16]


def build_random_model(
    architecture: TurboArchitecture, normals: bool = True, lora: LoraRanks | None = None, seed: int = 0
) -> CycleGanTurbo:
    """Build a model with random weights and captions, for tests and benchmarks; see `assemble_model`.

    `architecture` is `tiny()`, or the real one (866 M and twice 84 M parameters). The weights depend on the seed alone.
    """
    diffusers: Any = import_module("diffusers")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        unet = diffusers.UNet2DConditionModel(**architecture.unet)
        vae = diffusers.AutoencoderKL(**architecture.vae)
        captions = torch.randn(2, *architecture.caption_shape)
        model = assemble_model(architecture, unet, vae, captions, normals=normals, lora=lora)
    model.seed = seed
    return model


def assemble_model(
    architecture: TurboArchitecture, unet: Any, vae: Any, captions: Tensor, *, normals: bool, lora: LoraRanks | None
) -> CycleGanTurbo:
    """Assemble the model from SD-Turbo's parts, which it takes over and modifies.

    `normals` adds a fourth channel to the encoders, which has no effect before training; `lora` are ranks of trainable
    peft adapters, None for inference. All other parameters are frozen.
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


def sd_turbo() -> TurboArchitecture:
    """Architecture of stabilityai/sd-turbo, which equals Stable Diffusion 2.1 (base)."""
    unet = {
        "attention_head_dim": [5, 10, 20, 20], "block_out_channels": [320, 640, 1280, 1280],
        "cross_attention_dim": 1024, "sample_size": 64, "use_linear_projection": True,
    }  # fmt: skip
    vae = _vae([128, 256, 512, 512], layers=2, groups=32) | {"sample_size": 768}
    text = {
        "vocab_size": 49408, "hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 23,
        "num_attention_heads": 16, "max_position_embeddings": 77, "hidden_act": "gelu",
    }  # fmt: skip
    return TurboArchitecture("sd-turbo", unet, vae, text)


def tiny() -> TurboArchitecture:
    """Tiny variant with the same classes, blocks and layer names: a forward pass takes a fraction of a second."""
    unet = {
        "attention_head_dim": [2, 2, 4, 4], "block_out_channels": [8, 8, 16, 16], "cross_attention_dim": 16,
        "norm_num_groups": 4, "sample_size": 8, "use_linear_projection": True,
    }  # fmt: skip
    text = {
        "vocab_size": 64, "hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2,
        "num_attention_heads": 2, "max_position_embeddings": 77, "hidden_act": "gelu",
    }  # fmt: skip
    return TurboArchitecture("tiny", unet, _vae([8, 8, 16, 16], layers=1, groups=4), text)


ARCHITECTURES = {"sd-turbo": sd_turbo, "tiny": tiny}


def check_base(folder: Path, architecture: TurboArchitecture) -> None:
    """Raise ValueError if a folder in diffusers' layout has another architecture, naming file and field.

    Only written fields are compared; a missing field means the class's default.
    """
    schedule = {
        "prediction_type": "epsilon", "beta_schedule": "scaled_linear", "beta_start": architecture.betas[0],
        "beta_end": architecture.betas[1], "num_train_timesteps": architecture.noise_steps,
    }  # fmt: skip
    _check(folder / "unet" / "config.json", architecture.unet)
    _check(folder / "vae" / "config.json", architecture.vae)
    _check(folder / "scheduler" / "scheduler_config.json", schedule)


def _check(file: Path, expected: Mapping[str, Any]) -> None:
    try:
        found: Any = json.loads(read_file(file, MAX_BYTES).decode("utf-8"))
    except OSError as error:
        raise FileNotFoundError(f"{file}: no such file; a folder of SD-Turbo in diffusers' layout has it") from error
    except ValueError as error:
        raise ValueError(f"{file}: not readable JSON: {error}") from error
    if not isinstance(found, dict):
        raise ValueError(f"{file}: a JSON object is wanted here")
    for key, value in expected.items():
        if key != "sample_size" and key in found and found[key] != value:
            raise ValueError(f"{file}: {key} is {found[key]!r}, but CycleGAN-Turbo builds on SD-Turbo with {value!r}")


def _vae(channels: list[int], *, layers: int, groups: int) -> dict[str, Any]:
    return {
        "block_out_channels": channels, "down_block_types": ["DownEncoderBlock2D"] * len(channels),
        "up_block_types": ["UpDecoderBlock2D"] * len(channels), "layers_per_block": layers,
        "norm_num_groups": groups, "latent_channels": 4, "scaling_factor": 0.18215,
    }  # fmt: skip


# One-step diffusion of SD-Turbo


@dataclass(frozen=True, slots=True)
class OneStep:
    """Step from the last noise step directly to a clean latent, in closed form."""

    timestep: int
    """999 in SD-Turbo: with "trailing" spacing a schedule of one step starts at the end; "leading" would give 0."""
    signal: float
    """Standard deviation of the clean latent's part at that step."""
    noise: float
    """Standard deviation of the noise at that step."""

    @classmethod
    def of(cls, architecture: TurboArchitecture) -> "OneStep":
        """Compute the shares from the noise schedule (Ho et al. 2020, eq. 4; betas "scaled linear")."""
        first, last = architecture.betas
        betas = np.linspace(first**0.5, last**0.5, architecture.noise_steps) ** 2
        signal = float(np.prod(1 - betas))
        return cls(architecture.noise_steps - 1, signal**0.5, (1 - signal) ** 0.5)

    def clean(self, latents: Tensor, noise: Tensor) -> Tensor:
        """Subtract the noise predicted by the UNet from latents, as DDPM's step does (Ho et al. 2020, eq. 15).

        Errors in the noise are amplified 15 times (`noise / signal`), so this is computed in float32. The UNet's own
        rounding is amplified too: for a small random one, bfloat16 is 1.2 % off and float16 0.15 %, which gives 17 %
        and 2 % of a latent's standard deviation.
        """
        return ((latents.float() - self.noise * noise.float()) / self.signal).to(latents.dtype)


# SD-Turbo's autoencoder with skip connections from encoder to decoder, and a fourth channel besides RGB
#
# Modules and names are those of diffusers' AutoencoderKL plus `decoder.skip_conv_1` to `_4`, so that state
# dictionaries fit those of img2img-turbo (Parmar et al. 2024). Nothing is stored between encoding and decoding.

Autoencoder = Any
"""diffusers' AutoencoderKL, with skips."""

SKIP_START = 1e-5
"""Initial weight of skip convolutions (Parmar et al. 2024): practically no skip."""


def add_skips(vae: Autoencoder) -> None:
    """Add 1x1 convolutions from the input of each down block to the up block of the same size."""
    channels = list(vae.config.block_out_channels)
    sources = [*reversed(channels[:-1]), channels[0]]
    targets = [channels[-1], *reversed(channels[1:])]
    like = vae.decoder.conv_in.weight
    for i, (source, target) in enumerate(zip(sources, targets, strict=True)):
        skip = torch.nn.Conv2d(source, target, 1, bias=False, device=like.device, dtype=like.dtype)
        torch.nn.init.constant_(skip.weight, SKIP_START)
        setattr(vae.decoder, f"skip_conv_{i + 1}", skip)


def add_guide_channel(vae: Autoencoder) -> None:
    """Add a fourth channel with zero weights to the encoder, so that images are encoded as before.

    Gradients still reach the new weights. WeatherEdit instead starts from the mean over colors, which changes every
    latent.
    """
    narrow = vae.encoder.conv_in
    wide = torch.nn.Conv2d(
        narrow.in_channels + 1, narrow.out_channels, narrow.kernel_size, narrow.stride, narrow.padding,
        device=narrow.weight.device, dtype=narrow.weight.dtype,
    )  # fmt: skip
    with torch.no_grad():
        wide.weight.copy_(widen_kernel(narrow.weight, wide.in_channels))
        wide.bias.copy_(narrow.bias)
    wide.requires_grad_(narrow.weight.requires_grad)
    vae.encoder.conv_in = wide
    vae.register_to_config(in_channels=wide.in_channels)


def widen_kernel(weight: Tensor, channels: int) -> Tensor:
    """Widen a kernel (out, in, h, w), or a LoRA factor of it, to `channels` inputs; the new ones are zero."""
    missing = weight.new_zeros(weight.shape[0], channels - weight.shape[1], *weight.shape[2:])
    return torch.cat([weight, missing], dim=1)


def encode_images(vae: Autoencoder, pictures: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Scaled latents (b, 4, h / 8, w / 8) of images (b, 3 or 4, h, w) in [-1, 1], and the input of each down block.

    The inputs are from fine to deep. Latents are the mode of the distribution, not a sample, so that neighboring views
    don't differ randomly.
    """
    encoder = vae.encoder
    flow = encoder.conv_in(pictures)
    skips: list[Tensor] = []
    for block in encoder.down_blocks:
        skips.append(flow)
        flow = _through(encoder, block, flow)
    flow = _through(encoder, encoder.mid_block, flow)
    flow = vae.quant_conv(encoder.conv_out(encoder.conv_act(encoder.conv_norm_out(flow))))
    mean, _ = flow.chunk(2, dim=1)
    return mean * vae.config.scaling_factor, skips


def decode_latents(vae: Autoencoder, latents: Tensor, skips: Sequence[Tensor]) -> Tensor:
    """Images (b, 3, h, w) in [-1, 1] from scaled latents and skips of `encode_images`."""
    decoder = vae.decoder
    flow = decoder.conv_in(vae.post_quant_conv(latents / vae.config.scaling_factor))
    flow = _through(decoder, decoder.mid_block, flow)
    for i, (block, skip) in enumerate(zip(decoder.up_blocks, reversed(skips), strict=True)):
        flow = flow + getattr(decoder, f"skip_conv_{i + 1}")(skip)
        flow = _through(decoder, block, flow)
    return decoder.conv_out(decoder.conv_act(decoder.conv_norm_out(flow))).clamp(-1, 1)


def _through(half: Any, block: Any, flow: Tensor) -> Tensor:
    """Run a block of an encoder or decoder, with gradient checkpointing if enabled."""
    if half.gradient_checkpointing and torch.is_grad_enabled():
        return torch.utils.checkpoint.checkpoint(block, flow, use_reentrant=False)
    return block(flow)
