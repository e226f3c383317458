"""What a transfer adds to SD-Turbo: low-rank additions, tensors in place of others, captions; taken in, given out."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

from .lora import LoraRanks, LowRank, adapted_layers, addition_of, plain_name
from .model import CycleGanTurbo, Guide
from .skip_autoencoder import widened

torch: Any = import_module("torch")

Tensor = Any


_ENCODER_INPUTS = ("vae.encoder.conv_in", "vae_b2a.encoder.conv_in")


@dataclass(frozen=True, slots=True, eq=False)
class TurboDelta:
    """Weights of one transfer relative to SD-Turbo. Names are of the whole model, as they are without peft."""

    source: str
    """File that it was read from, for messages."""
    additions: Mapping[str, LowRank]
    """By the layer's name, as "unet.mid_block.resnets.0.conv1"."""
    replaced: Mapping[str, Tensor]
    """By the tensor's name, as "vae.decoder.skip_conv_1.weight"; additions come on top."""
    guide: Guide = ""
    captions: tuple[Tensor, Tensor] | None = None
    """For a2b and b2a; None leaves the model's own."""
    texts: tuple[str, str] | None = None
    """What the captions say."""

    @property
    def ranks(self) -> LoraRanks:
        """The largest ranks of the UNet's and the autoencoders' additions; 0 where there are none."""
        unet = [each.down.shape[0] for name, each in self.additions.items() if name.startswith("unet.")]
        vae = [each.down.shape[0] for name, each in self.additions.items() if not name.startswith("unet.")]
        return LoraRanks(max(unet, default=0), max(vae, default=0))

    @property
    def takes_guides(self) -> bool:
        """Whether it was made with a fourth channel."""
        first = self.replaced.get(f"{_ENCODER_INPUTS[0]}.weight")
        addition = self.additions.get(_ENCODER_INPUTS[0])
        return any(each is not None and each.shape[1] > 3 for each in (first, addition and addition.down))


def plain_tensors(model: CycleGanTurbo) -> dict[str, Tensor]:
    """A model's weights without additions, by the names that they have without peft."""
    return {plain_name(name): each for name, each in model.named_parameters() if ".lora_" not in name}


def plain_layers(model: CycleGanTurbo) -> list[str]:
    """Names of the linear layers and convolutions."""
    return [name.removesuffix(".weight") for name, each in plain_tensors(model).items() if each.ndim > 1]


def take_in(model: CycleGanTurbo, delta: TurboDelta) -> None:
    """Put weights into a model: into its peft adapters where it has them, else merged into its layers.

    Raises ValueError, which names the first one, for layers and tensors that don't fit; the model is as it was then.
    """
    if model.delta is not None:
        raise ValueError(f"{delta.source}: the model has weights from {model.delta.source} already")
    tensors = plain_tensors(model)
    delta = _fitted(delta, tensors)
    if delta.captions is not None:
        model.check_captions(*delta.captions)
    with torch.no_grad():
        if model.adapted:
            _into_adapters(model, delta)
        for name, value in delta.replaced.items():
            tensors[name].copy_(value)
        for layer, addition in delta.additions.items() if not model.adapted else ():
            weight = tensors[f"{layer}.weight"]
            weight.copy_(addition.added(weight))
    if delta.captions is not None:
        model.set_captions(*delta.captions)
    model.texts = delta.texts or model.texts
    model.guide = delta.guide
    model.delta = None if model.adapted else delta


def given_out(model: CycleGanTurbo) -> TurboDelta:
    """What a model has beyond SD-Turbo, with everything that may have been trained, whether it is another or not.

    Raises ValueError for a model that has neither adapters nor loaded weights.
    """
    captions = (model.captions["a2b"], model.captions["b2a"])
    if not model.adapted:
        if model.delta is None:
            raise ValueError("this model is plain SD-Turbo: there is nothing to save")
        return replace(model.delta, captions=captions, texts=model.texts)
    additions = {name: addition_of(layer) for name, layer in adapted_layers(model)}
    whole = {
        name: each
        for name, each in plain_tensors(model).items()
        if each.requires_grad or name.startswith(("unet.conv_in.", *_ENCODER_INPUTS)) or ".skip_conv_" in name
    }
    guide: Guide = ("normals" if model.guide == "" else model.guide) if model.takes_guides else ""
    return TurboDelta("the model", additions, whole, guide, captions, model.texts)


def check_names(found: Iterable[str], wanted: Iterable[str], where: str) -> None:
    """Raise ValueError, which names the first of each, where keys are missing or unknown."""
    have, need = set(found), set(wanted)
    faults = [f"{_first(need - have)} missing"] if need - have else []
    faults += [f"{_first(have - need)} unknown"] if have - need else []
    if faults:
        raise ValueError(f"{where}: {', and '.join(faults)}")


def _first(names: set[str]) -> str:
    others = f" and {len(names) - 1} more are" if len(names) > 1 else " is"
    return f"{min(names)!r}{others}"


def _fitted(delta: TurboDelta, tensors: Mapping[str, Tensor]) -> TurboDelta:
    """The delta with kernels widened to the model's channels and without tensors that are the model's own anyway."""
    takes = tensors[f"{_ENCODER_INPUTS[0]}.weight"].shape[1]
    if delta.takes_guides and takes == 3:
        raise ValueError(f"{delta.source}: made with a fourth channel, which this model lacks: open it with normals")
    for name in delta.additions:
        if f"{name}.weight" not in tensors:
            raise ValueError(f"{delta.source}: {name!r} is no layer of this model")
    additions, replaced = dict(delta.additions), dict(delta.replaced)
    for layer in _ENCODER_INPUTS:
        if layer in additions:
            additions[layer] = replace(additions[layer], down=widened(additions[layer].down, takes))
        if (kernel := f"{layer}.weight") in replaced:
            replaced[kernel] = widened(replaced[kernel], takes)
    for name, addition in additions.items():
        try:
            addition.check(tuple(tensors[f"{name}.weight"].shape))
        except ValueError as error:
            raise ValueError(f"{delta.source}: {name!r}: {error}") from error
    for name, value in replaced.items():
        if name not in tensors:
            raise ValueError(f"{delta.source}: {name!r} is no tensor of this model")
        if value.shape != tensors[name].shape:
            shapes = f"{tuple(value.shape)}, but the model has {tuple(tensors[name].shape)}"
            raise ValueError(f"{delta.source}: {name!r} is {shapes}")
    replaced = {name: value for name, value in replaced.items() if not _equal(value, tensors[name])}
    return replace(delta, additions=additions, replaced=replaced)


def _equal(a: Tensor, b: Tensor) -> bool:
    return a.dtype == b.dtype and torch.equal(a, b.to(a.device))


def _into_adapters(model: CycleGanTurbo, delta: TurboDelta) -> None:
    own = {name: addition_of(layer) for name, layer in adapted_layers(model)}
    check_names(delta.additions, own, f"{delta.source}, to be trained on")
    for name, mine in own.items():
        given = delta.additions[name]
        for kind, to, value in (("lora_A", mine.down, given.down), ("lora_B", mine.up, given.up)):
            if to.shape != value.shape:
                shapes = f"{tuple(value.shape)}, but the model has {tuple(to.shape)}"
                raise ValueError(f"{delta.source}: {kind} of {name!r} is {shapes}")
        if abs(mine.scale - given.scale) > 1e-6 * abs(mine.scale):
            raise ValueError(f"{delta.source}: {name!r} counts {given.scale:g} times, {mine.scale:g} in the model")
    for name, mine in own.items():
        mine.down.copy_(delta.additions[name].down)
        mine.up.copy_(delta.additions[name].up)
