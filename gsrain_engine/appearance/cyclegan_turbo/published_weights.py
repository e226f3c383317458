"""Checkpoints of img2img-turbo (clear2rainy.pkl and others) and of WeatherEdit, as their authors publish them."""

from collections.abc import Mapping
from typing import Any

from .delta import TurboDelta, check_names, plain_layers, plain_tensors
from .lora import VAE_ADAPTER, VAE_ALPHA, LowRank, targeted
from .model import CAPTIONS, CycleGanTurbo

_UNET_PARTS = (
    ("sd_encoder", "l_target_modules_encoder"),
    ("sd_decoder", "l_target_modules_decoder"),
    ("sd_other", "l_modules_others"),
)
"""Where the UNet's additions are, and which layers they are of."""
_OTHERS = ("rank_unet", "rank_vae", "vae_lora_target_modules", "sd_vae_enc", "sd_vae_dec")
_VAES = ("vae.", "vae_b2a.")

WEATHERS = ("rainy", "snowy", "foggy")
"""Which one checkpoint of WeatherEdit holds, each with the same autoencoder."""
WEATHEREDIT_CAPTION = "Picture of a {} weather scene"


def is_published(state: Mapping[str, Any]) -> bool:
    """Whether a loaded file looks like a checkpoint of img2img-turbo or WeatherEdit."""
    return "sd_vae_enc" in state or "rank_unet" in state


def published_texts(state: Mapping[str, Any], weather: str) -> tuple[str, str]:
    """Captions that weights were trained with; WeatherEdit has a sentence of its own for each weather."""
    a2b, b2a = CAPTIONS
    return (WEATHEREDIT_CAPTION.format(weather) if "sd_rainy_encoder" in state else a2b), b2a


def read_published(state: Mapping[str, Any], model: CycleGanTurbo, source: str, weather: str = "rainy") -> TurboDelta:
    """Weights of a checkpoint.

    Args:
        state: What the file holds.
        model: What they are for; it says which layers there are.
        source: The file, for messages.
        weather: Which additions to take where there are several.

    Raises ValueError for missing and unknown keys and other shapes, naming the first.
    """
    several = [each for each in WEATHERS if f"sd_{each}_encoder" in state]
    if several and weather not in several:
        raise ValueError(f"{source}: holds {', '.join(several)}, not {weather!r}")
    parts = [(key.replace("sd_", f"sd_{weather}_") if several else key, names) for key, names in _UNET_PARTS]
    _check_top(state, [key for pair in parts for key in pair], source, several)
    additions: dict[str, LowRank] = {}
    for key, names in parts:
        additions |= _unet_additions(state[key], state[names], f"{source}: {key}", int(state["rank_unet"]))
    vae_additions, replaced = _autoencoders(state, model, source)
    fourth = replaced["vae.encoder.conv_in.weight"].shape[1] > 3
    return TurboDelta(
        source, additions | vae_additions, replaced, "mask" if fourth else "", texts=published_texts(state, weather)
    )


def _check_top(state: Mapping[str, Any], keys: list[str], source: str, several: list[str]) -> None:
    wanted = {*keys, *_OTHERS}
    allowed = {f"sd_{each}_{part}" for each in several for part in ("encoder", "decoder", "other")}
    # A plain value that is not known tells something about the training; tensors would be weights, lost unseen.
    heavy = {key for key, value in state.items() if isinstance(value, Mapping) or hasattr(value, "shape")}
    check_names((set(state) & wanted) | (heavy - allowed), wanted, source)


def _unet_additions(state: Mapping[str, Any], layers: list[str], where: str, rank: int) -> dict[str, LowRank]:
    check_names(state, [f"{layer}.lora_{factor}.weight" for layer in layers for factor in "AB"], where)
    additions: dict[str, LowRank] = {}
    for layer in layers:
        down, up = state[f"{layer}.lora_A.weight"], state[f"{layer}.lora_B.weight"]
        if down.shape[0] != rank:
            raise ValueError(f"{where}: {layer!r} has rank {down.shape[0]}, not rank_unet, which is {rank}")
        additions[f"unet.{layer}"] = LowRank(down, up, 1.0)
    return additions


def _autoencoders(
    state: Mapping[str, Any], model: CycleGanTurbo, source: str
) -> tuple[dict[str, LowRank], dict[str, Any]]:
    """Additions and whole tensors of both autoencoders, which the file holds twice: the later one counts."""
    layers = [name.removeprefix("vae.") for name in plain_layers(model) if name.startswith("vae.")]
    adapted = targeted(layers, state["vae_lora_target_modules"])
    wanted = {prefix + _stored(name, adapted) for prefix in _VAES for name in _vae_tensors(model)}
    wanted |= {f"{prefix}{layer}.{_factor(f)}" for prefix in _VAES for layer in adapted for f in "AB"}
    for key in ("sd_vae_enc", "sd_vae_dec"):
        check_names(state[key], wanted, f"{source}: {key}")
    found = state["sd_vae_dec"]
    replaced = {p + name: found[p + _stored(name, adapted)] for p in _VAES for name in _vae_tensors(model)}
    scale = VAE_ALPHA / int(state["rank_vae"])
    additions = {
        p + layer: LowRank(found[f"{p}{layer}.{_factor('A')}"], found[f"{p}{layer}.{_factor('B')}"], scale)
        for p in _VAES
        for layer in adapted
    }
    return additions, replaced


def _vae_tensors(model: CycleGanTurbo) -> list[str]:
    return [name.removeprefix("vae.") for name in plain_tensors(model) if name.startswith("vae.")]


def _factor(letter: str) -> str:
    return f"lora_{letter}.{VAE_ADAPTER}.weight"


def _stored(name: str, adapted: list[str]) -> str:
    """Name of a tensor in a layer that peft has wrapped."""
    layer, _, tensor = name.rpartition(".")
    return f"{layer}.base_layer.{tensor}" if layer in adapted else name
