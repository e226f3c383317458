"""LoRA files of diffusers (pytorch_lora_weights.safetensors), and of kohya's scripts: additions to the UNet alone."""

import json
import re
from collections.abc import Mapping
from typing import Any

from .delta import TurboDelta, plain_layers, plain_tensors
from .lora import LowRank
from .model import CycleGanTurbo

Tensor = Any

_PREFIX = "unet."
_FLAT_PREFIX = "lora_unet_"
_FACTORS = {
    "lora_A.weight": "down", "lora_B.weight": "up",
    "lora.down.weight": "down", "lora.up.weight": "up",
    "lora_down.weight": "down", "lora_up.weight": "up",
    "alpha": "alpha",
}  # fmt: skip
_ENDING = re.compile(rf"\.({'|'.join(map(re.escape, _FACTORS))})$")
_METADATA = "lora_adapter_metadata"
"""Where diffusers writes peft's settings, in JSON."""


def is_diffusers_lora(names: Mapping[str, Any]) -> bool:
    """Whether the tensors of a file are named as those of a LoRA."""
    return any(name.startswith((_PREFIX, _FLAT_PREFIX)) and _ENDING.search(name) for name in names)


def read_diffusers_lora(
    tensors: Mapping[str, Tensor], metadata: Mapping[str, str], model: CycleGanTurbo, source: str
) -> TurboDelta:
    """Additions of a LoRA file: scaled by alpha / rank where it tells alpha, else once.

    Raises ValueError, naming the first key, for parts that don't belong to the UNet and for factors without the other.
    """
    layers = {name.removeprefix(_PREFIX) for name in plain_layers(model) if name.startswith(_PREFIX)}
    shapes = {name: tuple(tensor.shape) for name, tensor in plain_tensors(model).items()}
    flat = {layer.replace(".", "_"): layer for layer in layers}
    found: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        layer, factor = _named(name, layers, flat, source)
        found.setdefault(layer, {})[factor] = tensor
    settings = _settings(metadata, source)
    additions: dict[str, LowRank] = {}
    for layer, factors in found.items():
        for missing in {"down", "up"} - set(factors):
            raise ValueError(f"{source}: {layer!r} lacks its factor {missing!r}")
        rank = factors["down"].shape[0]
        alpha = float(factors["alpha"]) if "alpha" in factors else _alpha(settings, layer, rank)
        weight = _as_layer(factors, shapes[f"{_PREFIX}{layer}.weight"])
        additions[_PREFIX + layer] = LowRank(*weight, alpha / rank)
    return TurboDelta(source, additions, {})


def _named(name: str, layers: set[str], flat: Mapping[str, str], source: str) -> tuple[str, str]:
    ending = _ENDING.search(name)
    stem = name[: ending.start()] if ending else name
    # Before diffusers had peft, attention's additions were called after its processor.
    stem = re.sub(r"\.processor\.(to_[qkv]|to_out)_lora$", lambda m: f".{_OUT.get(m[1], m[1])}", stem)
    layer = stem.removeprefix(_PREFIX) if stem.startswith(_PREFIX) else flat.get(stem.removeprefix(_FLAT_PREFIX), "")
    if ending is None or layer not in layers:
        raise ValueError(f"{source}: {name!r} is no addition to a layer of this UNet")
    return layer, _FACTORS[ending[1]]


_OUT = {"to_out": "to_out.0"}


def _as_layer(factors: Mapping[str, Tensor], shape: tuple[int, ...]) -> tuple[Tensor, Tensor]:
    """Factors as the layer's own kind: files hold linear layers as 1x1 convolutions too."""
    down, up = factors["down"], factors["up"]
    if len(shape) == 2:
        return down.flatten(1), up.flatten(1)
    return down, up


def _settings(metadata: Mapping[str, str], source: str) -> Mapping[str, Any]:
    try:
        settings: Any = json.loads(metadata.get(_METADATA, "{}"))
    except ValueError as error:
        raise ValueError(f"{source}: {_METADATA} in its header is not readable JSON: {error}") from error
    return {key.removeprefix(_PREFIX): value for key, value in settings.items() if key.startswith(_PREFIX)}


def _alpha(settings: Mapping[str, Any], layer: str, rank: int) -> float:
    pattern: Mapping[str, float] = settings.get("alpha_pattern") or {}
    for ending, alpha in pattern.items():
        if layer == ending or layer.endswith(f".{ending}"):
            return float(alpha)
    return float(settings.get("lora_alpha", rank))
