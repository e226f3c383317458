"""Which numbers of CycleGAN-Turbo are learned, and how a pretrained layer is held where only a part of it may move."""

import re
from collections.abc import Mapping
from importlib import import_module
from typing import Any

torch: Any = import_module("torch")

Parameter = Any

_LORA = re.compile(r"\.lora_(A|B|embedding_A|embedding_B)\.")
_SKIP = re.compile(r"^vae(_b2a)?\.decoder\.skip_conv_\d+\.(base_layer\.)?weight$")
_UNET_INPUT = re.compile(r"^unet\.conv_in\.(base_layer\.)?(weight|bias)$")
_ENCODER_INPUT = re.compile(r"^vae(_b2a)?\.encoder\.conv_in\.(base_layer\.)?weight$")
_COLORS = 3


def trained_parameters(model: Any) -> tuple[dict[str, Parameter], dict[str, Parameter]]:
    """Choose what is learned, by name, and freeze the rest: what may decay towards nothing, and what may not.

    The published code trains every LoRA, the UNet's first convolution and the skip convolutions; but adding the
    adapters freezes the skips again, and its checkpoints lose the first convolution. Here:

    * every LoRA, and the skip convolutions, which start at nothing too: with weight decay, which pulls back to the
      pretrained model;
    * the UNet's first convolution, and of each encoder's first convolution the columns of the guide, which a LoRA of
      low rank would squeeze: without decay, which would pull away from the pretrained model.

    All of them are in what `save_weights` writes. Raises ValueError where a model has no LoRA to train.
    """
    model.requires_grad_(False)
    decaying: dict[str, Parameter] = {}
    held: dict[str, Parameter] = {}
    for name, parameter in model.named_parameters():
        if _LORA.search(name) or _SKIP.match(name):
            decaying[name] = parameter
        elif _UNET_INPUT.match(name):
            held[name] = parameter
        elif _ENCODER_INPUT.match(name) and parameter.shape[1] > _COLORS:
            held[name] = parameter
            parameter.requires_grad_(True).register_hook(_only_guide)
    if not any(_LORA.search(name) for name in decaying):
        raise ValueError("the model has no LoRA layers: build it with LoRA ranks to train it")
    for parameter in (*decaying.values(), *held.values()):
        parameter.requires_grad_(True)
    return decaying, held


def state_of(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Copies of parameters, on the processor, by name."""
    return {name: parameter.detach().cpu().clone() for name, parameter in parameters.items()}


def restore(parameters: Mapping[str, Parameter], arrays: Mapping[str, Any]) -> None:
    """Put back what `state_of` returned; raises KeyError where a name is missing."""
    with torch.no_grad():
        for name, parameter in parameters.items():
            parameter.copy_(arrays[name])


def _only_guide(gradient: Any) -> Any:
    """Hold the columns of the colours: without gradient and without decay AdamW leaves every bit of them."""
    gradient = gradient.clone()
    gradient[:, :_COLORS] = 0
    return gradient
