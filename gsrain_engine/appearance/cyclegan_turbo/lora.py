"""LoRA (low-rank adaptation, Hu et al. 2022) of CycleGAN-Turbo: adapted layers, peft adapters, merging."""

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from ...optional_packages import import_package

torch: Any = import_module("torch")
Tensor = Any
Module = Any

UNET_LAYERS = (
    "to_k", "to_q", "to_v", "to_out.0", "conv", "conv1", "conv2", "conv_in", "conv_shortcut", "conv_out",
    "proj_out", "proj_in", "ff.net.2", "ff.net.0.proj",
)  # fmt: skip
"""Parts of the names of adapted UNet layers (Parmar et al. 2024)."""

VAE_LAYERS = (
    "conv1", "conv2", "conv_in", "conv_shortcut", "conv", "conv_out", "skip_conv_1", "skip_conv_2", "skip_conv_3",
    "skip_conv_4", "to_k", "to_q", "to_v", "to_out.0",
)  # fmt: skip
"""Ends of the names of adapted autoencoder layers."""

UNET_ADAPTERS = ("default_encoder", "default_decoder", "default_others")
VAE_ADAPTER = "vae_skip"
"""Names of peft adapters, as in img2img-turbo."""
VAE_ALPHA = 8
"""peft's default, as in img2img-turbo: at rank 4 the autoencoder's LoRA is scaled by 2."""


@dataclass(frozen=True, slots=True)
class LoraRanks:
    """Ranks of LoRA factors."""

    unet: int = 128
    vae: int = 4


@dataclass(frozen=True, slots=True, eq=False)
class LowRank:
    """LoRA of one layer: weight + scale * up @ down."""

    down: Tensor
    """lora_A: (rank, in) of a linear layer, (rank, in, h, w) of a convolution."""
    up: Tensor
    """lora_B: (out, rank), or (out, rank, 1, 1)."""
    scale: float

    def check(self, shape: tuple[int, ...]) -> None:
        """Raise ValueError if the factors don't fit a weight of this shape."""
        down, up = tuple(self.down.shape), tuple(self.up.shape)
        if up != (shape[0], down[0], *(1,) * len(shape[2:])) or down[1:] != shape[1:]:
            raise ValueError(f"factors {up} and {down} don't fit a weight {shape}")

    def added_to(self, weight: Tensor) -> Tensor:
        """Return the merged weight, computed in float32."""
        down, up = self.down.to(weight.device, torch.float32), self.up.to(weight.device, torch.float32)
        product = (up.flatten(1) @ down.flatten(1)).view_as(weight)
        return (weight.float() + self.scale * product).to(weight.dtype)


def unet_targets(unet: Module) -> tuple[list[str], list[str], list[str]]:
    """Full names of the UNet's adapted layers: those of its encoder, of its decoder, and the others."""
    encoder, decoder, others = list[str](), list[str](), list[str]()
    for name, _ in unet.named_parameters():
        if "bias" in name or "norm" in name or not any(part in name for part in UNET_LAYERS):
            continue
        group = encoder if "down_blocks" in name or "conv_in" in name else decoder if "up_blocks" in name else others
        group.append(name.removesuffix(".weight"))
    return encoder, decoder, others


def match_targets(layers: Iterable[str], targets: Sequence[str]) -> list[str]:
    """Layers whose names are a target, or end in one after a dot: peft's rule."""
    ends = tuple(f".{target}" for target in targets)
    return [name for name in layers if name in targets or name.endswith(ends)]


def add_adapters(unet: Module, vae: Module, ranks: LoraRanks) -> None:
    """Add peft adapters: three to the UNet (alpha = rank) and one to the autoencoder. They start without effect."""
    peft: Any = import_package("peft", "training additions")

    def add(module: Module, adapter: str, rank: int, alpha: int, layers: list[str]) -> None:
        config = peft.LoraConfig(r=rank, lora_alpha=alpha, init_lora_weights="gaussian", target_modules=layers)
        module.add_adapter(config, adapter_name=adapter)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Already found a `peft_config`")  # three adapters are intended
        for adapter, names in zip(UNET_ADAPTERS, unet_targets(unet), strict=True):
            add(unet, adapter, ranks.unet, ranks.unet, names)
    unet.set_adapter(list(UNET_ADAPTERS))
    add(vae, VAE_ADAPTER, ranks.vae, VAE_ALPHA, list(VAE_LAYERS))


def adapted_layers(module: Module) -> Iterator[tuple[str, Module]]:
    """Layers of a module that peft has wrapped, with their original names."""
    for name, each in module.named_modules():
        if hasattr(each, "lora_A") and hasattr(each, "base_layer"):
            yield name, each


def addition_of(layer: Module) -> LowRank:
    """LoRA of a layer that peft has wrapped, as references to its parameters; each layer has one adapter."""
    (adapter,) = layer.lora_A.keys()
    return LowRank(layer.lora_A[adapter].weight, layer.lora_B[adapter].weight, layer.scaling[adapter])
