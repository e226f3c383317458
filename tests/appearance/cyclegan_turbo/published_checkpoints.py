"""Checkpoints laid out as img2img-turbo and WeatherEdit write them, of small random networks, and what they compute."""

from copy import deepcopy
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from gsrain_engine.appearance.cyclegan_turbo.lora import VAE_LAYERS, LoraRanks, unet_targets
from gsrain_engine.appearance.cyclegan_turbo.model import CycleGanTurbo, build_random_model, tiny
from gsrain_engine.appearance.cyclegan_turbo.weights import apply_adapter_weights, open_weights

torch: Any = import_module("torch")

RANKS = LoraRanks(unet=6, vae=4)


@cache
def trained_model(*, normals: bool = False, seed: int = 0) -> CycleGanTurbo:
    """A small model with peft adapters, in which everything that training moves has moved. Copy it to change it."""
    model = to_train(normals=normals)
    random = torch.Generator().manual_seed(seed + 100)
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if ".lora_" in name or "skip_conv_" in name:
                parameter += 0.2 * torch.randn(parameter.shape, generator=random)
    return model


def to_train(*, normals: bool = False) -> CycleGanTurbo:
    """A small model with peft adapters, in which nothing has moved yet."""
    return build_random_model(tiny(), normals, RANKS)


@cache
def pristine(*, normals: bool = False) -> CycleGanTurbo:
    """A small model without other weights in it; `untrained` copies it."""
    return build_random_model(tiny(), normals)


def untrained(*, normals: bool = False) -> CycleGanTurbo:
    """A small model without other weights in it, to put some in."""
    return deepcopy(pristine(normals=normals))


def published(model: CycleGanTurbo) -> dict[str, Any]:
    """Checkpoint of a model as saved by train_cyclegan_turbo.py, by peft's own functions."""
    encoder, decoder, others = unet_targets(pristine().unet)
    state = {
        "l_target_modules_encoder": encoder,
        "l_target_modules_decoder": decoder,
        "l_modules_others": others,
        "rank_unet": RANKS.unet,
        "rank_vae": RANKS.vae,
        "vae_lora_target_modules": list(VAE_LAYERS),
        "sd_vae_enc": _both_autoencoders(model),
        "sd_vae_dec": _both_autoencoders(model),
    }
    adapters = (("encoder", "default_encoder"), ("decoder", "default_decoder"), ("other", "default_others"))
    return state | {f"sd_{part}": _adapter(model, adapter) for part, adapter in adapters}


def weatheredit(rainy: CycleGanTurbo, snowy: CycleGanTurbo) -> dict[str, Any]:
    """Checkpoint in WeatherEdit's format: adapters by weather, one pair of autoencoders."""
    state = published(rainy)
    of_snow = published(snowy)
    for part in ("encoder", "decoder", "other"):
        state[f"sd_rainy_{part}"] = state.pop(f"sd_{part}")
        state[f"sd_snowy_{part}"] = of_snow[f"sd_{part}"]
    return state


def with_mask_channel() -> CycleGanTurbo:
    """A model with the fourth channel that WeatherEdit has: at first not zero, but the colors' mean."""
    wide = deepcopy(trained_model(normals=True))
    with torch.no_grad():
        for vae in (wide.vae, wide.vae_b2a):
            weight = vae.encoder.conv_in.base_layer.weight
            weight[:, 3:] = weight[:, :3].mean(1, keepdim=True)
    return wide


def load_weights(model: CycleGanTurbo, path: Path) -> None:
    """Put the weights of a file into a model: merged, or into its peft adapters where it has them."""
    apply_adapter_weights(model, open_weights(path).delta(model))


def noise(seed: int, *shape: int) -> Any:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def out(model: CycleGanTurbo, pictures: Any, guides: Any = None, direction: str = "a2b") -> Any:
    """Translate without gradients."""
    with torch.no_grad():
        return model.translate(pictures, guides, direction)


def _adapter(model: CycleGanTurbo, name: str) -> dict[str, Any]:
    peft: Any = import_module("peft")
    return {key: each.clone() for key, each in peft.get_peft_model_state_dict(model.unet, adapter_name=name).items()}


def _both_autoencoders(model: CycleGanTurbo) -> dict[str, Any]:
    pair = torch.nn.Module()
    pair.vae, pair.vae_b2a = model.vae, model.vae_b2a
    return {key: each.clone() for key, each in pair.state_dict().items()}
