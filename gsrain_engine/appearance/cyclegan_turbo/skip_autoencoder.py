"""SD-Turbo's autoencoder with skip connections from encoder to decoder, and a fourth channel beside red, green, blue.

The modules and their names are diffusers' AutoencoderKL with `decoder.skip_conv_1` to `_4` added, so that state
dictionaries fit those of img2img-turbo (Parmar et al. 2024). Nothing is stored between encoding and decoding.
"""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

torch: Any = import_module("torch")

Tensor = Any
Autoencoder = Any
"""diffusers' AutoencoderKL, with skips."""

SKIP_START = 1e-5
"""Every weight of a skip convolution before training (Parmar et al. 2024): as good as no skip."""


def add_skips(vae: Autoencoder) -> None:
    """Add the 1x1 convolutions that bring what each down block takes to the up block of the same size."""
    channels = list(vae.config.block_out_channels)
    taken = [channels[0], *channels[:-1]]
    given = [channels[-1], *reversed(channels[1:])]
    like = vae.decoder.conv_in.weight
    for i, (source, target) in enumerate(zip(reversed(taken), given, strict=True)):
        skip = torch.nn.Conv2d(source, target, 1, bias=False, device=like.device, dtype=like.dtype)
        torch.nn.init.constant_(skip.weight, SKIP_START)
        setattr(vae.decoder, f"skip_conv_{i + 1}", skip)


def add_guide_channel(vae: Autoencoder) -> None:
    """Give the encoder a fourth channel whose weights are zero: pictures are encoded exactly as before.

    Gradients reach the new weights all the same. WeatherEdit starts from the mean over colours instead, which changes
    every latent.
    """
    narrow = vae.encoder.conv_in
    wide = torch.nn.Conv2d(
        narrow.in_channels + 1,
        narrow.out_channels,
        narrow.kernel_size,
        narrow.stride,
        narrow.padding,
        device=narrow.weight.device,
        dtype=narrow.weight.dtype,
    )
    with torch.no_grad():
        wide.weight.copy_(widened(narrow.weight, wide.in_channels))
        wide.bias.copy_(narrow.bias)
    wide.requires_grad_(narrow.weight.requires_grad)
    vae.encoder.conv_in = wide
    vae.register_to_config(in_channels=wide.in_channels)


def widened(weight: Tensor, channels: int) -> Tensor:
    """A kernel (out, in, h, w), or a low-rank factor of it, that takes this many channels; the new ones are zero."""
    missing = weight.new_zeros(weight.shape[0], channels - weight.shape[1], *weight.shape[2:])
    return torch.cat([weight, missing], dim=1)


def encoded(vae: Autoencoder, pictures: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Scaled latents (b, 4, h / 8, w / 8), and what each down block took, from fine to deep.

    Args:
        vae: With skips.
        pictures: (b, 3 or 4, h, w) in [-1, 1].

    The mode of the distribution, not a sample: neighbouring views must not differ by chance.
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


def decoded(vae: Autoencoder, latents: Tensor, skips: Sequence[Tensor], strength: float = 1.0) -> Tensor:
    """Pictures (b, 3, h, w) in [-1, 1] from scaled latents and what `encoded` gave beside them.

    `strength` scales what the skips carry: 1 as trained (img2img-turbo's gamma), 0 leaves them out.
    """
    decoder = vae.decoder
    flow = decoder.conv_in(vae.post_quant_conv(latents / vae.config.scaling_factor))
    flow = _through(decoder, decoder.mid_block, flow)
    for i, (block, skip) in enumerate(zip(decoder.up_blocks, reversed(skips), strict=True)):
        flow = flow + getattr(decoder, f"skip_conv_{i + 1}")(skip * strength)
        flow = _through(decoder, block, flow)
    return decoder.conv_out(decoder.conv_act(decoder.conv_norm_out(flow))).clamp(-1, 1)


def _through(half: Any, block: Any, flow: Tensor) -> Tensor:
    """Run a block of an encoder or decoder; with gradient checkpointing it is run again for the gradients."""
    if half.gradient_checkpointing and torch.is_grad_enabled():
        return torch.utils.checkpoint.checkpoint(block, flow, use_reentrant=False)
    return block(flow)
